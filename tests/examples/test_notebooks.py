"""Both notebooks are run from the first cell to the last, as a reader would, and are kept without outputs."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
# What each must say, and how many pictures it must show.
PRINTED = {
    "read-a-grid.ipynb": (["known 91%", "not traversable: a sole here", "traversable, score", "xarray.Dataset"], 3),
    "foot-path.ipynb": (["refused: edge", "half-planes", "clearance 31 mm", "refused: unknown"], 3),
}


def test_all_are_listed_and_in_the_documents() -> None:
    """None is left out here, and each is linked from a page."""
    pages = "".join(path.read_text() for path in FOLDER.parent.glob("*.md"))
    assert {path.name for path in NOTEBOOKS} == set(PRINTED)
    assert all(f"notebooks/{path.name}" in pages for path in NOTEBOOKS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_kept_without_outputs(path: Path) -> None:
    """No picture or number of a past run, no name of a machine."""
    notebook = json.loads(path.read_text())
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(code) >= 4 and all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}


@pytest.mark.heavy
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path: Path) -> None:
    """In a kernel of its own, in its folder; it says what its text promises, and its pictures show something."""
    nbformat = pytest.importorskip("nbformat", reason="the extra `notebook` is not installed")
    nbclient = pytest.importorskip("nbclient", reason="the extra `notebook` is not installed")
    notebook = nbformat.read(path, 4)
    nbformat.validate(notebook)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(FOLDER)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    printed = "".join(output.get("text", "") or output.get("data", {}).get("text/plain", "") for output in outputs)
    expected, pictures = PRINTED[path.name]
    assert [text for text in expected if text not in printed] == [], printed
    shown = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    assert len(shown) == pictures
    for picture in shown:
        image = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR)
        assert image is not None and image.std() > 10
    assert not [output for output in outputs if output.get("name") == "stderr"]
