"""The site of documents: every public name is in the reference, and it builds without a warning."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import drivers
import guara_perception as gp
import kinematics
import transport

ROOT = Path(__file__).parent.parent


def test_every_public_name_is_in_the_reference():
    """Each exactly once, and no other name of the package."""
    text = "".join(path.read_text() for path in sorted((ROOT / "docs" / "reference").glob("*.md")))
    named = re.findall(r"^::: guara_perception\.(\w+)$", text, re.MULTILINE)
    assert sorted(named) == sorted(gp.__all__)


@pytest.mark.parametrize("package", [drivers, kinematics, transport], ids=lambda package: package.__name__)
def test_every_public_name_of_the_other_packages_is_in_the_reference(package: ModuleType):
    """Each exactly once; those that are names of `gp` too stand under that name."""
    text = "".join(path.read_text() for path in sorted((ROOT / "docs" / "reference").glob("*.md")))
    named = re.findall(rf"^::: {package.__name__}\.(\w+)$", text, re.MULTILINE)
    init = Path(package.__file__ or "").read_text()
    public = getattr(package, "__all__", None) or re.findall(r"^from \S+ import (\w+) as \1$", init, re.MULTILINE)
    shared = {name for name in public if name in gp.__all__ and getattr(gp, name) is getattr(package, name)}
    assert len(public) > 30 and sorted(named) == sorted({*public} - shared)


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
    gait = (tmp_path / "reference" / "transport" / "index.html").read_text()
    assert "StancePublisher" in gait and "time_available" in gait
    page = (tmp_path / "reference" / "terrain" / "index.html").read_text()
    assert "check_foothold" in page and "Check if a sole aligned with the x axis may be placed at" in page
    assert "check_foothold" in (tmp_path / "search" / "search_index.json").read_text()
