"""Options shared by several commands, earlier spellings of options, and the reader of node.toml."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from guara_perception.exceptions import FileFormatError

if TYPE_CHECKING:
    from kinematics import RobotModel, Stance

# Type of an argument or option that is a file or folder.
FILE = click.Path(path_type=Path)
NOT_MIRRORED = click.option("--not-mirrored", is_flag=True, help="assert that the driver does not mirror the pictures")
NODE_FORMAT = "guara-node/1"
# Key of `click.Context.meta` under which the mistakes in node.toml are collected.
MISTAKES = "guara.mistakes"


@dataclass(frozen=True, slots=True)
class DeviceOptions:
    """Robot, calibration and devices, as selected by the options of a command that scans.

    Attributes:
        calibration: calibration file; may be None for simulated devices and for scans recorded for a calibration.
        robot: name or folder of the robot; None = that of the calibration, or the Guara.
        devices: devices.toml as written by `guara record`.
        camera: as `Devices.source`; None = as in `devices`, by default 0.
        trigger: camera line wired to the board's TRIGGER; None = as in `devices`, by default none.
        fps: frame rate to request [1/s]; None = as in `devices`, by default that of the camera.
        off_frames: "one", "per stripe" or "none"; None = as in `devices`, by default "one".
    """

    calibration: Path | None = None
    robot: str | None = None
    devices: Path | None = None
    camera: str | None = None
    trigger: str | None = None
    fps: float | None = None
    off_frames: str | None = None


def device_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `DeviceOptions` to a command, which receives them as its argument `chosen`."""
    camera = "camera as listed by `guara doctor --cameras`; default: that of --devices, or 0"
    off_frames = click.Choice(["one", "per stripe", "none"])
    options = (
        click.option("-c", "--calibration", type=FILE, help="calibration.json of this rangefinder"),
        click.option("--robot", help="name or folder of the robot; default: that of the calibration"),
        click.option("--devices", type=FILE, help="devices.toml with camera and board, as written by `guara record`"),
        # Set once for a camera, normally in devices.toml.
        click.option("--camera", hidden=True, help=camera),
        click.option("--trigger", metavar="LINE", hidden=True, help="`trigger` of devices.toml"),
        click.option("--fps", type=click.FloatRange(min=0.1), hidden=True, help="`fps` of devices.toml"),
        click.option("--off-frames", type=off_frames, hidden=True, help="`off_frames` of devices.toml"),
    )

    @functools.wraps(command)
    def with_chosen(**values: Any) -> Any:
        chosen = DeviceOptions(**{name: values.pop(name) for name in DeviceOptions.__slots__})
        return command(chosen=chosen, **values)

    return with_options(with_chosen, options)


def method_options(command: Callable[..., Any], *, hides_threshold: bool = False) -> Callable[..., Any]:
    """Add the options --method and --threshold to a command."""
    method = "precise, paper, paper-literal-lens or paper-literal-ortho"
    threshold = "binarisation threshold of the paper's methods, 0 ... 255 grey levels; default: chosen for each frame"
    options = (
        click.option("--method", default="precise", help=f"stripe extraction: {method}"),
        click.option("--threshold", type=float, hidden=hides_threshold, help=threshold),
    )
    return with_options(command, options)


