"""The settings of a robot that `kinematics` itself uses, read from robot.toml together."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from kinematics.limits import OdometryLimits, PauseLimits, SelfFilterSettings
from kinematics.stance_pose import StanceNoise
from kinematics.toml_table import Table


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """Tables [stance], [odometry], [pause] and [self_filter]."""

    noise: StanceNoise
    odometry_limits: OdometryLimits
    pause_limits: PauseLimits
    self_filter: SelfFilterSettings

    @classmethod
    def from_table(cls, root: Table, links: Collection[str] | None) -> RobotSettings:
        """Read the tables of robot.toml; `links` are those that may be named, None = any."""
        return cls(
            StanceNoise.from_table(root.table("stance")),
            OdometryLimits.from_table(root.table("odometry")),
            PauseLimits.from_table(root.table("pause")),
            SelfFilterSettings.from_table(root.table("self_filter"), links),
        )
