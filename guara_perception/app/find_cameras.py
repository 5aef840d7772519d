"""Search for the cameras of this machine, with a description of how the frames of each are verified."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drivers import AravisCamera, DriverError, OpenCvCamera
from drivers.cameras.aravis_library import AravisDevice, find_aravis_cameras, trigger_lines
from drivers.cameras.camera import evidence_of
from drivers.errors import CameraBackendMissing
from guara_perception.app.devices_file import ARAVIS

VIDEO_CLASS: Final = Path("/sys/class/video4linux")


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """Camera found on this machine.

    Attributes:
        source: value for --camera and devices.toml.
        description: name or model, and connection.
        evidence: how the frames of the camera are verified, or the error if the camera cannot be opened.
        lines: lines on which the camera can be triggered, for --trigger; empty if none, or if it cannot be opened.
    """

    source: str
    description: str
    evidence: str
    lines: tuple[str, ...] = ()


def find_cameras(video_class: Path = VIDEO_CLASS) -> tuple[list[FoundCamera], str]:
    """Search for cameras; takes a second or two.

    Args:
        video_class: folder in which the kernel lists video devices.

    Returns:
        The cameras, and the reason why GigE Vision and USB3 Vision cameras could not be searched for, or "".
    """
    found = [_video(folder) for folder in sorted(video_class.glob("video*"))]
    try:
        return found + [_aravis(device) for device in find_aravis_cameras()], ""
    except CameraBackendMissing as missing:
        return found, str(missing)


def _video(folder: Path) -> FoundCamera:
    path = f"/dev/{folder.name}"
    name = (folder / "name").read_text(errors="replace").strip()
    return FoundCamera(path, f"{name} (V4L2)", evidence_of(OpenCvCamera(path)))


def _aravis(device: AravisDevice) -> FoundCamera:
    description = f"{device.maker} {device.model} ({device.protocol}, {device.address})"
    source = f"{ARAVIS}:{device.name}"
    try:
        lines = trigger_lines(device.name)
    except DriverError as error:
        return FoundCamera(source, description, str(error))
    camera = AravisCamera(device.name, trigger=lines[0] if lines else None)
    return FoundCamera(source, description, evidence_of(camera), lines)
