"""The site of documents: every public name is in the reference, and it builds without a warning."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import guara_perception as gp

ROOT = Path(__file__).parent.parent


def test_every_public_name_is_in_the_reference():
    """Each exactly once, and no other name of the package."""
    text = "".join(path.read_text() for path in sorted((ROOT / "docs" / "reference").glob("*.md")))
    named = re.findall(r"^::: guara_perception\.(\w+)$", text, re.MULTILINE)
    assert sorted(named) == sorted(gp.__all__)


def test_every_page_is_in_the_navigation():
    """A page that nobody can reach is not written."""
    navigation = (ROOT / "mkdocs.yml").read_text()
    for path in sorted((ROOT / "docs").rglob("*.md")):
        assert str(path.relative_to(ROOT / "docs")) in navigation


@pytest.mark.heavy
def test_site_builds_without_a_warning(tmp_path: Path):
    """`mkdocs build --strict`: links checked, every name of the reference found, with what its docstring says."""
    pytest.importorskip("mkdocs", reason="extra docs")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0 and done.stdout + done.stderr == ""
    page = (tmp_path / "reference" / "terrain" / "index.html").read_text()
    assert "check_foothold" in page and "Check positions for a sole that is aligned with x." in page
    assert "check_foothold" in (tmp_path / "search" / "search_index.json").read_text()
