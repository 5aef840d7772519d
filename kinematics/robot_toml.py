"""Reader of robot.toml, which holds the values that a URDF cannot express."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from kinematics.exceptions import RobotFileError
from kinematics.findings import Findings
from kinematics.toml_table import Table
from kinematics.untrusted import LARGEST_FILE, key_lines, parse_toml


@dataclass(frozen=True, slots=True)
class LegConfig:
    """Configuration of one leg (table [legs.<name>]).

    Attributes:
        name: name of the leg.
        hip: name of the hip link.
        sole: name of the sole frame.
        joints: names of the joints, from hip to sole.
    """

    name: str
    hip: str
    sole: str
    joints: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PostureConfig:
    """Stated heights of one posture (table [postures.<name>]).

    Attributes:
        name: name of the posture.
        hip_height: height of the hips above the plane of the soles [m].
        camera_height: height of the camera's optical centre above that plane [m].
    """

    name: str
    hip_height: float
    camera_height: float


@dataclass(frozen=True, slots=True)
class RobotToml:
    """Kinematic content of robot.toml; all other tables are in `root`, unchecked.

    Attributes:
        path: path of the file.
        name: name of the robot.
        sole: length and width of a sole [m].
        sole_radius: radius of the ball of a round foot [m]; 0 for other feet. The origin of the sole frame is on the
            ball, straight below its centre when the z axis of the frame is vertical.
        scan_posture: name of the posture in which the robot scans.
        base_frame, camera_frame, laser_frame: names of the links of body, camera and laser in the URDF.
        imu_frame: name of the IMU's link; None if not given.
        legs: the legs, in the order of the file.
        postures: the postures, in the order of the file.
        root: content of the whole file.
        assumed: name of each value that has not been measured -> how to measure it (table [assumed]).
    """

    path: Path
    name: str
    sole: tuple[float, float]
    scan_posture: str
    base_frame: str
    camera_frame: str
    laser_frame: str
    imu_frame: str | None
    legs: tuple[LegConfig, ...]
    postures: tuple[PostureConfig, ...]
    root: Table
    assumed: Mapping[str, str] = field(default_factory=dict)
    sole_radius: float = 0.0


def open_robot_toml(path: Path, text: str | None = None) -> Table:
    """Open robot.toml as a table; its values are not checked here.

    Args:
        path: the file.
        text: text of the file; None = read it.

    Raises:
        RobotFileError: the file cannot be read, is too large, or is not valid TOML.
    """
    try:
        if text is None:
            with path.open(encoding="utf-8") as file:
                text = file.read(LARGEST_FILE + 1)
        if len(text) > LARGEST_FILE:
            raise ValueError(f"it has more than {LARGEST_FILE} characters")
        return Table(path, "", parse_toml(text), key_lines(text))
    except OSError as error:
        raise RobotFileError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise RobotFileError(f"{path}: cannot be read as TOML: {error}") from error


def read_robot_toml(root: Table, findings: Findings) -> RobotToml:
    """Read the kinematic content of robot.toml.

    Args:
        root: content of the whole file.
        findings: receives the errors; reading continues after each. Use the result only if no error was added.
    """
    table = root.gathering(findings)
    frames, legs, postures = table.table("frames"), table.table("legs"), table.table("postures")
    config = RobotToml(
        path=root.path,
        name=table.text("name"),
        sole=table.pair("sole", above=0.0),
        scan_posture=table.text("scan_posture"),
        base_frame=frames.text("base"),
        camera_frame=frames.text("camera"),
        laser_frame=frames.text("laser"),
        imu_frame=frames.text("imu") if "imu" in frames.values else None,
        legs=tuple(_leg(name, legs.table(name)) for name in legs.values),
        postures=tuple(_posture(name, postures.table(name)) for name in postures.values),
        root=root,
        assumed=_assumed(table),
        sole_radius=table.number("sole_radius", least=0.0, most=0.1) if "sole_radius" in table.values else 0.0,
    )
    if legs.values and len(config.legs) < 3:
        findings.wrong(
            f"tables [legs.<name>]: {len(config.legs)} given; a support plane needs three legs or more",
            root.line("legs"),
        )
    if config.scan_posture and config.scan_posture not in [posture.name for posture in config.postures]:
        table.wrong("scan_posture", "the name of a table [postures.<name>]")
    _check_joints_once(config, findings)
    return config


def _assumed(root: Table) -> Mapping[str, str]:
    if "assumed" not in root.values:
        return MappingProxyType({})
    table = root.table("assumed")
    return MappingProxyType({key: table.text(key) for key in table.values})


def _leg(name: str, table: Table) -> LegConfig:
    joints = table.texts("joints")
    if table.values.get("joints") == []:
        table.wrong("joints", "a list of at least one joint")
    return LegConfig(name, table.text("hip"), table.text("sole"), joints)


def _posture(name: str, table: Table) -> PostureConfig:
    return PostureConfig(name, table.number("hip_height", above=0.0), table.number("camera_height", above=0.0))


def _check_joints_once(config: RobotToml, findings: Findings) -> None:
    owner: dict[str, str] = {}
    for leg in config.legs:
        for joint in leg.joints:
            if joint in owner:
                findings.wrong(
                    f"joint {joint!r} is listed in [legs.{owner[joint]}] and [legs.{leg.name}]; "
                    "a joint belongs to one leg",
                    config.root.line(f"legs.{leg.name}.joints"),
                )
            owner[joint] = leg.name
