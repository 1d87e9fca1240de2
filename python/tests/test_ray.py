"""`python -m splatgraph.ray` on clusters of this machine: workers and nodes die, and every picture is there."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
import splatgraph
from conftest import random_splats

ray = pytest.importorskip("ray", reason="Ray cannot be installed")
from ray.cluster_utils import Cluster


def prepared(folder, views, size):
    """Writes a scene, and a camera for each of `views` views."""
    splatgraph.Scene.from_arrays(*random_splats(7, 2000, 1)).save(folder / "scene.ply")
    cameras = [
        {
            "id": i, "img_name": f"view{i:03}", "width": size[0], "height": size[1], "position": [0.01 * i, 0, -2],
            "rotation": np.eye(3).tolist(), "fx": size[0], "fy": size[0],
        }
        for i in range(views)
    ]  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps(cameras))
    return cameras


def pictures(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.png"))}


def started(folder, *arguments, address=None):
    """Starts a run. Its messages are lines of standard error."""
    command = [sys.executable, "-m", "splatgraph.ray", *arguments]
    if address is not None:
        command += ["--address", address]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module")
def cluster():
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "object_store_memory": 100 << 20})
    yield cluster
    cluster.shutdown()


def test_every_picture_is_there_after_a_worker_is_killed_and_a_node_taken_away(tmp_path, cluster):
    views = 400
    prepared(tmp_path, views, (160, 120))
    render = ("render", "scene.ply", "-c", "cameras.json")
    one = [sys.executable, "-m", "splatgraph", *render, "-o", "one"]
    subprocess.run(one, cwd=tmp_path, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    node = cluster.add_node(num_cpus=2, object_store_memory=100 << 20)
    run = started(tmp_path, *render, "-o", "many", "--cpus", "1", "--batch", "8", address=cluster.address)
    # Each worker is stopped when it reports its start, so that the run cannot end before workers are killed.
    lines, pids = [], []
    while len(pids) < 4:
        lines.append(run.stderr.readline())
        assert lines[-1], "".join(lines)
        if begun := re.search(r"worker \d+ \(pid (\d+)", lines[-1]):
            pids.append(int(begun[1]))
            os.kill(pids[-1], signal.SIGSTOP)
    killed = pids[0]
    os.kill(killed, signal.SIGKILL)
    cluster.remove_node(node, allow_graceful=False)
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    lines += run.communicate(timeout=120)[1].splitlines(keepends=True)
    log = "".join(lines)
    print(log)
    assert run.returncode == 0, log
    assert f"a worker (pid {killed} on" in log and log.count(") died: ") >= 2 and f"{views} of {views} views are present" in log
    assert pictures(tmp_path / "many") == pictures(tmp_path / "one")

    # A second run draws only the missing view.
    many = tmp_path / "many"
    kept = {path.name: path.stat().st_mtime_ns for path in many.glob("*.png")}
    (many / "view007.png").unlink()
    again = started(tmp_path, *render, "-o", "many", "--cpus", "2", address=cluster.address)
    log = again.communicate(timeout=120)[1]
    assert again.returncode == 0 and f"{views} of {views} views ({views - 1} already there)" in log, log
    assert pictures(many) == pictures(tmp_path / "one")
    assert all(path.stat().st_mtime_ns == kept[path.name] for path in many.glob("*.png") if path.name != "view007.png")


def test_a_view_that_fails_is_tried_three_times_reported_and_costs_no_other(tmp_path, cluster):
    cameras = prepared(tmp_path, 6, (64, 48))
    cameras[2] |= {"width": 32768, "height": 32768}
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    run = started(tmp_path, "render", "scene.ply", "-c", "cameras.json", "-o", "out", "--cpus", "1", address=cluster.address)
    log = run.communicate(timeout=120)[1]
    assert run.returncode == 1 and re.search(r"scene\.ply: view002 failed 3 times: \S", log) and "missing: view002" in log, log
    assert len(pictures(tmp_path / "out")) == 5


def test_several_scenes_and_commands_leave_what_one_process_leaves(tmp_path, cluster):
    prepared(tmp_path, 2, (40, 32))
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        splatgraph.Scene.from_arrays(*random_splats(len(name), 300, 1)).save(tmp_path / name / "point_cloud.ply")
    scenes = ["a/point_cloud.ply", "b/point_cloud.ply"]
    effort = ("--rounds", "1", "--frames", "1")
    run = started(
        tmp_path, "trade", *scenes, "-c", "cameras.json", "-o", "out", "--cpus", "1", *effort, "--only", "sh", address=cluster.address
    )
    log = run.communicate(timeout=240)[1]
    assert run.returncode == 0, log
    for name in ("a", "b"):
        ledger = json.loads((tmp_path / "out" / name / "point_cloud/ledger.json").read_text())
        assert {row["camera"] for row in ledger["rows"]} == {"view000", "view001"} and len(ledger["rows"]) % 2 == 0
        assert (tmp_path / "out" / name / "point_cloud/ledger.html").exists()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("render", "scene.ply", "-c", "nowhere.json", "-o", "out"), "error: scene.ply: .*nowhere.json"),
        (("render", "scene.ply", "-c", "cameras.json", "-o", "out.png"), "expected one camera for the picture"),
        (("render", "a.ply", "b.ply", "c.ply", "-c", "x", "y", "-o", "out"), "for each of 3 scenes, found 2"),
        (("render", "scene.ply", "-c", "cameras.json", "-o", "out", "--colour", "red"), "unexpected argument '--colour'"),
        (("render", "scene.ply", "-c", "cameras.json", "-o", "out", "--batch", "0"), "expected numbers above 0"),
    ],
)
def test_mistakes_in_the_command_line_are_told_before_anything_starts(tmp_path, arguments, message):
    prepared(tmp_path, 2, (40, 32))
    run = started(tmp_path, *arguments)
    log = run.communicate(timeout=60)[1]
    assert run.returncode != 0 and re.search(message, log), log
    assert not (tmp_path / "out").exists()
