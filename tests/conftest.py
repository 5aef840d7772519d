"""Fixtures that any test may use: the recorded data, its true calibration, the robot, and terrain made of them."""

import gc
import json
import os
import shlex
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# Kernels of OpenBLAS differ in the last bit from processor to processor; frozen data were made with these. NumPy reads
# it when it is imported.
os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")

import guara_perception as gp
import hatch_build
from kinematics import RobotModel, load_robot
from testbed.truth import truth_calibration
from tests import forked, ports
from tests.mixed_order import mixed
from tests.thorough import examples

DATA = Path(__file__).parent / "data"

# A checkout whose kernel has changed since `make install`, or was never installed by itself.
if not hatch_build.is_current():
    hatch_build.compile_kernel()

# Tests that a shell starts in the background ignore Ctrl-C, and under `nohup` the end of a terminal; programs that they
# start would inherit this. With a handler that does nothing only the tests ignore the signal: a new program gets the
# default of the system.
for ignored in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(ignored) == signal.SIG_IGN:
        signal.signal(ignored, lambda *_: None)


# Collecting makes thousands of objects that all stay: looking through them for garbage takes a sixth of its time.
gc.disable()


def pytest_collection_finish() -> None:
    """From here on garbage is collected; objects made before are never searched."""
    gc.freeze()
    gc.enable()


# A machine that is busy makes no test fail: neither a deadline nor slowly made examples do.
settings.register_profile(
    "busy", max_examples=examples(100), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("busy")


def pytest_xdist_setupnodes(config: pytest.Config, specs: list[Any]) -> None:
    """Workers that share a core are forked where the tests are imported already: each would need seconds for it."""
    if len(specs) <= len(os.sched_getaffinity(0)):
        return  # It is quicker if all import at once than if one imports first.
    forked.start_server(*config.invocation_params.args)
    for spec in specs:
        if spec.popen:
            spec.python = shlex.join([sys.executable, "-I", "-S", forked.__file__])


def pytest_xdist_auto_num_workers() -> int:
    """Three workers per core, since tests wait for much of their time; with two, the cores idle for a fifth of it."""
    return int(os.environ.get("WORKERS_PER_CORE", "3")) * min(len(os.sched_getaffinity(0)), 4)


# Fixtures that start a program, or scan with devices that keep real time.
PROGRAMS = {
    "start",
    "start_program",
    "shared_node",
    "node",
    "bench",
    "rig",
    "emulator_process",
    "host",
    "module_endpoint",
    "fake",
}
# Folder below tests, and its fixtures of a whole calibration and of what goes into one.
CALIBRATED = ("guara_perception/calibration", {"result", "few_stripes"})


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Tests that start programs or calibrate are slow, wherever they stand; those that are not left out are mixed."""
    folder, calibrated = CALIBRATED
    for item in items:
        asked = set(getattr(item, "fixturenames", ()))
        if PROGRAMS & asked or (calibrated & asked and folder in item.path.as_posix()):
            item.add_marker(pytest.mark.slow)
    yield
    workers = int(getattr(config, "workerinput", {}).get("workercount", 1))
    if workers > len(os.sched_getaffinity(0)):
        items[:] = mixed(items, workers)


@pytest.fixture(scope="session")
def data() -> Path:
    """The recorded data, one specimen: `calibration/` and `scans/{paper,dark,tilt}`."""
    return DATA


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return DATA.parent.parent


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    """The Guará, immutable."""
    return load_robot("guara")


@pytest.fixture(scope="session")
def calibration() -> gp.Calibration:
    """The true calibration of the recorded data, immutable."""
    return truth_calibration(DATA)


@pytest.fixture(scope="session")
def calibration_file(calibration: gp.Calibration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`calibration` as a file; never write to it."""
    path = tmp_path_factory.mktemp("calibration") / "calibration.json"
    gp.save_calibration(calibration, path)
    return path


@pytest.fixture(scope="session")
def paper_scan() -> gp.Scan:
    """The recorded scan of five boxes."""
    return gp.open_scan(DATA / "scans" / "paper")


@pytest.fixture(scope="session")
def paper_terrain(paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel) -> gp.TerrainGrid:
    """Terrain of `paper_scan` with its pictures, immutable."""
    return gp.process_scan(paper_scan, calibration, robot)


@pytest.fixture
def edited_scan(tmp_path: Path) -> Callable[[Callable[[dict[str, Any]], object]], Path]:
    """Make a copy of the paper scan (frames linked) whose scan.json was changed by a function."""

    def make(change: Callable[[dict[str, Any]], object], name: str = "edited") -> Path:
        folder = tmp_path / name
        folder.mkdir()
        for frame in (DATA / "scans" / "paper").glob("*.jpg"):
            (folder / frame.name).symlink_to(frame)
        content = json.loads((DATA / "scans" / "paper" / "scan.json").read_text())
        change(content)
        (folder / "scan.json").write_text(json.dumps(content))
        return folder

    return make


@pytest.fixture
def paper_copy(tmp_path: Path) -> Path:
    """A copy of the paper scan whose files may be damaged."""
    return Path(shutil.copytree(DATA / "scans" / "paper", tmp_path / "paper"))


@pytest.fixture
def free_endpoint() -> str:
    """A Zenoh endpoint on this machine that nobody uses."""
    return ports.free_endpoint()
