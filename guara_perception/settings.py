"""Settings of perception from a robot's `robot.toml`: grid, heights, scan pattern, limits, validity."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

from guara_perception.arrays import Interval
from guara_perception.exceptions import FileFormatError, InvalidInput
from guara_perception.fields import Fields
from kinematics import RobotModel, load_robot
from kinematics.exceptions import RobotFileError

if TYPE_CHECKING:
    from kinematics import RobotModel

MODES = ("coarse", "standard")
# Beyond these a limit is a slip of units (degrees, millimetres), not a robot.
LARGEST_LIMIT = {
    "slope": np.pi / 2,
    "step": 1.0,
    "drop": 1.0,
    "roughness": 1.0,
    "sigma": 1.0,
    "disc_radius": 1.0,
    "confidence": 10.0,
    "sole_length": 1.0,
    "sole_width": 1.0,
}
RobotLike: TypeAlias = RobotModel | str | Path


@dataclass(frozen=True, slots=True)
class TraversabilityLimits:
    """What the robot's feet can bear; every value is a hard limit, above it a cell is a hazard.

    A limit that is added later has a default by which nothing is judged, since grids of older versions lack it; and it
    sets the nearest existing flag of `Hazard`, which the metadata of its grids name under `limit_flags`.

    Attributes:
        slope: largest angle to the horizontal [rad].
        step: largest rise within the disc [m].
        drop: largest fall within the disc [m].
        roughness: largest standard deviation about the fitted plane [m].
        sigma: largest standard deviation of the elevation [m].
        disc_radius: half the window of the plane fit and of the step search [m].
        confidence: number of standard deviations added before a value is compared.
        sole_length, sole_width: the sole rectangle, along x and y [m].
    """

    slope: float
    step: float
    drop: float
    roughness: float
    sigma: float
    disc_radius: float
    confidence: float
    sole_length: float
    sole_width: float

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            high = LARGEST_LIMIT[name]
            is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not is_number or not 0 <= value <= high or (value == 0 and name != "confidence"):
                raise InvalidInput(f"limit {name} is {value!r}, it must be a number above 0 and at most {high:.4g}")


def limits_to_dict(limits: TraversabilityLimits) -> dict[str, float]:
    """Limits as plain JSON values, for the metadata of a grid."""
    return {name: float(getattr(limits, name)) for name in TraversabilityLimits.__slots__}


@dataclass(frozen=True, slots=True)
class Settings:
    """All perception settings of one robot.

    Attributes:
        resolution: default cell edge [m].
        footprint_x, footprint_y: area of a single scan in base_footprint [m].
        map_x, map_y: area of the fused map in base_footprint [m].
        minimum_height, maximum_height: heights that count as terrain [m].
        join_height: largest height difference between neighbouring stripes on one surface [m].
        stripes: number of stripes of the standard pattern.
        coarse_every: stride of a coarse scan: it fires every stripe whose index this number divides.
        mirror_angles: nominal first and last mirror angle, for a first calibration only [rad].
        limits: traversability limits.
        validity_pauses, validity_seconds: how long a look may be used.
    """

    resolution: float
    footprint_x: Interval
    footprint_y: Interval
    map_x: Interval
    map_y: Interval
    minimum_height: float
    maximum_height: float
    join_height: float
    stripes: int
    coarse_every: int
    mirror_angles: Interval
    limits: TraversabilityLimits
    validity_pauses: int
    validity_seconds: float

    @staticmethod
    def of(robot: RobotModel) -> Settings:
        """Read and check the perception tables of a robot.

        Raises:
            FileFormatError: values are missing or impossible; all are reported at once, each with table and field.
        """
        known = _OF_ROBOTS.get(robot)
        if known is None:
            known = _OF_ROBOTS[robot] = Settings._read(robot)
        return known

    @staticmethod
    def _read(robot: RobotModel) -> Settings:
        def table(name: str) -> Fields:
            return Fields(_plain(robot.section(name)), f"robot.toml of {robot.name}", name)

        def angles() -> Interval:
            scan = table("scan")
            return scan.number("mirror_angle_first", -3, 3), scan.number("mirror_angle_last", -3, 3)

        def maximum() -> float:
            lowest = table("heights").data.get("minimum")
            return table("heights").number("maximum", (lowest if isinstance(lowest, float) else -2.0) + 0.01, 2.0)

        return Settings(
            **_all_read(
                resolution=lambda: table("grid").number("resolution", 1e-4, 0.1),
                footprint_x=lambda: _range(table("grid").sub("footprint"), "x"),
                footprint_y=lambda: _range(table("grid").sub("footprint"), "y"),
                map_x=lambda: _range(table("grid").sub("map"), "x"),
                map_y=lambda: _range(table("grid").sub("map"), "y"),
                minimum_height=lambda: table("heights").number("minimum", -2.0, 0.0),
                maximum_height=maximum,
                join_height=lambda: table("heights").number("join_height", 1e-4, 0.1),
                stripes=lambda: table("scan").integer("stripes", 2, 10_000),
                coarse_every=lambda: table("scan").integer("coarse_every", 1, 100),
                mirror_angles=angles,
                limits=lambda: _limits(table("traversability"), robot.sole),
                validity_pauses=lambda: table("validity").integer("pauses", 1, 255),
                validity_seconds=lambda: table("validity").number("seconds", 0.1, 1e6),
            )
        )

    def pattern(self, mode: str) -> range:
        """Stripe indices of a mode, in the standard pattern.

        Raises:
            InvalidInput: no such mode.
        """
        if mode not in MODES:
            raise InvalidInput(f"mode is {mode!r}, allowed: {', '.join(MODES)}")
        return range(0, self.stripes, self.coarse_every if mode == "coarse" else 1)


# A robot does not change, and is asked for its settings by every scan.
_OF_ROBOTS: WeakKeyDictionary[RobotModel, Settings] = WeakKeyDictionary()


def _all_read(**reads: Callable[[], object]) -> dict[str, Any]:
    """What each reader gives; what any of them refuses is reported at once.

    Raises:
        FileFormatError: `findings` lists each.
    """
    values: dict[str, object] = {}
    refused: list[str] = []
    for name, read in reads.items():
        try:
            values[name] = read()
        except (FileFormatError, RobotFileError) as error:
            refused += error.findings
    if refused:
        raise FileFormatError(*dict.fromkeys(refused))
    return values


def _limits(table: Fields, sole: tuple[float, float]) -> TraversabilityLimits:
    names = {"slope": "slope_limit", "step": "step_limit", "drop": "drop_limit", "roughness": "roughness_limit"}
    names |= {"sigma": "sigma_limit", "disc_radius": "disc_radius", "confidence": "confidence"}
    values = _all_read(**{name: partial(table.number, key) for name, key in names.items()})
    try:
        return TraversabilityLimits(**values, sole_length=float(sole[0]), sole_width=float(sole[1]))
    except InvalidInput as error:
        raise FileFormatError(f"{table.source}: [traversability] {error}") from None


def _range(fields: Fields, name: str) -> Interval:
    low, high = (float(v) for v in fields.array(name, (2,)))
    if high <= low:
        raise FileFormatError(f"{fields.path_to(name)} is [{low}, {high}], the first must be below the second")
    return low, high


def _plain(table: Mapping[str, Any]) -> dict[str, Any]:
    """Lists and dicts from whatever immutable containers the robot hands out."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, tuple | list):
            return [plain(item) for item in value]
        return value

    return {key: plain(item) for key, item in table.items()}


def robot_model(robot: RobotLike) -> RobotModel:
    """The model itself.

    Raises:
        kinematics.KinematicsError: there is no such robot, or its folder is not sound.
    """
    return load_robot(robot) if isinstance(robot, str | Path) else robot
