"""The notebooks run, and their pictures show something."""

import base64
import io

import numpy as np
import pytest
from conftest import ROOT

nbclient = pytest.importorskip("nbclient", reason="nbclient cannot be installed")
nbformat = pytest.importorskip("nbformat", reason="nbformat cannot be installed")
pytest.importorskip("ipykernel", reason="ipykernel cannot be installed")
pytest.importorskip("PIL", reason="pillow cannot be installed")
import PIL.Image

NOTEBOOKS = sorted((ROOT / "python/examples").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_pictures(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "it is kept without its outputs"
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    files = [base64.b64decode(output["data"]["image/png"]) for output in outputs if "image/png" in output.get("data", {})]
    assert len(files) >= 4
    for file in files:
        picture = np.asarray(PIL.Image.open(io.BytesIO(file)))
        assert picture.shape == (270, 480, 3) and picture.std() > 5
    text = "".join(output.get("text", "") for output in outputs)
    assert "splats are visible" in text and "<table>" in str(outputs)
