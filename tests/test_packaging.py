"""The two wheels carry what the packages need, and the lock installs on every Python that the project allows."""

import json
import os
import platform
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from email.message import Message
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name
from packaging.version import Version

import hatch_build

pytestmark = pytest.mark.slow

PACKAGES = ["guara_perception", "kinematics", "transport", "drivers"]
# The stock robots are 230 MB: a lock of their own.
ROBOTS_LOCK, ROBOTS_EXTRA = "requirements-robots.lock", "robots-test"
LOCKS = ["requirements.lock", "requirements-extras.lock", ROBOTS_LOCK]


@pytest.fixture(scope="module")
def project(root: Path) -> dict:
    """pyproject.toml."""
    return tomllib.loads((root / "pyproject.toml").read_text())


@pytest.fixture(scope="module")
def client_project() -> dict:
    """pyproject.toml of guara-client."""
    return tomllib.loads((hatch_build.CLIENT / "pyproject.toml").read_text())


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of guara-perception, built from the checkout; without any network where there is a compiler."""
    folder = tmp_path_factory.mktemp("wheel")
    if hatch_build.native_compiler() or find_spec("ziglang"):
        return build_wheel(root, folder)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), "."]
    subprocess.run(command, cwd=root, check=True, capture_output=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def client_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of guara-client, built from its source distribution, as it is published."""
    folder = tmp_path_factory.mktemp("client")
    build(hatch_build.CLIENT, folder, "sdist")
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        # Python 3.11 has filters from 3.11.4 on only; Debian 12 has 3.11.2.
        archive.extractall(folder, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    return build_wheel(next(path for path in folder.iterdir() if path.is_dir()), folder)


@pytest.fixture(scope="module")
def unpacked(wheel: Path, client_wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The content of both wheels as an installer lays it out, outside of the checkout."""
    folder = tmp_path_factory.mktemp("site")
    for each in (wheel, client_wheel):
        with zipfile.ZipFile(each) as archive:
            archive.extractall(folder)
    return folder


def build(project: Path, folder: Path, target: str) -> None:
    """Build a distribution of a project into a folder."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(folder)]
    subprocess.run(command, cwd=project, check=True, capture_output=True)


def build_wheel(project: Path, folder: Path) -> Path:
    """The wheel of a project, built into a folder."""
    build(project, folder, "wheel")
    (built,) = folder.glob("*.whl")
    return built


def files_of(wheel: Path) -> set[str]:
    """Names of the files in a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def metadata_of(wheel: Path) -> Message:
    """What a wheel says of itself."""
    (name,) = (name for name in files_of(wheel) if name.endswith(".dist-info/METADATA"))
    with zipfile.ZipFile(wheel) as archive:
        return message_from_bytes(archive.read(name))


def from_wheel(unpacked: Path, folder: Path, *arguments: str) -> str:
    """Output of Python started in `folder` with the unpacked wheel before the checkout."""
    environment = {**os.environ, "PYTHONPATH": str(unpacked)}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, check=True, capture_output=True, text=True
    ).stdout


def tracked(root: Path, folder: str) -> set[str]:
    """Files below a folder of the checkout, without what Python makes."""
    files = (path.relative_to(root) for path in (root / folder).rglob("*") if path.is_file())
    return {str(path) for path in files if "__pycache__" not in path.parts and path.suffix != ".pyc"}


def test_wheels_carry_every_file_of_the_packages(root: Path, wheel: Path, client_wheel: Path):
    """Modules, types, message definitions, the robot: all that stands in the packages is in one of the wheels."""
    names = files_of(wheel) | files_of(client_wheel)
    for folder in (*PACKAGES, "robots"):
        assert tracked(root, folder) <= names
    for package in PACKAGES:
        assert f"{package}/py.typed" in names
    for name in ("robots/guara/robot.toml", "robots/guara/urdf/guara.urdf", "robots/guara/srdf/guara.srdf"):
        assert name in names
    assert "transport/msg/Terrain.msg" in names


def test_no_file_is_in_both_wheels(wheel: Path, client_wheel: Path):
    """Each can be removed without the other: none holds a file of the other."""
    assert not files_of(wheel) & files_of(client_wheel)


def test_client_is_for_any_machine_and_has_no_devices(client_wheel: Path):
    """Pure Python, the three packages that a planner needs, and nothing else."""
    assert client_wheel.name.endswith("-py3-none-any.whl")
    tops = {name.split("/")[0] for name in files_of(client_wheel)}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"guara_perception", "kinematics", "transport"}


def test_perception_needs_the_client_of_the_same_version(
    root: Path, wheel: Path, client_wheel: Path, project: dict, client_project: dict
):
    """Version, Python, licences and requirements agree; from a checkout it needs the client of that checkout."""
    ours, theirs = project["project"], client_project["project"]
    for name in ("version", "requires-python", "license", "authors"):
        assert ours[name] == theirs[name], name
    assert {Requirement(each).name for each in theirs["dependencies"]} <= {
        Requirement(each).name for each in ours["dependencies"]
    }
    needed = metadata_of(wheel).get_all("Requires-Dist")
    assert f"guara-client @ {hatch_build.CLIENT.as_uri()}" in needed
    assert not [each for each in metadata_of(client_wheel).get_all("Requires-Dist") if "guara" in each]
    assert (hatch_build.CLIENT / "LICENSE").read_text() == (root / "LICENSE").read_text()
    licences = {name.partition("licenses/")[2] for name in files_of(client_wheel) if "licenses/" in name}
    assert licences == {"LICENSE", "transport/msg/standard/LICENSE"}


def test_wheel_is_for_this_machine_and_any_python(wheel: Path):
    """Compiled, but not against Python; with a library for each kind of processor."""
    machine = platform.machine()
    assert wheel.name.endswith(f"-py3-none-linux_{machine}.whl")
    names = {Path(name).name for name in files_of(wheel)}
    assert {f"{processor}.so" for processor in hatch_build.PROCESSORS[machine]} <= names


def test_wheels_carry_nothing_else(wheel: Path, client_wheel: Path):
    """No test bench, tests, data, benchmarks or caches travel along."""
    names = files_of(wheel) | files_of(client_wheel)
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {*PACKAGES, "robots"}
    assert not [name for name in names if "__pycache__" in name]


def test_wheel_needs_nothing_that_stays_in_the_checkout(unpacked: Path):
    """No module of the wheel imports the test bench, tests or benchmarks, nor starts a program of theirs."""
    modules = list(unpacked.rglob("*.py"))
    assert len(modules) > 300
    left = re.compile(
        r"^\s*(?:from|import) (?:testbed|tests|benchmarks)\b|[\"'](?:testbed|tests|benchmarks)\.", re.MULTILINE
    )
    assert not [str(path.relative_to(unpacked)) for path in modules if left.search(path.read_text())]


def test_robot_loads_from_the_wheel(unpacked: Path, tmp_path: Path):
    """In a fresh process outside of the checkout `load_robot("guara")` finds the folder of the wheel."""
    code = (
        "import json, kinematics; r = kinematics.load_robot('guara'); "
        "print(json.dumps([kinematics.__file__, str(r.folder), r.name, len(r.joint_names)]))"
    )
    module, folder, name, joints = json.loads(from_wheel(unpacked, tmp_path, "-c", code))
    assert Path(module).is_relative_to(unpacked) and Path(folder) == unpacked / "robots" / "guara"
    assert (name, joints) == ("guara", 16)


def test_messages_encode_from_the_wheel(unpacked: Path, tmp_path: Path):
    """The message definitions are found where the wheel puts them."""
    code = "import transport.messages.typestore as t; print(t.__file__); print(t.message_class(t.TERRAIN).__msgtype__)"
    module, name = from_wheel(unpacked, tmp_path, "-c", code).split()
    assert Path(module).is_relative_to(unpacked) and name == "guara_msgs/msg/Terrain"


def test_command_works_from_the_wheel(unpacked: Path, tmp_path: Path, data: Path, calibration_file: Path):
    """A recorded scan is processed by the wheel alone, in any folder."""
    scan = str(data / "scans" / "paper")
    arguments = ["-m", "guara_perception.app.main", "process", scan, "-c", str(calibration_file), "-o", "out.npz"]
    assert from_wheel(unpacked, tmp_path, *arguments).startswith("out.npz: step 0, coarse, 90x108 cells")
    assert (tmp_path / "out.npz").is_file()


def test_wheel_says_what_it_is(unpacked: Path, project: dict):
    """Name, version, Python, licence and the console command stand in its metadata."""
    (info,) = unpacked.glob("guara_perception-*.dist-info")
    metadata = (info / "METADATA").read_text()
    assert f"Version: {project['project']['version']}" in metadata
    assert "License-Expression: BSD-3-Clause" in metadata and (info / "licenses" / "LICENSE").is_file()
    allowed = re.search(r"^Requires-Python: (.*)$", metadata, re.MULTILINE).group(1)
    assert SpecifierSet(allowed) == SpecifierSet(project["project"]["requires-python"])
    assert "guara = guara_perception.app.main:main" in (info / "entry_points.txt").read_text()


def pythons(project: dict) -> list[str]:
    """Minor versions that `requires-python` allows."""
    allowed = SpecifierSet(project["project"]["requires-python"])
    return [f"3.{minor}" for minor in range(30) if f"3.{minor}.5" in allowed]


def test_classifiers_and_the_makefile_name_the_same_pythons(root: Path, project: dict):
    """requires-python, the classifiers and the check in the Makefile agree."""
    listed = re.findall(r"Python :: (3\.\d+)", " ".join(project["project"]["classifiers"]))
    assert listed == pythons(project)
    low, high = re.search(r"\((3, \d+)\) <= .* < \((3, \d+)\)", (root / "Makefile").read_text()).groups()
    bounds = SpecifierSet(f">={low.replace(', ', '.')},<{high.replace(', ', '.')}")
    assert bounds == SpecifierSet(project["project"]["requires-python"])


def locked(path: Path) -> list[tuple[Requirement, int]]:
    """Requirements of a lock file, each with the number of its hashes."""
    entries = re.split(r"\n(?=\S)", re.sub(r"^\s*#.*\n", "", path.read_text(), flags=re.MULTILINE).strip())
    return [(Requirement(entry.split("\\")[0].strip()), entry.count("--hash=sha256:")) for entry in entries]


def wanted(project: dict, lock: str) -> list[Requirement]:
    """What a lock must hold."""
    extras = project["project"]["optional-dependencies"]
    others = [name for name in extras if name != ROBOTS_EXTRA]
    names = {"requirements.lock": ["dev"], ROBOTS_LOCK: ["dev", ROBOTS_EXTRA]}.get(lock, others)
    listed = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    return [Requirement(text) for text in (*listed, *(text for name in names for text in extras[name]))]


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_covers_every_dependency_on_every_python(root: Path, project: dict, lock: str):
    """On each allowed Python exactly one locked version applies to each dependency, within its bounds."""
    entries = [requirement for requirement, _ in locked(root / lock)]
    for python in pythons(project):
        environment = {
            "python_version": python,
            "python_full_version": f"{python}.5",
            "sys_platform": "linux",
            "platform_python_implementation": "CPython",
            "implementation_name": "cpython",
        }
        versions: dict[str, list[str]] = {}
        for entry in entries:
            if entry.marker is None or entry.marker.evaluate(environment):
                (pin,) = entry.specifier
                assert pin.operator == "=="
                versions.setdefault(canonicalize_name(entry.name), []).append(pin.version)
        assert all(len(found) == 1 for found in versions.values()), python
        for requirement in wanted(project, lock):
            if requirement.marker is not None and not requirement.marker.evaluate(environment):
                continue
            (version,) = versions[canonicalize_name(requirement.name)]
            assert Version(version) in requirement.specifier, f"{requirement} on {python}: {version}"


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_pins_content_and_names_no_source(root: Path, lock: str):
    """Every entry has hashes; each machine decides where packages come from."""
    assert all(hashes > 0 for _, hashes in locked(root / lock))
    text = (root / lock).read_text()
    for word in ("://", "--index", "--extra-index", "--find-links", "--trusted", " @ ", "file:"):
        assert word not in text


def test_all_locks_agree(root: Path):
    """What they share, they hold in the same version: `make install-extras` changes nothing that `make install` did."""
    small, *larger = ({(r.name, str(r.specifier)) for r, _ in locked(root / lock)} for lock in LOCKS)
    assert all(small <= large for large in larger)


def test_every_dependency_has_bounds(project: dict):
    """Lower and upper bound, so that a later major version does not break an installation."""
    extras = project["project"]["optional-dependencies"].values()
    for text in (*project["project"]["dependencies"], *(text for extra in extras for text in extra)):
        operators = {specifier.operator for specifier in Requirement(text).specifier}
        assert operators == {">=", "<"}, text
