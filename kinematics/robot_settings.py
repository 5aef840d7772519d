"""Settings of stance noise, odometry, pause detection and self-filter from robot.toml."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from kinematics.stance_pose import StanceNoise
from kinematics.toml_table import Table


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """Settings from the tables [stance], [odometry], [pause] and [self_filter] of robot.toml."""

    noise: StanceNoise
    odometry_limits: OdometryLimits
    pause_limits: PauseLimits
    self_filter: SelfFilterSettings

    @classmethod
    def from_table(cls, root: Table, links: Collection[str] | None) -> RobotSettings:
        """Read the tables of robot.toml; `links`: names of links that may be ignored, None = any."""
        return cls(
            StanceNoise.from_table(root.table("stance")),
            root.table("odometry").record(OdometryLimits),
            root.table("pause").record(PauseLimits),
            SelfFilterSettings.from_table(root.table("self_filter"), links),
        )


@dataclass(frozen=True, slots=True)
class OdometryLimits:
    """Limits of leg odometry (robot.toml, table [odometry]).

    Attributes:
        slip_sigmas: change of the distance between two feet, in standard deviations, above which one of them has moved.
        turn_limit: largest rotation of the body between two pauses [rad].
        swing_least: smallest motion of a foot that counts as a swing [m]; a smaller motion counts as a slip.
        slip_share: sigma of the drift caused by a slide common to all feet, which leg odometry cannot observe, as a
            fraction of the distance walked; default 0.04.
    """

    slip_sigmas: float
    turn_limit: float
    swing_least: float
    slip_share: float = field(default=0.04, metadata={"least": 0.0, "most": 1.0})


# Largest `stance_sway` that robot.toml may state [rad]: 2 degrees.
MOST_SWAY = 0.035


@dataclass(frozen=True, slots=True)
class PauseLimits:
    """Limits for stance pauses (robot.toml, table [pause]).

    Attributes:
        joint_speed_limit: speed below which every joint must stay [rad/s]; for a prismatic joint, 0.2 m times this
            [m/s].
        hold_time: time for which all joints must stay below `joint_speed_limit` on unchanged supporting feet [s].
        minimum_feet: minimum number of feet that carry the body.
        camera_translation_limit: largest translation of the camera during a scan [m].
        camera_rotation_limit: largest rotation of the camera during a scan [rad].
        time_limit: assumed length of a pause whose length is not announced, from its last BEGIN or HOLD [s].
        grace_share, grace_least, grace_most: allowed delay of the message that ends a pause: a fraction of the
            announced length or else of `time_limit` [-], and lower and upper bound of the delay [s]. No frame is taken
            during the delay.
        stance_sway: largest amplitude of undetected body sway during a scan [rad]: rotation over the standing feet,
            about any horizontal axis, that neither joints nor images show. 0, the default, means no sway.
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
    stance_sway: float = field(default=0.0, metadata={"least": 0.0, "most": MOST_SWAY})

    def grace(self, announced: float) -> float:
        """Allowed delay [s] of the message that ends a pause of a given length [s]."""
        return min(max(self.grace_share * announced, self.grace_least), self.grace_most)


@dataclass(frozen=True, slots=True)
class SelfFilterSettings:
    """Settings of the self-filter (robot.toml, table [self_filter]).

    Attributes:
        margin: margin added to every collision shape on all sides [m].
        ignore: links whose shapes are left out, because they enclose the camera or the laser.
    """

    margin: float
    ignore: tuple[str, ...]

    @classmethod
    def from_table(cls, table: Table, links: Collection[str] | None) -> SelfFilterSettings:
        """Read the table [self_filter].

        The margin must not be negative. If `links` is not None, it must contain every ignored link.
        """
        settings = cls(table.number("margin", least=0.0), table.texts("ignore"))
        for link in settings.ignore:
            if links is not None and link not in links:
                table.wrong("ignore", f"a list of links ({link!r} is not a link; allowed: {', '.join(links)})")
        return settings
