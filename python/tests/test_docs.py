"""The listings of the pages on Python run."""

import json
import re

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
    # A comment beside a `print` is what it prints.
    for shape in re.findall(r"print\(colors.shape.*?# (.*)", listing):
        assert shape in printed
    assert "digit_bits=40" not in listing or "digit_bits" in printed.partition("error")[2]


def test_every_page_has_listings():
    assert {page for page, _ in LISTINGS} == set(PAGES) and len(LISTINGS) >= 6
