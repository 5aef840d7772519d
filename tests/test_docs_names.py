"""Files, tests and names that the documents mention are there."""

import re
from functools import cache
from pathlib import Path

import pytest

import guara_perception as gp

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
FOLDERS = "tests|testbed|benchmarks|examples|guara_perception|kinematics|drivers|transport|robots|firmware|ros"
# Made by whoever follows the page.
MADE = {"robots/mine/robot.toml", "robots/mine/README.md", "firmware/build/"}


@cache
def all_tests() -> set[str]:
    """Names of all tests and of the files that hold them."""
    files = list((ROOT / "tests").rglob("test_*.py"))
    return {path.stem for path in files} | set(
        re.findall(r"def (test_\w+)", "".join(path.read_text() for path in files))
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_names_is_there(page: Path) -> None:
    """Paths below the folders of the repository, tests, and public names of `gp`."""
    text = page.read_text()
    paths = set(re.findall(rf"`((?:{FOLDERS})/[\w./-]+)`", text)) - MADE
    assert not {path for path in paths if not (ROOT / path).exists()}
    assert set(re.findall(r"\b(test_[a-z0-9_]+)\b", text)) <= all_tests()
    assert not {name for name in re.findall(r"`gp\.(\w+)", text) if not hasattr(gp, name)}


def test_paths_are_found() -> None:
    """The pages name files and tests at all."""
    text = "".join(page.read_text() for page in PAGES)
    assert len(re.findall(rf"`(?:{FOLDERS})/[\w./-]+`", text)) > 30
    assert len(set(re.findall(r"\btest_[a-z0-9_]+\b", text))) > 30


def test_each_list_of_pages_has_at_most_20_000_words() -> None:
    """The three lists of index.md name every page; tables of performance.md are made by a program, not counted."""
    lists = (ROOT / "docs" / "index.md").read_text().split("\n## ")[1:]
    assert len(lists) == 3
    named = [re.findall(r"\]\(([\w-]+\.md)\)|`(CONTRIBUTING\.md)`", text) for text in lists]
    pages = [{ROOT / "docs" / page if page else ROOT / guide for page, guide in found} for found in named]
    assert set().union(*pages) >= {*(ROOT / "docs").glob("*.md")} - {ROOT / "docs" / "index.md"}
    for each in pages:
        assert sum(written_words(page) for page in each) <= 20_000, [page.name for page in each]


def written_words(page: Path) -> int:
    """Words of a page without tables that a program makes."""
    text = page.read_text()
    return len((re.sub(r"^\|.*$", "", text, flags=re.MULTILINE) if page.name == "performance.md" else text).split())
