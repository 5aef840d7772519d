"""Loading of a robot from its folder or from a one-line description; all errors found are reported together.

The description is sent with the grids, so that receivers can compute the reach of the robot's legs. It is the
compressed text of robot.toml, the SRDF and the parts of the URDF that are used. Its origin is not trusted: its size is
limited, its texts are checked like the files of a folder, and no other file is opened to load it.
"""

from __future__ import annotations

import base64
import binascii
import json
import warnings
import zlib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from kinematics.arrays import Float
from kinematics.exceptions import ArgumentError, LibraryMissing, RobotFileError, RobotFileWarning, RobotNotFound
from kinematics.findings import Findings
from kinematics.model import RobotModel
from kinematics.model_checks import check_legs, check_names, check_postures
from kinematics.read_urdf import read_urdf
from kinematics.robot_settings import RobotSettings
from kinematics.robot_toml import RobotToml, open_robot_toml, read_robot_toml
from kinematics.srdf import Posture, read_srdf
from kinematics.tree import KinematicTree
from kinematics.urdf import SIZES, Joint, Link, Urdf
from kinematics.urdf_checks import check_urdf

# Folder of the stock robots, which are found by name. It is beside this package in a checkout and in an installed
# wheel.
ROBOTS_FOLDER = Path(__file__).resolve().parent.parent / "robots"
# Largest description, as text [characters] and decompressed [bytes]. That of the stock robot guara has 6 kB, 26 kB
# decompressed.
LARGEST_TEXT = 1_000_000
LARGEST_UNPACKED = 8_000_000
SOURCE = "robot description"


def load_robot(name_or_path: str | Path) -> RobotModel:
    """Load and check a robot folder: `robot.toml`, `urdf/<name>.urdf`, `srdf/<name>.srdf`.

    Args:
        name_or_path: name of a robot that comes with the package, or path of a robot folder.

    Raises:
        LibraryMissing: Pinocchio is not installed, for example because only guara-client is installed.
        ArgumentError: `name_or_path` is empty or neither a string nor a path.
        RobotNotFound: there is neither a robot of this name nor such a robot folder; the message lists the names.
        RobotFileError: a file is missing or invalid, or contradicts another; `findings` lists all errors found,
            each with its file and, if known, its line.

    Warns:
        RobotFileWarning: one warning lists all `RobotModel.notes`, and each of `RobotModel.doubts` has its own.
    """
    _check_pinocchio()
    return _load(_find(name_or_path), {})


def _check_pinocchio() -> None:
    """Check that Pinocchio is installed.

    Raises:
        LibraryMissing: Pinocchio is not installed; the message says how to install it.
    """
    if find_spec("pinocchio") is None:
        raise LibraryMissing("a robot needs Pinocchio: pip install guara-perception (guara-client does not include it)")


def _load(folder: Path, texts: Mapping[str, str]) -> RobotModel:
    """Load a robot from its folder, or, if `texts` is not empty, from the texts under "toml", "urdf" and "srdf"."""
    root = open_robot_toml(folder / "robot.toml", texts.get("toml"))
    toml = Findings(root.path)
    config = read_robot_toml(root, toml)
    is_config_read = not toml.is_wrong
    name = config.name or folder.name
    urdf, refused = _read_urdf(folder / "urdf" / f"{name}.urdf", config, texts.get("urdf"))
    postures: Mapping[str, Posture] | None = None
    srdf = folder / "srdf" / f"{name}.srdf"
    if urdf is not None:
        try:
            postures = {posture.name: posture for posture in read_srdf(srdf, urdf, texts.get("srdf"))}
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
    if not texts:
        texts = {"toml": (folder / "robot.toml").read_text("utf-8"), "srdf": srdf.read_text("utf-8")}
    sources = texts["toml"], texts["srdf"]
    robot = RobotModel(folder, tree, postures, settings, sources, (*tree.urdf.notes, *toml.notes))
    if robot.notes:
        warnings.warn(RobotFileWarning(f"{folder}: not used or not checked: {'; '.join(robot.notes)}"), stacklevel=3)
    for doubt in robot.doubts:
        warnings.warn(RobotFileWarning(f"{folder / 'robot.toml'}: {doubt}"), stacklevel=3)
    return robot


