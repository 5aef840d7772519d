"""The public names: all of them there, each where the table says, and cheap to import."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import guara_perception as gp

ROOT = Path(__file__).parents[2]
# Names of the user's side; what a planner's code may rely on.
PROMISED = """
Calibration Foothold FootholdVerdict Hazard Obstacle PerceptionError Scan ScanBusy ScanFailed ScanProcessor ScanTimeout
ScannerGone ScannerUnavailable StaleTerrain StripeStatus TerrainClient TerrainGrid assess_terrain calibrate
extract_stripe load_calibration load_robot load_terrain open_scan process_scan
""".split()
# Heavy or with side effects: loaded when first used.
HEAVY = ["pinocchio", "scipy", "matplotlib", "zenoh", "cv2", "rosbags", "mcap", "usb", "mujoco", "viser", "rich"]


@pytest.mark.slow
def test_type_checkers_see_every_name(tmp_path: Path):
    """`mypy --strict` knows each of them, by attribute and by `import *`, and refuses names and layers that are not."""
    (tmp_path / "user.py").write_text(
        "from guara_perception import *\nimport guara_perception as gp\n"
        + "".join(f"{name}, gp.{name}\n" for name in gp.__all__)
        + "gp.proces_scan\n"
        + "def user(terrain: TerrainGrid) -> None:\n    terrain.elevation.mean(), terrain.swing, terrain.elevatoin\n"
    )
    root = Path(gp.__file__).parents[1]
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", str(tmp_path / "user.py")]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    errors = [line for line in done.stdout.splitlines() if ": error:" in line]
    assert len(errors) == 2, done.stdout + done.stderr
    assert 'has no attribute "proces_scan"' in errors[0] and 'has no attribute "elevatoin"' in errors[1]


@pytest.mark.parametrize("name", gp.__all__)
def test_every_public_name_loads_from_its_module(name: str):
    """Each name of the table is there, and is the same object as in its module."""
    assert getattr(gp, name) is getattr(importlib.import_module(gp._MODULES[name]), name)
    assert name in dir(gp)


@pytest.mark.slow
def test_star_import_brings_every_public_name():
    """`from guara_perception import *` loads each name, in a fresh process."""
    code = "from guara_perception import *; import guara_perception as gp; print(set(gp.__all__) - set(dir()))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"


@pytest.mark.parametrize("name", PROMISED)
def test_promised_names_are_public(name: str):
    """Every name that users were promised is there."""
    assert name in gp.__all__


def test_what_is_listed_is_what_there_is():
    """Completion shows the public names and no tool of the module; `help(gp)` begins with names that exist."""
    assert [name for name in dir(gp) if not name.startswith("__")] == sorted(gp.__all__)
    listed = [line[4:34] for line in gp.__doc__.splitlines() if line.startswith("    ")]
    names = ", ".join(listed).replace(" ", "").split(",")
    assert len(names) >= 10 and set(names) <= set(gp.__all__)


def test_unknown_name_is_refused_with_the_list():
    """A typo is answered with the names there are."""
    with pytest.raises(AttributeError, match="guara_perception has no attribute 'proces_scan'; it has .*process_scan"):
        gp.proces_scan  # noqa: B018


def test_importing_the_package_loads_nothing_heavy():
    """In a fresh process `import guara_perception` loads no heavy library and no other package of the project."""
    code = "import guara_perception, json, sys; print(json.dumps(sorted(sys.modules)))"
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    loaded = set(json.loads(output))
    assert not loaded & {*HEAVY, "kinematics", "transport", "drivers"}


def test_errors_come_from_one_root_and_from_the_builtin_that_fits():
    """`except ValueError` and `except gp.PerceptionError` both work."""
    for name in ("CalibrationMismatch", "FileFormatError", "InvalidInput"):
        assert issubclass(getattr(gp, name), (gp.PerceptionError)) and issubclass(getattr(gp, name), ValueError)
    assert issubclass(gp.MissingFile, gp.PerceptionError) and issubclass(gp.MissingFile, FileNotFoundError)
    assert issubclass(gp.CalibrationRefused, RuntimeError) and issubclass(gp.UnsafeGrid, RuntimeError)
    # A root alone is of no builtin, so nothing raises one.
    raised = re.compile(rf"raise ({'|'.join(root.__name__ for root in gp.Errors)})\b")
    for package in ("guara_perception", "kinematics", "transport", "drivers"):
        for path in (ROOT / package).rglob("*.py"):
            assert not raised.search(path.read_text()), path


@pytest.mark.parametrize("name", ["kinematics", "transport"])
@pytest.mark.parametrize("first", ["", "import {name}; "])
def test_a_file_of_the_users_own_in_the_way_is_named(tmp_path: Path, name: str, first: str):
    """A user's `kinematics.py` beside the script hides the package; the error names that file."""
    (tmp_path / f"{name}.py").write_text("gravity = 9.81\n")
    (tmp_path / "user.py").write_text(f"{first.format(name=name)}import guara_perception as gp\ngp.open_scan\n")
    done = subprocess.run([sys.executable, "user.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert f"ImportError: {tmp_path / name}.py hides the package `{name}` that guara_perception needs" in done.stderr


@pytest.mark.slow
def test_no_node_is_scanner_unavailable():
    """Whoever catches ScannerUnavailable also catches that nobody listens at the endpoint."""
    assert issubclass(gp.ConnectionFailed, gp.ScannerUnavailable)
    with pytest.raises(gp.ScannerUnavailable, match="127.0.0.1:9"):
        gp.TerrainClient("tcp/127.0.0.1:9", timeout=0.5)
