"""CONTRIBUTING.md names files that are there: the ten to read, the subpackages, the makers of each form of a frame."""

import re
from pathlib import Path

import pytest

from benchmarks.__main__ import programs
from benchmarks.size import passed_functions

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text()


@pytest.mark.slow
def test_a_scan_passes_the_ten_files_in_their_order():
    """A trace of a recorded scan, from frames to bytes, enters the files in the order of the list."""
    named = re.findall(r"^\d+\. `([\w/]+\.py)`", TEXT.partition("**Ten files that a scan passes**")[2], re.MULTILINE)
    passed = list(dict.fromkeys(str(file) for file, _, _ in passed_functions()))
    assert len(named) == 10 and [file for file in passed if file in named] == named


def test_subpackages_of_the_picture_are_the_folders_there_are():
    """Every folder of the four packages is drawn, and nothing else."""
    picture = TEXT.partition("```text\nguara_perception/\n")[2].partition("```")[0]
    drawn = set(re.findall(r"(\w+)/(?=\s)", picture))
    packages = [ROOT / name for name in ("guara_perception", "transport", "drivers", "kinematics")]
    folders = (path.parent for package in packages for path in package.rglob("*/__init__.py"))
    assert drawn == {*(folder.name for folder in folders), "transport", "drivers", "kinematics"} - {"paper"}
    files = set(re.findall(r"\b(\w+\.py)\b", picture))
    assert all(any(list(package.rglob(name)) for package in packages) for name in files), files


def test_each_form_is_made_by_the_files_beside_its_arrow():
    """Each file is there and calls the form below; there are as many forms as the text says."""
    section = TEXT.partition("**Forms of a frame**")[2]
    picture = section.partition("```text")[2].partition("```")[0]
    forms: list[str] = []
    makers: list[str] = []
    for line in picture.splitlines():
        if line.lstrip().startswith("|"):
            makers = re.findall(r"(?:\w+/)*\w+\.py", line.partition(";")[0])
            continue
        made = re.findall(r"\b[A-Z]\w+[a-z]\b", line.partition("  -->")[0].removesuffix("on Zenoh, or in an MCAP file"))
        for path in makers if made else ():
            text = source(path)
            assert any(re.search(rf"\b{form}(\.of)?\(", text) for form in made), f"{path} makes no {' or '.join(made)}"
        forms += made if makers else []
    # A recorded scan has Scan and ScanStripe in place of a StripeCapture; layers, the object of guara_msgs and bytes
    # have no class here.
    assert len(forms) - 2 + 3 == 14 and "fourteen from a picture to bytes" in section, forms


def source(path: str) -> str:
    """The text of a file of the repository or of guara_perception."""
    return next(root / path for root in (ROOT, ROOT / "guara_perception") if (root / path).is_file()).read_text()


def test_targets_of_make_are_there():
    """Every target of `make` that the text names is in the Makefile."""
    makefile = (ROOT / "Makefile").read_text()
    names = {
        word
        for line in re.findall(r"`(?:make )?((?:test-|make )[\w -]*)`", TEXT)
        for word in line.split()
        if word != "make"
    }
    assert len(names) > 6
    groups = re.search(r"^GROUPS := (.*)$", makefile, re.MULTILINE)[1].split()
    targets = {
        *re.findall(r"^([\w-]+):", makefile, re.MULTILINE),
        *(f"test-{group}" for group in groups),
        "test-robots",
    }
    assert names - targets == set()


def test_every_benchmark_is_named_on_a_page():
    """With what it is good for: in the documents, or in the table of tests."""
    pages = TEXT + "".join(page.read_text() for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")))
    named = {*re.findall(r"benchmarks[. ](\w+)", pages), *re.findall(r"`(\w+)(?: --\w+)?`", TEXT)}
    assert set(programs()) - named == set()
