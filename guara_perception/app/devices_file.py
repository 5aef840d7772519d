"""`devices.toml`: camera and laser board of one robot, with their measured values."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from guara_perception.app.options import DeviceOptions
from guara_perception.exceptions import FileFormatError, InvalidInput, errors_as
from guara_perception.fields import Fields
from guara_perception.files import existing_file, read_toml, write_text

if TYPE_CHECKING:
    from drivers import Board, Camera, CameraSettings, SweepOptions

_Device = TypeVar("_Device")
FORMAT = "guara-devices/1"
# Numeric keys of [camera] with their limits. All but the first two are settings: when the camera is opened, it is
# locked to them, and they are read back.
NUMBERS = {
    "fps": (0.1, 10_000.0),
    "lag": (0.0, 2.0),
    "exposure": (1e-6, 1.0),
    "gain": (-100.0, 1e4),
    "white_balance": (500.0, 20_000.0),
    "gamma": (0.01, 1e4),
}
UNITS = dict.fromkeys(("lag", "exposure"), " s (0.008 for 8 ms)")
LINES = ("trigger", "exposure_output", "pixel_format")
# Prefixes of a camera's source that select a driver other than OpenCV.
ARAVIS, V4L2 = "aravis", "v4l2"
# Frames with the laser off: one before the first stripe, one per stripe (in changing light), or none.
OFF_FRAMES = ("one", "per stripe", "none")
# [s] Default exposure of a triggered camera; the laser is on for the same time.
TRIGGERED_EXPOSURE_S = 0.004
KNOWN = {
    "": {"format", "camera", "board"},
    "camera": {"source", "identity", "size", "off_frames", *LINES, *NUMBERS},
    "board": {"source", "vendor_id", "product_id", "serial"},
}


@dataclass(frozen=True, slots=True)
class Devices:
    """Camera and laser board of a robot, and the settings with which they were calibrated and are opened.

    Attributes:
        source: source of the camera: number, device path, GStreamer pipeline, "aravis" or "aravis:NAME" for GigE and
            USB3 Vision, "v4l2:/dev/video0" for V4L2 with the kernel's frame numbers, or "package.module:Class" of a
            `drivers.Camera`.
        size: image width and height [px]; None = the camera's default.
        fps: frame rate to request [1/s], or None.
        lag: measured `drivers.Camera.lag` [s], or None.
        settings: exposure [s], gain, white_balance [K] and gamma, as far as given; the camera is locked to them when it
            is opened, and they are read back.
        board: vendor_id and product_id of the laser board (default: those of the protocol), and serial, needed only
            if several boards are connected; or source, the "package.module:Class" of a `drivers.Board`.
        trigger: camera line wired to the board's TRIGGER, for sweeps run by the board; None = a free-running camera.
        exposure_output: line of an "aravis" camera that is active during an exposure, or None.
        pixel_format: pixel format to request from an "aravis" or "v4l2" camera; None = chosen by the driver.
        off_frames: laser-off frames of a scan, one of OFF_FRAMES.
        identity: `drivers.Camera.identity`, compared when the camera is opened; empty if unknown.
        folder: folder of devices.toml, also searched for user-defined classes; None without a file.
    """

    source: str = "0"
    size: tuple[int, int] | None = None
    fps: float | None = None
    lag: float | None = None
    settings: dict[str, float] = field(default_factory=dict)
    board: dict[str, int | str] = field(default_factory=dict)
    trigger: str | None = None
    exposure_output: str | None = None
    pixel_format: str | None = None
    off_frames: str = "one"
    identity: str = ""
    folder: Path | None = field(default=None, compare=False)

    def camera(self, *, free: bool = False) -> Camera:
        """Create the camera without opening it.

        Args:
            free: create a free-running camera even if `trigger` is given, for images outside a sweep.

        Raises:
            InvalidInput: "package.module:Class" cannot be imported or instantiated, or is not a `drivers.Camera`; the
                driver rejects a value; or a trigger is given for a camera without trigger input.
        """
        from drivers import AravisCamera, Camera, OpenCvCamera, V4l2Camera

        module, between, name = self.source.partition(":")
        asked: dict[str, Any] = {"size": self.size, "fps": self.fps, "lag": self.lag}
        trigger = None if free else self.trigger
        made: Camera
        with errors_as(InvalidInput, "", ValueError):
            if module == ARAVIS:
                asked |= {"exposure_output": self.exposure_output, "pixel_format": self.pixel_format}
                return AravisCamera(name, trigger=trigger, **asked)
            if between and name.isidentifier() and all(part.isidentifier() for part in module.split(".")):
                made = _own(Camera, "camera", self.source, self.folder)  # type: ignore[type-abstract]
                if self.lag is not None:
                    made.lag = self.lag
            elif module == V4L2 and name:
                made = V4l2Camera(name, pixel_format=self.pixel_format, **asked)
            else:
                made = OpenCvCamera(int(self.source) if self.source.isdigit() else self.source, **asked)
        if trigger is not None and not made.triggered:
            raise InvalidInput(
                f"trigger is {trigger!r}, but camera {self.source!r} has no trigger input: remove `trigger`, or "
                "use a GigE Vision or USB3 Vision camera (`guara doctor --cameras` lists them)"
            )
        return made

    def sweep_options(self) -> SweepOptions | None:
        """Options of sweeps run by the board, for a triggered camera; None for a free-running camera.

        Raises:
            InvalidInput: the exposure is not an allowed duration of a laser flash.
        """
        from drivers import SweepOptions

        if self.trigger is None:
            return None
        with errors_as(InvalidInput, "the laser is on while a triggered camera exposes", ValueError):
            return SweepOptions(flash=self.settings.get("exposure", TRIGGERED_EXPOSURE_S))

    def camera_settings(self) -> CameraSettings:
        """Settings to which the camera is locked when it is opened; a triggered camera always has an exposure."""
        from drivers import CameraSettings

        if self.trigger is not None:
            return CameraSettings(**{"exposure": TRIGGERED_EXPOSURE_S, **self.settings})
        return CameraSettings(**self.settings)

    def laser_board(self) -> Board:
        """Create the laser board without opening it.

        Raises:
            InvalidInput: the user-defined class cannot be imported or instantiated, or is not a `drivers.Board`.
        """
        from drivers import Board, BoardConfig, LaserBoard

        if "source" in self.board:
            return _own(Board, "board", str(self.board["source"]), self.folder)  # type: ignore[type-abstract]
        return LaserBoard(BoardConfig(**self.board))  # type: ignore[arg-type]


def devices_of(chosen: DeviceOptions) -> Devices:
    """Devices from the devices.toml of the options, or the default devices; further options override both.

    If the options name a camera, the identity in the file is dropped.

    Raises:
        MissingFile, FileFormatError: see `load_devices`.
    """
    known = Devices() if chosen.devices is None else load_devices(chosen.devices)
    changes: dict[str, Any] = {"source": chosen.camera, "identity": ""} if chosen.camera else {}
    given = {name: getattr(chosen, name) for name in ("trigger", "fps", "off_frames")}
    return replace(known, **changes, **{name: value for name, value in given.items() if value})


def load_devices(path: str | Path) -> Devices:
    """Read and check devices.toml.

    Raises:
        MissingFile: the file does not exist.
        FileFormatError: the file is too large or not valid TOML, a key is unknown or missing, or a value is invalid.
    """
    path = existing_file(path, "; `guara record` writes one")
    data = read_toml(path)
    for table, known in KNOWN.items():
        given = data if not table else data.get(table, {})
        unknown = sorted(set(given) - known) if isinstance(given, dict) else [table]
        if unknown:
            raise FileFormatError(f"{path}: unknown {', '.join(unknown)}; allowed: {', '.join(sorted(known))}")
    fields = Fields(data, str(path))
    fields.text("format", (FORMAT,))
    camera = fields.sub("camera")
    board: dict[str, int | str] = {}
    if fields.has("board"):
        ids = fields.sub("board")
        board.update({name: ids.integer(name, 0, 0xFFFF) for name in ("vendor_id", "product_id") if ids.has(name)})
        board.update({name: ids.text(name) for name in ("serial", "source") if ids.has(name)})
        if "source" in board and len(board) > 1:
            raise FileFormatError(
                f"{path}: board.source is a class of your own: leave out vendor_id, product_id and serial"
            )
    size = None
    if camera.has("size"):
        width, height = (int(v) for v in camera.array("size", (2,)))
        if not (64 <= width <= 16384 and 64 <= height <= 16384):
            raise FileFormatError(f"{camera.path_to('size')} is [{width}, {height}]; allowed: 64 ... 16384 px each way")
        size = (width, height)
    numbers = {
        name: camera.number(name, *limits, UNITS.get(name, "")) for name, limits in NUMBERS.items() if camera.has(name)
    }
    return Devices(
        source=camera.text("source"),
        size=size,
        fps=numbers.pop("fps", None),
        lag=numbers.pop("lag", None),
        **{name: camera.text(name) for name in ("identity", *LINES) if camera.has(name)},
        off_frames=camera.text("off_frames", OFF_FRAMES) if camera.has("off_frames") else "one",
        settings=numbers,
        board=board,
        folder=path.parent,
    )


def save_devices(devices: Devices, path: str | Path) -> None:
    """Write devices.toml atomically.

    Raises:
        MissingFile: the folder does not exist.
        InvalidInput: `path` is a folder.
    """
    numbers = {"fps": devices.fps, "lag": devices.lag, **devices.settings}
    camera = {
        "source": devices.source,
        **{name: getattr(devices, name) for name in LINES},
        "identity": devices.identity or None,
        "off_frames": None if devices.off_frames == "one" else devices.off_frames,
        "size": devices.size,
        **{name: float(value) for name, value in numbers.items() if value is not None},
    }
    lines = ["# Camera and laser board as found by `guara record`; other commands read this file with --devices.", ""]
    lines += [f'format = "{FORMAT}"', "", "[camera]", *_toml_lines(camera)]
    if devices.board:
        lines += ["", "[board]", *_toml_lines(devices.board)]
    write_text(path, "\n".join([*lines, ""]))


def _own(kind: type[_Device], what: str, source: str, folder: Path | None) -> _Device:
    """Create a device from a user-defined class "package.module:Class", which may be in a file beside devices.toml."""
    module, _, name = source.partition(":")
    beside = [] if folder is None else [str(folder.resolve())]
    sys.path += beside
    try:
        importlib.invalidate_caches()
        made = getattr(importlib.import_module(module), name)()
    except ModuleNotFoundError as error:
        looked = f" {' nor '.join(['on the Python path (PYTHONPATH)', *(f'in {each}' for each in beside)])}"
        raise InvalidInput(f"{what} source {source} cannot be created: {error}: it is not{looked}") from None
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InvalidInput(f"{what} source {source} cannot be created: {error}") from None
    finally:
        for each in beside:
            sys.path.remove(each)
    if not isinstance(made, kind):
        raise InvalidInput(f"{what} source {source!r} is not a drivers.{kind.__name__}: derive the class from it")
    return made


def _toml_lines(values: Mapping[str, Any]) -> list[str]:
    # Strings, numbers and lists of numbers have the same syntax in JSON and TOML.
    return [f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in values.items() if value is not None]
