"""Every public function takes its arguments in the same order, and a path or name wherever an object is taken."""

from __future__ import annotations

import dataclasses
import inspect
import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from kinematics import RobotModel

# docs/conventions.md, "Order of arguments", group by group; names of one group keep the order given here.
GROUPS = (
    # what is worked on
    (
        "scan",
        "session_folder",
        "points",
        "sigma",
        "sensor_origin",
        "elevation",
        "terrain",
        "coarse",
        "a",
        "b",
        "corners",
    ),
    ("on", "off"),
    # where
    ("x", "y", "start", "end", "radius", "clearance"),
    # with what, and for whom
    ("calibration", "leg", "previous", "robot", "stance"),
    # which and how
    ("step", "mode", "region", "callback", "along", "band", "method", "resolution"),
    # how long to wait, or how old; then which of the two grids
    ("timeout", "max_age"),
    ("extent",),
)
ORDER = {name: rank for rank, name in enumerate(name for group in GROUPS for name in group)}
# Kept as the contract with users has them.
FIXED = {"TerrainClient.on_terrain"}


def functions() -> Iterator[tuple[str, Callable[..., object]]]:
    """Every public function, constructor and method of gp that a user calls; not constructors of results."""
    for name in gp.__all__:
        value = getattr(gp, name)
        if inspect.isclass(value):
            is_made_by_users = "__init__" in vars(value) and not dataclasses.is_dataclass(value)
            if is_made_by_users and not issubclass(value, BaseException) and value is not RobotModel:
                yield name, value
            for method, member in vars(value).items():
                function = member.__func__ if isinstance(member, classmethod) else member
                if not method.startswith("_") and inspect.isfunction(function):
                    yield f"{name}.{method}", function
        elif inspect.isfunction(value):
            yield name, value


def positional(name: str, function: Callable[..., object]) -> list[str]:
    """Names of the arguments that a user may give by position; a method's first is the object itself."""
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    names = [p.name for p in inspect.signature(function).parameters.values() if p.kind in kinds]
    return names[1:] if "." in name else names


@pytest.mark.parametrize(("name", "function"), [pytest.param(*pair, id=pair[0]) for pair in functions()])
def test_arguments_stand_in_one_order(name: str, function: Callable[..., object]) -> None:
    """Whatever two functions both take, they take in the same order."""
    known = [parameter for parameter in positional(name, function) if parameter in ORDER]
    for first, second in pairwise(known):
        assert ORDER[first] < ORDER[second] or name in FIXED, f"{name}: {first} before {second}"


def test_no_two_functions_take_a_pair_in_two_orders() -> None:
    """Without the table: no pair of names stands in one order in one function and in the other order in another."""
    seen: dict[tuple[str, str], str] = {}
    for name, function in functions():
        names = positional(name, function)
        for i, first in enumerate(names):
            for second in names[i + 1 :]:
                assert (second, first) not in seen, f"{first}, {second}: {name} against {seen[second, first]}"
                seen[first, second] = name


@pytest.mark.slow
def test_a_robot_may_be_named_wherever_one_is_taken(
    robot: RobotModel,
    paper_terrain: gp.TerrainGrid,
    paper_scan: gp.Scan,
    calibration_file: Path,
    tmp_path: Path,
) -> None:
    """A name and a folder give what the loaded model gives."""
    folder = Path(shutil.copytree(robot.folder, tmp_path / "guara"))
    rng = np.random.default_rng(0)
    points = np.column_stack((rng.uniform(0.5, 0.95, 4000), rng.uniform(-0.27, 0.27, 4000), np.zeros(4000)))
    wanted = str(paper_terrain.check_foothold(0.52, 0.18, "lf", robot))
    cloud = gp.terrain_from_points(points, 0.001, (0.4, 0.0, 0.5), robot)
    for given in ("guara", folder, str(folder)):
        assert str(paper_terrain.check_foothold(0.52, 0.18, "lf", given)) == wanted
        other = gp.terrain_from_points(points, 0.001, (0.4, 0.0, 0.5), given)
        np.testing.assert_array_equal(other.hazard, cloud.hazard)
        gp.TerrainMap(given).save(tmp_path / "map.npz")
        assert isinstance(gp.TerrainMap.load(tmp_path / "map.npz", given), gp.TerrainMap)
        assert isinstance(gp.ScanPolicy(given), gp.ScanPolicy)
        empty = gp.ScanProcessor(calibration_file, given, paper_scan.stance, paper_scan.mode).finish()
        assert not np.isfinite(empty.elevation).any()


def test_grids_may_be_compared_by_their_files(paper_terrain: gp.TerrainGrid, tmp_path: Path) -> None:
    """`gp.compare` takes paths as the other functions do."""
    paper_terrain.save(tmp_path / "a.npz")
    compared = gp.compare(tmp_path / "a.npz", paper_terrain)
    assert compared.largest == 0.0 and compared.known_only_in_a == compared.known_only_in_b == 0
    with pytest.raises(gp.MissingFile, match="none.npz"):
        gp.compare(paper_terrain, str(tmp_path / "none.npz"))
