"""Options of the live commands: which devices to use."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click


@dataclass(frozen=True, slots=True)
class DeviceOptions:
    """The devices that the options of a live command choose.

    Attributes:
        calibration: calibration file; may be left out for simulated devices, and for scans to calibrate with.
        robot: name or folder; None = the calibration's, or the Guara.
        devices: devices.toml as `guara record` writes it.
        camera: as `Devices.source`; None = that of `devices`, or 0.
        trigger: line of the camera that the board triggers; None = that of `devices`, or none.
        fps: frames per second to ask for; None = those of `devices`, or the camera's own.
        off_frames: "one", "per stripe" or "none".
    """

    calibration: Path | None = None
    robot: str | None = None
    devices: Path | None = None
    camera: str | None = None
    trigger: str | None = None
    fps: float | None = None
    off_frames: str = "one"


def device_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options of `DeviceOptions`, which it gets as its argument `chosen`."""
    file = click.Path(path_type=Path)
    camera = "as `guara cameras` lists it, or a GStreamer pipeline; default: that of --devices, or 0"
    trigger = "line of the camera that the board triggers: it sweeps by itself"
    off_frames = click.Choice(["one", "per stripe", "none"])
    options = (
        click.option("-c", "--calibration", type=file, help="calibration.json of this rangefinder"),
        click.option("--robot", help="name or folder of the robot; default: the calibration's"),
        click.option("--devices", type=file, help="devices.toml as `guara record` writes it"),
        click.option("--camera", help=camera),
        click.option("--trigger", metavar="LINE", help=trigger),
        click.option("--fps", type=click.FloatRange(min=0.1), help="frames per second to ask of the camera"),
        click.option(
            "--off-frames",
            type=off_frames,
            default="one",
            show_default=True,
            help="frames with the laser off: one for the scan, one per stripe (in changing light), or none",
        ),
    )

    @functools.wraps(command)
    def with_chosen(**values: Any) -> Any:
        chosen = DeviceOptions(**{name: values.pop(name) for name in DeviceOptions.__slots__})
        return command(chosen=chosen, **values)

    given: Callable[..., Any] = with_chosen
    for option in reversed(options):
        given = option(given)
    return given