def _read_urdf(path: Path, config: RobotToml, text: str | None) -> tuple[Urdf | None, tuple[str, ...]]:
    """Read and check a URDF; return it and an empty tuple, or None and its errors."""
    try:
        urdf = read_urdf(path, text)
        if config.name and urdf.name != config.name:
            return None, (f"{path}: the robot is named {urdf.name!r}, but {config.name!r} in robot.toml",)
        check_urdf(urdf, config.base_frame or None)
    except RobotFileError as error:
        return None, error.findings
    return urdf, ()


def _check_tree(
    urdf: Urdf, config: RobotToml, postures: Mapping[str, Posture] | None, findings: Findings
) -> KinematicTree | None:
    """Build the tree, and check its legs and postures; errors are added to `findings`. None if it cannot be built."""
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
        f"no robot {str(name_or_path)!r}: give the path of a folder with a robot.toml, or one of the names "
        f"{', '.join(names)}"
    )


@lru_cache(maxsize=8)
def describe_robot(robot: RobotModel) -> str:
    """Encode a robot as a description of one line, from which `robot_from_description` loads it again."""
    files = {"name": robot.name, "toml": robot.toml_text, "urdf": plain_urdf(robot.tree.urdf), "srdf": robot.srdf_text}
    return base64.b64encode(zlib.compress(json.dumps(files).encode("utf-8"), 9)).decode("ascii")


def robot_from_description(text: str) -> RobotModel:
    """Load a robot from its description.

    Raises:
        LibraryMissing: as in `load_robot`.
        RobotFileError: the description is corrupt or too long, a text in it has errors, or its URDF refers to mesh
            files.

    Warns:
        RobotFileWarning: as in `load_robot`.
    """
    _check_pinocchio()
    if len(text) > LARGEST_TEXT:
        raise RobotFileError(f"{SOURCE}: {len(text)} characters; at most {LARGEST_TEXT} are read")
    try:
        unpacker = zlib.decompressobj()
        content = unpacker.decompress(base64.b64decode(text, validate=True), LARGEST_UNPACKED)
        files = json.loads(content)
        texts = {key: str(files[key]) for key in ("toml", "urdf", "srdf")}
    except (binascii.Error, zlib.error, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RobotFileError(f"{SOURCE}: corrupt, or longer than {LARGEST_UNPACKED} bytes: {error}") from error
    if "<mesh" in texts["urdf"]:
        raise RobotFileError(f"{SOURCE}: its URDF refers to mesh files, which are not read")
    return _load(Path(SOURCE), texts)


def plain_urdf(urdf: Urdf) -> str:
    """Write the used content of a URDF as text: links, then joints, each in the order of the file."""
    root = Element("robot", name=urdf.name)
    for link in urdf.links:
        _add_link(root, link)
    for joint in urdf.joints:
        _add_joint(root, joint)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_link(root: Element, link: Link) -> None:
    element = SubElement(root, "link", name=link.name)
    if link.mass:
        inertial = SubElement(element, "inertial")
        SubElement(inertial, "origin", xyz=_numbers(link.centre_of_mass), rpy="0 0 0")
        SubElement(inertial, "mass", value=repr(float(link.mass)))
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = ([repr(float(v)) for v in row] for row in link.inertia)
        SubElement(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)
    for shape in link.shapes:
        collision = SubElement(element, "collision")
        _add_origin(collision, shape.transform_shape_to_link)
        size = iter(shape.size)
        attributes = {name: _numbers(islice(size, count)) for name, count in SIZES[shape.kind].items()}
        SubElement(SubElement(collision, "geometry"), shape.kind, attributes)


def _add_joint(root: Element, joint: Joint) -> None:
    element = SubElement(root, "joint", name=joint.name, type=joint.kind)
    _add_origin(element, joint.transform_child_to_parent)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    if joint.kind != "fixed":
        SubElement(element, "axis", xyz=_numbers(joint.axis))
        # URDF readers require the attributes effort and velocity of <limit>, which are not used here.
        SubElement(element, "limit", lower=repr(joint.lower), upper=repr(joint.upper), effort="0", velocity="0")


def _add_origin(element: Element, transform: Float) -> None:
    SubElement(element, "origin", xyz=_numbers(transform[:3, 3]), rpy=_numbers(rpy_from_rotation(transform[:3, :3])))


def rpy_from_rotation(rotation: Float) -> Float:
    """Roll, pitch, yaw (3,) [rad] of a rotation (3, 3); inverse of `rotation_from_rpy`."""
    import pinocchio

    return np.array(pinocchio.rpy.matrixToRpy(rotation))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
