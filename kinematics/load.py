"""Finds a robot folder by name or path, reads it, and reports at once all that is wrong with its files."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

from kinematics.exceptions import ArgumentError, RobotFileError, RobotFileWarning, RobotNotFound
from kinematics.findings import Findings
from kinematics.model import RobotModel
from kinematics.model_checks import check_legs, check_names, check_postures
from kinematics.read_urdf import read_urdf
from kinematics.robot_settings import RobotSettings
from kinematics.robot_toml import RobotToml, open_robot_toml, read_robot_toml
from kinematics.srdf import Posture, read_srdf
from kinematics.tree import KinematicTree
from kinematics.urdf import Urdf
from kinematics.urdf_checks import check_urdf

# Where robots are looked up by name: beside this package, in a checkout and in an installed wheel alike.
ROBOTS_FOLDER = Path(__file__).resolve().parent.parent / "robots"


def load_robot(name_or_path: str | Path) -> RobotModel:
    """Load and check a robot folder: `robot.toml`, `urdf/<name>.urdf`, `srdf/<name>.srdf`.

    Args:
        name_or_path: name of a robot that comes with the package, or path of a robot folder.

    Raises:
        RobotNotFound: neither; the message lists the names there are.
        RobotFileError: a file is missing, broken or contradicts another; `findings` lists all that is wrong with the
            three files, each with file, line and remedy.

    Warns:
        RobotFileWarning: one warning that names what in the files is not used; one for each of `RobotModel.doubts`.
    """
    folder = _find(name_or_path)
    root = open_robot_toml(folder / "robot.toml")
    toml = Findings(root.path)
    config = read_robot_toml(root, toml)
    is_config_read = not toml.is_wrong
    name = config.name or folder.name
    urdf, refused = _read_urdf(folder / "urdf" / f"{name}.urdf", config)
    postures: Mapping[str, Posture] | None = None
    srdf = folder / "srdf" / f"{name}.srdf"
    if urdf is not None:
        try:
            postures = {posture.name: posture for posture in read_srdf(srdf, urdf)}
        except RobotFileError as error:
            refused += error.findings
        check_names(config, urdf, toml)
    tree = None
    if urdf is not None and is_config_read and not toml.is_wrong:
        tree = _check_tree(urdf, config, postures, toml)
    links = None if urdf is None else [link.name for link in urdf.links]
    settings = RobotSettings.from_table(root.gathering(toml), links)
    if toml.is_wrong or refused or tree is None or postures is None:
        raise RobotFileError(*toml.texts, *refused)
    texts = ((folder / "robot.toml").read_text("utf-8"), srdf.read_text("utf-8"))
    robot = RobotModel(folder, tree, postures, settings, texts, (*tree.urdf.notes, *toml.notes))
    if robot.notes:
        warnings.warn(RobotFileWarning(f"{folder}: not used: {'; '.join(robot.notes)}"), stacklevel=2)
    for doubt in robot.doubts:
        warnings.warn(RobotFileWarning(f"{folder / 'robot.toml'}: {doubt}"), stacklevel=2)
    return robot


def _read_urdf(path: Path, config: RobotToml) -> tuple[Urdf | None, tuple[str, ...]]:
    """A URDF and what is wrong with it."""
    try:
        urdf = read_urdf(path)
        if config.name and urdf.name != config.name:
            return None, (f"{path}: the robot is named {urdf.name!r}, in robot.toml {config.name!r}",)
        check_urdf(urdf, config.base_frame or None)
    except RobotFileError as error:
        return None, error.findings
    return urdf, ()


def _check_tree(
    urdf: Urdf, config: RobotToml, postures: Mapping[str, Posture] | None, findings: Findings
) -> KinematicTree | None:
    """The tree of links and joints, checked; what is wrong becomes findings."""
    scan = None if postures is None else postures.get(config.scan_posture)
    try:
        tree = KinematicTree(urdf, config, None if scan is None else scan.joint_positions)
    except RobotFileError as error:
        findings.wrong(str(error))
        return None
    check_legs(tree, findings)
    if postures is not None:
        check_postures(tree, postures, findings)
    return tree


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
