"""A robot: its folder loaded, checked, and answering from joint positions where every part of it is."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy.typing as npt

from kinematics.arrays import Float, Mask
from kinematics.exceptions import ArgumentError, RobotFileError, RobotFileWarning, RobotNotFound, unknown_name
from kinematics.limits import OdometryLimits, PauseLimits, SelfFilterSettings
from kinematics.model_checks import check_model
from kinematics.reach import Reach, reach_in_base
from kinematics.read_urdf import read_urdf
from kinematics.robot_toml import RobotToml, read_robot_toml
from kinematics.srdf import Posture, read_srdf
from kinematics.stance import Stance
from kinematics.stance_pose import GravityEstimate, StanceNoise, StancePose, stance_pose
from kinematics.state import RobotState
from kinematics.tree import KinematicTree
from kinematics.urdf_checks import check_urdf

# Where robots are looked up by name: beside this package, in a checkout and in an installed wheel alike.
ROBOTS_FOLDER = Path(__file__).resolve().parent.parent / "robots"


class RobotModel:
    """A robot folder, loaded and checked; made by `load_robot`. Immutable.

    Attributes:
        folder: where it was read from.
        toml_text, srdf_text: what robot.toml and the SRDF hold, for whoever hands the robot on.
        name: the robot's name.
        tree: its kinematic tree (names, limits, Pinocchio's model).
        legs: names of the legs, in robot.toml's order.
        joint_names: names of all joints: leg by leg from hip to sole, then any others.
        sole: length (x) and width (y) of the sole [m].
        noise: how well a stance is known (table [stance]).
        odometry_limits: what counts as a foot that stayed (table [odometry]).
        pause_limits: what counts as a pause (table [pause]).
        self_filter_settings: how the robot's own shapes are taken (table [self_filter]).
        notes: what in the files is not used or could not be checked, in words.
        transform_camera_to_base: (4, 4), nominal, from the URDF.
        transform_laser_to_base: (4, 4), nominal; its origin lies on the mirror axis, which is parallel to y.
    """

    def __init__(
        self, folder: Path, tree: KinematicTree, postures: Mapping[str, Posture], toml_text: str, srdf_text: str
    ) -> None:
        """Check the parts against each other; `load_robot` reads them.

        Raises:
            RobotFileError: the parts contradict each other.
        """
        self.notes = (*tree.urdf.notes, *check_model(tree, postures))
        self.folder = folder
        self.toml_text, self.srdf_text = toml_text, srdf_text
        self.tree = tree
        self.name = tree.config.name
        self.legs = tuple(tree.legs)
        self.joint_names = tree.joint_names
        self.sole = tree.config.sole
        self.noise = StanceNoise.from_table(self.config.root.table("stance"))
        self.odometry_limits = OdometryLimits.from_table(self.config.root.table("odometry"))
        self.pause_limits = PauseLimits.from_table(self.config.root.table("pause"))
        self.self_filter_settings = SelfFilterSettings.from_table(self.config.root.table("self_filter"), tree.links)
        self._postures = dict(postures)
        nominal = RobotState(tree, self.posture(self.config.scan_posture))
        self.transform_camera_to_base: Float = nominal.transform_to_base(self.config.camera_frame)
        self.transform_laser_to_base: Float = nominal.transform_to_base(self.config.laser_frame)

    @property
    def config(self) -> RobotToml:
        """What robot.toml says."""
        return self.tree.config

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Every frame of the URDF."""
        return tuple(self.tree.links)

    @property
    def posture_names(self) -> tuple[str, ...]:
        """Every named posture."""
        return tuple(self._postures)

    def section(self, name: str) -> Mapping[str, object]:
        """One table of robot.toml, read-only all the way down, for readers above this package.

        Raises:
            RobotFileError: naming the file and the missing table.
        """
        return self.config.section(name)

    def posture(self, name: str) -> dict[str, float]:
        """Joint name -> position [rad] of a named posture.

        Raises:
            UnknownName: no such posture; the message lists them.
        """
        if name not in self._postures:
            raise unknown_name("posture", name, self._postures)
        return dict(self._postures[name].joint_positions)

    def state(self, joint_positions: Mapping[str, float] | npt.ArrayLike) -> RobotState:
        """The robot's state for joint positions, by name or (n,) in the order of `joint_names` [rad].

        Joints beyond their limits are kept, with a `JointLimitWarning` each.

        Raises:
            UnknownName: a joint that the robot does not have.
            JointPositionError: a joint is missing, a value is not finite, or an array has the wrong length.
        """
        return RobotState(self.tree, joint_positions)

    def stance_pose(
        self,
        stance: Stance,
        *,
        attitude: str | None = None,
        odometry: GravityEstimate | None = None,
        transform_camera_to_base: npt.ArrayLike | None = None,
        camera_covariance: npt.ArrayLike | None = None,
        find_unloaded: bool = True,
        noise: StanceNoise | None = None,
    ) -> StancePose:
        """Where the body stands at a pause; see `kinematics.stance_pose` for arguments and errors."""
        for foot in stance.support_feet:
            self.tree.leg(foot)
        return stance_pose(
            self.state(stance.joint_positions),
            stance.support_feet,
            stance.gravity_in_base,
            noise=noise or self.noise,
            attitude=attitude,
            odometry=odometry,
            transform_camera_to_base=transform_camera_to_base,
            camera_covariance=camera_covariance,
            find_unloaded=find_unloaded,
        )

    def reach(self, leg: str, soles_in_base: npt.ArrayLike, sole_pitch: npt.ArrayLike = 0.0) -> Reach:
        """Joint positions that set a leg's sole on points (..., 3) in `base_link`; see `kinematics.reach_in_base`."""
        return reach_in_base(self.tree, leg, soles_in_base, sole_pitch)

    def reachable(self, leg: str, soles_in_base: npt.ArrayLike, sole_pitch: npt.ArrayLike = 0.0) -> Mask:
        """Which points (..., 3) in `base_link` [m] a leg's sole reaches within its joint limits, (...)."""
        return self.reach(leg, soles_in_base, sole_pitch).is_reachable


def load_robot(name_or_path: str | Path) -> RobotModel:
    """Load and check a robot folder: `robot.toml`, `urdf/<name>.urdf`, `srdf/<name>.srdf`.

    Args:
        name_or_path: name of a robot that comes with the package, or path of a robot folder.

    Raises:
        RobotNotFound: neither; the message lists the names there are.
        RobotFileError: a file is missing, broken or contradicts another; the message names each file and place.

    Warns:
        RobotFileWarning: one warning that names what in the files is not used.
    """
    folder = _find(name_or_path)
    config = read_robot_toml(folder / "robot.toml")
    urdf = read_urdf(folder / "urdf" / f"{config.name}.urdf")
    if urdf.name != config.name:
        raise RobotFileError(f"{urdf.path}: the robot is named {urdf.name!r}, in robot.toml {config.name!r}")
    check_urdf(urdf, config.base_frame)
    postures = {posture.name: posture for posture in read_srdf(folder / "srdf" / f"{config.name}.srdf", urdf)}
    scan = postures.get(config.scan_posture)
    tree = KinematicTree(urdf, config, None if scan is None else scan.joint_positions)
    texts = [(folder / file).read_text("utf-8") for file in ("robot.toml", f"srdf/{config.name}.srdf")]
    robot = RobotModel(folder, tree, postures, *texts)
    if robot.notes:
        warnings.warn(RobotFileWarning(f"{folder}: not used: {'; '.join(robot.notes)}"), stacklevel=2)
    return robot


def _find(name_or_path: str | Path) -> Path:
    if not isinstance(name_or_path, str | Path) or not str(name_or_path):
        raise ArgumentError(f"robot is {name_or_path!r}; give a name or the path of a robot folder")
    names = sorted(path.parent.name for path in ROBOTS_FOLDER.glob("*/robot.toml"))
    if str(name_or_path) in names:
        return ROBOTS_FOLDER / str(name_or_path)
    folder = Path(name_or_path)
    if (folder / "robot.toml").is_file():
        return folder.resolve()
    raise RobotNotFound(
        f"no robot {str(name_or_path)!r}: it is neither a folder with a robot.toml nor one of the names "
        f"{', '.join(names)}"
    )
