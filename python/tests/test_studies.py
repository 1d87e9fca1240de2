"""`trade` and `advise`: ledgers and advice as records."""

import json
import math
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import splatgraph
from conftest import ROOT
from splatgraph import Camera


@pytest.fixture
def cameras():
    return [Camera.look_at((0.1 * i, 0, -2), (0, 0, 4), size=(40, 32), name=name) for i, name in enumerate(["one", "two"])]


def test_a_ledger_has_a_line_for_each_setting_with_its_cost(scene, cameras):
    seen = []
    found = splatgraph.trade(scene, cameras, only=["sh_degree", "record"], rounds=1, frames=1, progress=lambda *step: seen.append(step))
    assert [line.setting for line in found][0] == "exact" and len(found) == len(found.lines) > 2
    exact, plain = found["exact"], found["sh_degree = 0"]
    assert exact.psnr_db > 60 > plain.psnr_db and exact.mark == "best"
    assert plain.share.median > 0 and plain.share.range is None and plain.gpu_bytes > 0 and dict(p[:2] for p in plain.phases)
    assert {(row["setting"], row["camera"]) for row in found.rows} >= {("exact", "one"), ("exact", "two")}
    assert seen[-1][0] == "measuring" and seen[-1][1] < seen[-1][2] and "two" in seen[-1][3]
    assert "sh_degree = 0" in str(found) and found.csv.startswith("setting,gpu_ms") and found.html.startswith("<!doctype html>")
    with pytest.raises(KeyError, match="available: exact"):
        found["nothing"]
    with pytest.raises(ValueError, match="expected a prefix of one of these settings' names"):
        splatgraph.trade(scene, cameras, only=["nothing"])
    with pytest.raises(ValueError, match="cameras: expected at least one"):
        splatgraph.trade(scene, [])


def test_a_ledger_compares_with_given_pictures_and_goes_on_from_its_file(scene, cameras, tmp_path):
    file = tmp_path / "ledger.json"
    truths = [np.zeros((32, 40, 3), np.float32)] * 2
    options = {"only": ["sh_degree = 0"], "rounds": 1, "frames": 1, "truths": truths, "file": str(file)}
    seen = []
    first = splatgraph.trade(scene, cameras, **options, progress=lambda *step: seen.append(step))
    assert first["exact"].psnr_db < 30 and len(json.loads(file.read_text())["rows"]) == len(first.rows)
    steps = len(seen)
    again = splatgraph.trade(scene, cameras, **options, progress=lambda *step: seen.append(step))
    assert again.rows == first.rows
    assert any("rows of an earlier run are kept" in note for note in again.notes)
    assert not any(task == "measuring" for task, *_ in seen[steps:])
    drawn = [splatgraph.Renderer(scene).render(camera) for camera in cameras]
    truths = [np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8) for picture in drawn]
    rounded = splatgraph.trade(scene, cameras, only="sh_degree = 0", rounds=1, frames=1, truths=truths)
    assert rounded["exact"].psnr_db > 50 and [line.setting for line in rounded] == [line.setting for line in first]
    with pytest.raises(ValueError, match="truths: expected a picture for each of 2 cameras, found 1"):
        splatgraph.trade(scene, cameras, truths=truths[:1])
    with pytest.raises(ValueError, match=r"truths\[1\]: expected finite values, found NaN"):
        splatgraph.trade(scene, cameras, truths=[drawn[0], drawn[1] * np.nan])
    for rounds in (-1, 0, 1.5):
        with pytest.raises(ValueError, match="rounds: expected an integer above 0, found"):
            splatgraph.trade(scene, cameras, rounds=rounds)


def test_a_file_that_is_no_ledger_is_kept(scene, cameras, tmp_path):
    victim = tmp_path / "victim.ply"
    scene.save(victim)
    before = victim.read_bytes()
    with pytest.raises(ValueError, match="victim.ply: expected a ledger of an earlier run, or no file"):
        splatgraph.trade(scene, cameras, only="sh_degree = 0", rounds=1, frames=1, file=victim)
    assert victim.read_bytes() == before and list(tmp_path.iterdir()) == [victim]


def test_advice_describes_the_scene_and_finds_a_setting_within_the_budget(scene, cameras):
    described = splatgraph.advise(scene, cameras[0])
    assert described.best is None and described.tried == () and described.key_bits and len(described.band_rms) == 2
    assert described.band_rms[1] > 0 and "splats" in str(described) and described.notes == ()
    found = splatgraph.advise(scene, cameras[0], "splat", psnr=30, rounds=1, frames=1)
    names = [tried.name for tried in found.tried]
    assert "exact" in names and all(len(tried.psnr_db) == 1 for tried in found.tried)
    assert found.notes and all(note.startswith("not measured: ") for note in found.notes)
    assert found.best is None or min(found.best.psnr_db) >= 30
    chosen = next(tried for tried in found.tried if tried.pipeline == "splat")
    drawn = splatgraph.Renderer(scene, chosen.pipeline, chosen.params).render(cameras[0])
    assert drawn.shape == (32, 40, 3)
    with pytest.raises(ValueError, match="psnr: expected a number above 0, found inf"):
        splatgraph.advise(scene, cameras[0], psnr=math.inf)


def test_an_exception_of_the_progress_ends_a_study(scene, cameras):
    class Enough(Exception):
        pass

    def stop(task, done, of, step):
        if task == "measuring" and done == 1:
            raise Enough

    with pytest.raises(Enough):
        splatgraph.trade(scene, cameras, rounds=1, frames=1, progress=stop)


LONG = """
import splatgraph, sys
sys.path.insert(0, {tests!r})
from conftest import random_splats
scene = splatgraph.Scene.from_arrays(*random_splats(7, 300, 1))
camera = splatgraph.Camera.look_at((0, 0, -2), (0, 0, 4), size=(200, 200))
try:
    splatgraph.trade(scene, camera, progress=lambda *step: print("step", flush=True))
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_ends_a_study():
    program = LONG.format(tests=str(ROOT / "python/tests"))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "step\n"
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    assert output.endswith("interrupted\n") and process.returncode == 0


def test_names_of_cameras_are_made_unique(scene):
    twice = [Camera.look_at((0.1 * i, 0, -2), (0, 0, 4), size=(24, 24)) for i in range(2)]
    found = splatgraph.trade(scene, twice, only=["exact"], rounds=1, frames=1)
    assert len({row["camera"] for row in found.rows}) == 2
