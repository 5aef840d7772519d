"""Files import in one direction: no file imports, directly or through others, a file that imports it."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PRODUCT = ("kinematics", "drivers", "transport", "guara_perception")
PACKAGES = (*PRODUCT, "testbed", "benchmarks")
# Folder -> folders whose files it must not import; pytest, too, is for tests alone.
NEVER_IMPORTED = {
    **dict.fromkeys((*PRODUCT, "examples"), {"testbed", "benchmarks", "tests", "pytest"}),
    "testbed": {"benchmarks", "tests", "pytest"},
    "benchmarks": {"tests", "pytest"},
    "tests": {"benchmarks"},
}
# They are about the benchmarks.
TESTS_OF_BENCHMARKS = ("tests/benchmarks/", "tests/test_contributing.py")


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
    for node in statements(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Every statement below a node; nothing is imported inside an expression, and those are most of a file."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.expr):
            yield child
            yield from statements(child)


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    """File -> files that it imports."""
    found = modules()
    return {name: set(imported(path.read_text(), set(found))) for name, path in found.items()}


@pytest.mark.slow
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
        core = ("calibration", "stripes", "ranging", "scanning", "terrain")
        if name.startswith(tuple(f"guara_perception.{folder}" for folder in core)):
            above = ("drivers", "transport", "guara_perception.app", "guara_perception.view")
            assert not [u for u in used if u.startswith(above)], f"{name} imports {sorted(used)}"


def roots_imported(text: str) -> set[str]:
    """Packages that a text imports, wherever it does."""
    found = set()
    for node in statements(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("folder", NEVER_IMPORTED)
def test_product_testbed_and_benchmarks_know_no_tests(folder: str):
    """Tests and benchmarks import the test bench, the test bench the product; nothing imports the other way round."""
    paths = [path for path in (ROOT / folder).rglob("*.py") if "node_modules" not in path.parts]
    assert paths
    for path in paths:
        if not path.relative_to(ROOT).as_posix().startswith(TESTS_OF_BENCHMARKS):
            wrong = roots_imported(path.read_text()) & NEVER_IMPORTED[folder]
            assert not wrong, f"{path.relative_to(ROOT)} imports {sorted(wrong)}"


TERRAIN = {
    "terrain",
    *(f"terrain.{subpackage}" for subpackage in ("layers", "assessment", "questions", "map", "scan", "drawing")),
}
CORE = {"stripes", "stripes.kernel", "calibration", "ranging", *TERRAIN}
# Subpackage of guara_perception -> the other subpackages that it may import; the files beside the subpackages are free.
MAY_IMPORT = {
    "stripes.kernel": set(),
    "stripes": {"stripes.kernel"},
    "calibration": {"stripes", "stripes.kernel"},
    "ranging": {"stripes", "stripes.kernel", "calibration", "terrain.layers", "terrain.assessment"},
    "terrain.layers": set(),
    "terrain.assessment": {"terrain.layers", "stripes.kernel"},
    "terrain.drawing": {"terrain.layers"},
    "terrain.questions": {"terrain.layers", "terrain.assessment"},
    "terrain": {"terrain.layers", "terrain.questions", "terrain.drawing"},
    "terrain.map": {"terrain", "terrain.layers", "terrain.assessment"},
    "terrain.scan": {"terrain", "terrain.layers", "terrain.assessment", "terrain.map"},
    "scanning": {
        "stripes",
        "stripes.kernel",
        "calibration",
        "ranging",
        "terrain",
        "terrain.layers",
        "terrain.assessment",
    },
    "view": TERRAIN,
    "simulation": CORE,
    "app": {*CORE, "scanning", "view", "simulation"},
}


def subpackage_of(name: str) -> str | None:
    """Subpackage of a file of guara_perception, None for a file beside the subpackages and for other packages."""
    package, *parts = name.split(".")
    if (
        package != "guara_perception"
        or not parts
        or parts[0] not in {subpackage.split(".")[0] for subpackage in MAY_IMPORT}
    ):
        return None
    inner = ".".join(parts[:2])
    return inner if inner in MAY_IMPORT else parts[0]


def test_subpackages_import_in_one_direction(graph: dict[str, set[str]]):
    """Each subpackage imports those below it and no other, and every folder is a subpackage or lies in one."""
    for name, used in graph.items():
        subpackage = subpackage_of(name)
        if subpackage is not None:
            above = {other for other in used if subpackage_of(other) not in (None, subpackage, *MAY_IMPORT[subpackage])}
            assert not above, f"{name} of {subpackage!r} imports {sorted(above)}"
    folders = {path.parent.name for path in (ROOT / "guara_perception").glob("*/__init__.py")}
    assert folders == {subpackage.split(".")[0] for subpackage in MAY_IMPORT}


# Files beside the rooms of transport that the rooms may use; the others are made of the rooms.
BELOW = {"arrays", "clock", "configuration", "exceptions", "keys", "supervision", "zenoh_api"}
TRANSPORT_MAY_IMPORT = {
    "messages": {"arrays", "exceptions", "keys"},
    "recording": {"arrays", "exceptions", "keys", "messages"},
    "security": {"configuration", "exceptions", "keys", "messages", "zenoh_api"},
    "links": {*BELOW, "messages", "security"},
    "queries": {*BELOW, "messages", "links"},
    "grids": {*BELOW, "messages", "links", "queries"},
}


def test_rooms_of_the_transport_import_in_one_direction(graph: dict[str, set[str]]):
    """Messages and recordings know no Zenoh; security opens no session; links do not know what goes over them."""
    seen = set()
    for name, used in graph.items():
        package, _, inner = name.partition(".")
        room = inner.split(".")[0]
        if package == "transport" and room in TRANSPORT_MAY_IMPORT:
            seen.add(room)
            above = {other.split(".")[1] for other in used} - {room} - TRANSPORT_MAY_IMPORT[room]
            assert not above, f"{name} imports {sorted(above)}"
    assert (
        seen == set(TRANSPORT_MAY_IMPORT) == {path.parent.name for path in (ROOT / "transport").glob("*/__init__.py")}
    )


DRIVERS_MAY_IMPORT = {
    "board": set(),
    "cameras": set(),
    "sweep": {"board", "cameras"},
    "emulator": {"board", "cameras"},
}


def test_rooms_of_the_drivers_import_in_one_direction(graph: dict[str, set[str]]):
    """Board and cameras know nothing of each other, nor of scans with both; the files beside the rooms know no room."""
    rooms = {
        name: name.split(".")[1] if name.count(".") == 2 else None for name in graph if name.startswith("drivers.")
    }
    assert set(rooms.values()) == {None, *DRIVERS_MAY_IMPORT}
    for name, room in rooms.items():
        if room or name.removeprefix("drivers.") not in DRIVERS_MAY_IMPORT:
            allowed = {None, room, *DRIVERS_MAY_IMPORT.get(room or "", set())}
            above = {other for other in graph[name] if rooms.get(other) not in allowed}
            assert not above, f"{name} imports {sorted(above)}"


@pytest.mark.parametrize(
    "path",
    sorted(
        path
        for package in ("guara_perception", "transport", "drivers")
        for path in (ROOT / package).rglob("*/__init__.py")
    ),
    ids=lambda p: p.parent.name,
)
def test_each_folder_says_what_lives_there_and_who_imports_it(path: Path):
    """One line for what, then who imports it, or what it imports; at most six lines in all."""
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    what, _, who = text.partition("\n\n")
    assert what and "\n" not in what, f"{path}: the first paragraph is one line that says what lives there"
    assert "import" in who.lower() and len(text.splitlines()) <= 6, (
        f"{path}: then who imports it, in two or three lines"
    )


@pytest.mark.parametrize(
    "text",
    ["import a.b", "from a.b import c", "from a import b", "def f():\n    from a import b", "if T:\n    import a.b"],
)
def test_every_kind_of_import_is_seen(text: str):
    """Imports of a module and from it, late, and under a condition, are all found."""
    assert list(imported(text, {"a", "a.b"})) == ["a.b"]
