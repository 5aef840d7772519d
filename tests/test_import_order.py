"""Files import in one direction: no file needs, by any way round, one that needs it."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("kinematics", "drivers", "transport", "guara_perception", "benchmarks")


def modules() -> dict[str, Path]:
    """Every file of the packages by the name under which it is imported."""
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(text: str, known: set[str]) -> Iterator[str]:
    """Files that a text imports: at once, when a function is called, or for type checkers alone."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    """File -> files that it imports."""
    found = modules()
    return {name: set(imported(path.read_text(), set(found))) for name, path in found.items()}


def test_there_are_no_circles_between_files(graph: dict[str, set[str]]):
    """The files can be put in an order in which each imports only earlier ones, late imports counted too."""
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail("these files import one another: " + " <- ".join(error.args[1]))
    assert len(order) == len(graph) > 100


def test_packages_import_in_one_direction(graph: dict[str, set[str]]):
    """The three lower packages import themselves alone; the core of perception no device, message or program."""
    for name, used in graph.items():
        package = name.split(".")[0]
        others = {other for other in used if other.split(".")[0] != package}
        if package in ("kinematics", "drivers", "transport"):
            assert not others, f"{name} imports {sorted(others)}"
        if name.startswith(tuple(f"guara_perception.{p}" for p in ("calibration", "stripes", "ranging", "terrain"))):
            above = ("drivers", "transport", "guara_perception.app", "guara_perception.view", "benchmarks")
            assert not [u for u in used if u.startswith(above)], f"{name} imports {sorted(used)}"


@pytest.mark.parametrize(
    "text",
    ["import a.b", "from a.b import c", "from a import b", "def f():\n    from a import b", "if T:\n    import a.b"],
)
def test_every_kind_of_import_is_seen(text: str):
    """Imports of a module and from it, late, and under a condition, are all found."""
    assert list(imported(text, {"a", "a.b"})) == ["a.b"]
