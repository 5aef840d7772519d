"""CONTRIBUTING.md names files that are there: the ten to read, the rooms, and the makers of each form of a frame."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text()


def test_ten_files_are_named_and_there():
    """A numbered list of ten files, each of which exists."""
    named = re.findall(r"^\d+\. `([\w/]+\.py)`", TEXT.partition("**Ten files")[2], re.MULTILINE)
    assert len(named) == 10 and all((ROOT / name).is_file() for name in named), named


def test_rooms_of_the_picture_are_the_folders_there_are():
    """Every folder of perception and of the transport is drawn, and nothing else."""
    picture = TEXT.partition("```text\nguara_perception/\n")[2].partition("```")[0]
    drawn = set(re.findall(r"(\w+)/(?=\s)", picture))
    packages = (ROOT / "guara_perception", ROOT / "transport")
    folders = (path.parent for package in packages for path in package.rglob("*/__init__.py"))
    assert drawn == {*(folder.name for folder in folders), "transport"} - {"paper"}
    files = set(re.findall(r"\b(\w+\.py)\b", picture))
    assert all(any(list(package.rglob(name)) for package in packages) for name in files), files


def test_makers_of_the_forms_are_there():
    """Each path beside an arrow is a file or folder of the repository or of guara_perception."""
    picture = TEXT.partition("**The forms a frame goes through**")[2].partition("```text")[2].partition("```")[0]
    paths = re.findall(r"\b((?:\w+/)+(?:\w+\.py)?)", picture)
    assert len(paths) > 10
    for path in paths:
        assert (ROOT / path).exists() or (ROOT / "guara_perception" / path).exists(), path
