"""Settings of perception from a robot's `robot.toml`: grid, heights, scan pattern, limits, validity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import numpy as np

from guara_perception.arrays import Interval
from guara_perception.exceptions import FileFormatError, InvalidInput
from kinematics import RobotModel, load_robot
from kinematics.exceptions import RobotFileError
from kinematics.findings import Findings
from kinematics.toml_table import Table

MODES = ("coarse", "standard")
# Largest allowed value of limits that are lengths [m], and of the remaining limits, by name. A larger length or angle
# is probably in millimetres or degrees.
LARGEST_LENGTH = 1.0
LARGEST_LIMIT = {"slope": np.pi / 2, "confidence": 10.0}
RobotLike: TypeAlias = RobotModel | str | Path


@dataclass(frozen=True, slots=True)
class TraversabilityLimits:
    """Traversability limits of the robot's feet. A cell that exceeds slope, step, drop, roughness or sigma is a hazard.

    A limit added in a later version needs a default that excludes nothing, since grids of older versions lack it. The
    new limit sets the existing flag of `Hazard` that fits best, and the records of grids list it under `limit_flags`.

    Attributes:
        slope: largest angle to the horizontal [rad].
        step: largest rise within the disc [m].
        drop: largest fall within the disc [m].
        roughness: largest standard deviation about the fitted plane [m].
        sigma: largest standard deviation of the elevation, without the part shared by neighbouring cells [m].
        disc_radius: radius of the window of the plane fit and of the step search [m].
        confidence: number of standard deviations added to a value before it is compared with its limit; none are added
            for `sigma`.
        sole_length, sole_width: extent of the sole rectangle along x and y [m].
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
            high = LARGEST_LIMIT.get(name, LARGEST_LENGTH)
            is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not is_number or not 0 <= value <= high or (value == 0 and name != "confidence"):
                allowed = f"0 ... {high:.4g}" if name == "confidence" else f"numbers above 0, at most {high:.4g}"
                raise InvalidInput(f"limit {name} is {value!r}, allowed: {allowed}")


@dataclass(frozen=True, slots=True)
class Settings:
    """All perception settings of one robot.

    Attributes:
        resolution: default cell edge [m].
        footprint_x, footprint_y: area of a single scan in base_footprint [m].
        map_x, map_y: area of the fused map in base_footprint [m].
        minimum_height, maximum_height: range of heights that count as terrain [m].
        join_height: largest height difference between neighbouring stripes on one surface [m].
        stripes: number of stripes of the standard pattern.
        coarse_every: stride of a coarse scan, which uses the stripes whose index is a multiple of this number.
        mirror_angles: nominal first and last mirror angle [rad]; a calibration has its own angles.
        limits: traversability limits.
        validity_pauses, validity_seconds: age up to which an observation may be used [pauses, s].
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
    @lru_cache(maxsize=16)
    def of(robot: RobotModel) -> Settings:
        """Read and check the perception tables of a robot's robot.toml; cached, since every scan needs them.

        Raises:
            FileFormatError: values are missing or not allowed; all are reported at once, each with table and key.
        """
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
        """Indices of the stripes of a mode, counted in the standard pattern.

        Raises:
            InvalidInput: there is no such mode.
        """
        if mode not in MODES:
            raise InvalidInput(f"mode is {mode!r}, allowed: {', '.join(MODES)}")
        return range(0, self.stripes, self.coarse_every if mode == "coarse" else 1)


def _limits(root: Table) -> TraversabilityLimits:
    table = root.table("traversability")
    values = {
        name: table.number(f"{name}_limit", above=0.0, most=LARGEST_LIMIT.get(name, LARGEST_LENGTH))
        for name in ("slope", "step", "drop", "roughness", "sigma")
    }
    values["disc_radius"] = table.number("disc_radius", above=0.0, most=LARGEST_LENGTH)
    length, width = root.pair("sole", above=0.0, most=LARGEST_LENGTH)
    confidence = table.number("confidence", least=0.0, most=LARGEST_LIMIT["confidence"])
    return TraversabilityLimits(**values, confidence=confidence, sole_length=length, sole_width=width)


def robot_model(robot: RobotLike) -> RobotModel:
    """Load a robot given by name or folder; return a `RobotModel` unchanged.

    Raises:
        kinematics.KinematicsError: there is no such robot, or its folder is not valid.
    """
    return load_robot(robot) if isinstance(robot, str | Path) else robot
