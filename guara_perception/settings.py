"""Settings of perception from a robot's `robot.toml`: grid, heights, scan pattern, limits, validity."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

from guara_perception.arrays import Interval
from guara_perception.exceptions import FileFormatError, InvalidInput
from kinematics import RobotModel, load_robot
from kinematics.exceptions import RobotFileError
from kinematics.findings import Findings
from kinematics.toml_table import Table

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
    sets the nearest existing flag of `Hazard`, which the records of its grids name under `limit_flags`.

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
    """Limits as plain JSON values, for the JSON form of a grid's record."""
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
        findings = Findings(robot.config.path)
        root = robot.config.root.gathering(findings)
        grid, scan, heights, validity = (root.table(name) for name in ("grid", "scan", "heights", "validity"))
        footprint, whole_map = grid.table("footprint"), grid.table("map")
        lowest = heights.number("minimum", least=-2.0, most=0.0)
        settings = Settings(
            resolution=grid.number("resolution", least=1e-4, most=0.1),
            footprint_x=footprint.pair("x", rising=True),
            footprint_y=footprint.pair("y", rising=True),
            map_x=whole_map.pair("x", rising=True),
            map_y=whole_map.pair("y", rising=True),
            minimum_height=lowest,
            maximum_height=heights.number("maximum", least=min(lowest, 0.0) + 0.01, most=2.0),
            join_height=heights.number("join_height", least=1e-4, most=0.1),
            stripes=scan.integer("stripes", least=2, most=10_000),
            coarse_every=scan.integer("coarse_every", least=1, most=100),
            mirror_angles=(
                scan.number("mirror_angle_first", least=-3, most=3),
                scan.number("mirror_angle_last", least=-3, most=3),
            ),
            limits=_limits(root),
            validity_pauses=validity.integer("pauses", least=1, most=255),
            validity_seconds=validity.number("seconds", least=0.1, most=1e6),
        )
        try:
            findings.refuse()
        except RobotFileError as error:
            raise FileFormatError(*error.findings) from None
        return settings

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


def _limits(root: Table) -> TraversabilityLimits:
    table = root.table("traversability")
    keys = {"slope": "slope_limit", "step": "step_limit", "drop": "drop_limit", "roughness": "roughness_limit"}
    keys |= {"sigma": "sigma_limit", "disc_radius": "disc_radius"}
    values = {name: table.number(key, above=0.0, most=LARGEST_LIMIT[name]) for name, key in keys.items()}
    length, width = root.pair("sole", above=0.0, most=LARGEST_LIMIT["sole_length"])
    confidence = table.number("confidence", least=0.0, most=LARGEST_LIMIT["confidence"])
    return TraversabilityLimits(**values, confidence=confidence, sole_length=length, sole_width=width)


def robot_model(robot: RobotLike) -> RobotModel:
    """The model itself.

    Raises:
        kinematics.KinematicsError: there is no such robot, or its folder is not sound.
    """
    return load_robot(robot) if isinstance(robot, str | Path) else robot
