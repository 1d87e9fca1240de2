"""Runs the listings of the documentation."""

import json
import os
import re
import subprocess
import sys

import pytest
import splatgraph
from conftest import ROOT, random_splats

PAGES = ["docs/python.md", "README.md", "python/README.md"]
LISTINGS = [(page, text) for page in PAGES for text in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)]
CAMERA = {"width": 64, "height": 48, "position": [0, 0, -3], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 60, "fy": 60}


@pytest.mark.parametrize("page, listing", LISTINGS, ids=[f"{page}-{i}" for i, (page, _) in enumerate(LISTINGS)])
def test_a_listing_of_a_page_runs(page, listing, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    splatgraph.Scene.from_arrays(*random_splats(7, 300, 1)).save("scene.ply")
    (tmp_path / "cameras.json").write_text(json.dumps([CAMERA]))
    exec(compile(listing, page, "exec"), {})
    printed = capsys.readouterr().out
    # The comment beside a `print` is the expected output.
    for shape in re.findall(r"print\(colors.shape.*?# (.*)", listing):
        assert shape in printed
    assert "digit_bits=40" not in listing or "digit_bits" in printed.partition("error")[2]


COMMANDS = [text for text in re.findall(r"```sh\n(.*?)```", (ROOT / "docs/many.md").read_text(), re.DOTALL)]


@pytest.mark.parametrize("listing", COMMANDS, ids=[f"docs/many.md-{i}" for i in range(len(COMMANDS))])
def test_a_listing_of_commands_runs(listing, tmp_path):
    if "splatgraph.ray" in listing:
        pytest.importorskip("ray", reason="Ray cannot be installed")
    splatgraph.Scene.from_arrays(*random_splats(7, 300, 1)).save(tmp_path / "scene.ply")
    (tmp_path / "cameras.json").write_text(json.dumps([CAMERA | {"img_name": name} for name in ("one", "two", "three")]))
    photograph = ["synth", "--photograph", "scene.ply", "--dataset", "dataset", "--views", "2", "--size", "32x24"]
    # This interpreter's programs come first in PATH. The Slurm variables are those of an array of one job.
    path = f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "SLURM_ARRAY_TASK_ID": "0", "SLURM_ARRAY_TASK_COUNT": "1"}
    if "dataset" in listing:
        subprocess.run(["splatgraph", *photograph], cwd=tmp_path, check=True, env=environment)
    ended = subprocess.run(["bash", "-e", "-c", listing], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    for result in ("out/three.png", "ledger/ledger.html", "scores/job.json"):
        assert result.partition("/")[0] + "/" not in listing or result in left, (result, left)


def test_every_page_has_listings():
    assert len(COMMANDS) >= 4
    assert {page for page, _ in LISTINGS} == set(PAGES) and len(LISTINGS) >= 6