def board_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options --board, --pattern, --square and --plates to a command."""
    pattern = click.Choice(["checkerboard", "charuco"])
    options = (
        click.option("--board", default="9x7", help="inner corners of the board, COLUMNSxROWS"),
        click.option(
            "--pattern",
            type=pattern,
            default="checkerboard",
            help="pattern of the board; a charuco board may be partly outside the picture",
        ),
        click.option("--square", type=float, default=0.030, help="edge of the board's squares [m]"),
        click.option(
            "--plates",
            default="0,0.04,0.08",
            help="heights of the plates [m]; 0 = the bare floor; give the height of a small plate once per position",
        ),
    )
    return with_options(command, options)


def with_options(
    command: Callable[..., Any], options: tuple[Callable[[Callable[..., Any]], Callable[..., Any]], ...]
) -> Callable[..., Any]:
    """Add options to a command, which its help shows in this order."""
    for option in reversed(options):
        command = option(command)
    return command


def stance_of(path: Path | None, robot: RobotModel) -> Stance:
    """Stance from a JSON file; if `path` is None, the scan posture on all feet with unknown gravity.

    Raises:
        MissingFile, FileFormatError: the file does not exist, cannot be read, or is not a JSON object.
        kinematics.KinematicsError: the file does not contain a stance.
    """
    from guara_perception.fields import read_json
    from kinematics import Stance

    if path is None:
        return Stance(robot.posture(robot.config.scan_posture), robot.legs, None)
    return Stance.from_dict(read_json(path).data)


def note_new_spelling(old: str, new: str) -> None:
    """Tell the user which spelling replaces the one that was used."""
    click.echo(f"guara: {old} is now {new}; the old spelling works until the next release", err=True)


def earlier_option(old: str, name: str, new: str, *, constant: Any = None, **attributes: Any) -> Callable[..., Any]:
    """Add a hidden earlier spelling of an option, which has the same effect and reports the new spelling.

    Args:
        old: earlier spelling.
        name: parameter to set, unless the new spelling is also given.
        new: new spelling.
        constant: value of the parameter; None = the value given by the user.
        attributes: further arguments of `click.option`.
    """

    def take(context: click.Context, parameter: click.Parameter, value: Any) -> None:
        if value in (None, False):
            return
        note_new_spelling(old, new)
        # click processes the options given by the user first, so this becomes the default of the parameter.
        context.default_map = {**(context.default_map or {}), name: value if constant is None else constant}

    attributes.update(hidden=True, expose_value=False, callback=take, is_flag=constant is not None)
    return click.option(old, f"earlier_{old.strip('-').replace('-', '_')}", help=f"now {new}", **attributes)


def read_node_file(context: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    """Read the defaults of a command's options from node.toml. Paths in the file are relative to its folder.

    Unknown options and invalid values are collected for `refuse_mistakes`.

    Raises:
        MissingFile, FileFormatError: the file does not exist, cannot be read, is too large, is not TOML, or has another
            format.
    """
    from guara_perception.files import existing_file, read_toml

    if path is None:
        return
    given = read_toml(existing_file(path))
    if given.pop("format", None) != NODE_FORMAT:
        raise FileFormatError(f"{path}: format must be {NODE_FORMAT!r}")
    options = {
        option.name: option
        for option in context.command.params
        if isinstance(option, click.Option) and option.expose_value and option is not parameter
    }
    mistakes = context.meta.setdefault(MISTAKES, [])
    defaults = {}
    for name, value in given.items():
        if name not in options:
            mistakes.append(f"{path}: unknown {name}; allowed: {', '.join(sorted(map(str, options)))}")
            continue
        kind = options[name].type
        try:
            if isinstance(value, bool) != isinstance(kind, click.types.BoolParamType):
                raise click.BadParameter("flags, and only flags, must be true or false")
            if isinstance(kind, click.Path | click.types.StringParamType) and not isinstance(value, str):
                raise click.BadParameter("the value must be text in quotes")
            options[name].type_cast_value(context, value)
        except click.BadParameter as error:
            mistakes.append(f"{path}: {name} is {value!r}: {error.message}")
            continue
        defaults[name] = str(path.parent / value) if isinstance(kind, click.Path) else value
    context.default_map = defaults


def refuse_mistakes(context: click.Context, parameter: click.Parameter, is_check: bool) -> bool:
    """Reject a node.toml with mistakes. With --check, continue, so that mistakes outside the file are found too.

    Raises:
        FileFormatError: node.toml has mistakes; the error lists all of them.
    """
    if context.meta.get(MISTAKES) and not is_check:
        raise FileFormatError(*context.meta[MISTAKES])
    return is_check
