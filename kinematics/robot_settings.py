"""The settings that `kinematics` itself uses, of odometry, pause detector and self-filter, from robot.toml."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class OdometryLimits:
    """Limits for feet that stayed (robot.toml, table [odometry]).

    Attributes:
        slip_sigmas: a foot slipped when its distance from another one changed by more than this many standard
            deviations.
        turn_limit: largest turn of the body between two pauses [rad].
        swing_least: a foot that moved by less than this slipped, one that moved by more swung [m].
    """

    slip_sigmas: float
    turn_limit: float
    swing_least: float

    @classmethod
    def from_table(cls, table: Table) -> OdometryLimits:
        """Read the table; every value must be positive."""
        return cls(**{field: table.number(field, above=0.0) for field in cls.__dataclass_fields__})


# [rad] A body that sways by more than 2 degrees does not stand.
MOST_SWAY = 0.035
# Keys of [pause] that a robot.toml may leave out.
OPTIONAL = ("time_limit", "grace_share", "grace_least", "grace_most")


@dataclass(frozen=True, slots=True)
class PauseLimits:
    """Limits for stance pauses (robot.toml, table [pause]).

    Attributes:
        joint_speed_limit: every joint must be slower than this [rad/s].
        hold_time: how long every joint must stay that slow [s].
        minimum_feet: least number of feet that carry the body.
        camera_translation_limit: how far the camera may move during a scan [m].
        camera_rotation_limit: how far the camera may turn during a scan [rad].
        time_limit: a pause whose planned end is not announced is over this long after the last message about it [s]; a
            robot.toml without it takes 30 s.
        grace_share, grace_least, grace_most: how much later than announced the message that ends a pause may arrive: a
            share of the announced time, within bounds [s]. The laser is off by then.
        stance_sway: amplitude of what the body may sway about its feet during a scan, about any horizontal axis, unseen
            by joints and pictures [rad]; 0, as where robot.toml has none, is the builder's word that it does not.
    """

    joint_speed_limit: float
    hold_time: float
    minimum_feet: int
    camera_translation_limit: float
    camera_rotation_limit: float
    time_limit: float = 30.0
    grace_share: float = 0.25
    grace_least: float = 0.5
    grace_most: float = 2.0
    stance_sway: float = 0.0

    @classmethod
    def from_table(cls, table: Table) -> PauseLimits:
        """Read the table; every value must be positive, the sway 0 or more and at most `MOST_SWAY`."""
        return cls(
            joint_speed_limit=table.number("joint_speed_limit", above=0.0),
            hold_time=table.number("hold_time", above=0.0),
            minimum_feet=table.integer("minimum_feet", least=1),
            camera_translation_limit=table.number("camera_translation_limit", above=0.0),
            camera_rotation_limit=table.number("camera_rotation_limit", above=0.0),
            **{key: table.number(key, above=0.0) for key in OPTIONAL if key in table.values},
            **{key: table.number(key, least=0.0, most=MOST_SWAY) for key in ("stance_sway",) if key in table.values},
        )

    def grace(self, announced: float) -> float:
        """Grace of a pause whose length was announced [s]."""
        return min(max(self.grace_share * announced, self.grace_least), self.grace_most)


@dataclass(frozen=True, slots=True)
class SelfFilterSettings:
    """Margin and choice of the robot's own shapes (robot.toml, table [self_filter]).

    Attributes:
        margin: added to every collision shape on all sides [m].
        ignore: links whose shapes are left out: those that enclose the camera or the laser.
    """

    margin: float
    ignore: tuple[str, ...]

    @classmethod
    def from_table(cls, table: Table, links: Collection[str] | None) -> SelfFilterSettings:
        """Read the table; the margin must not be negative, ignored links must be among `links` unless it is None."""
        settings = cls(table.number("margin", least=0.0), table.texts("ignore"))
        for link in settings.ignore:
            if links is not None and link not in links:
                table.wrong("ignore", f"a list of links ({link!r} is no link; allowed: {', '.join(links)})")
        return settings
