"""The real rangefinder of this machine: USB laser board and camera."""

from __future__ import annotations

from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.calibration.calibration import Calibration


def real_rangefinder(
    calibration: Calibration, *, camera: str, fps: float | None, lag: float | None, off_frames: str
) -> Rangefinder:
    """Board and camera, not yet open.

    Args:
        calibration: says which picture size the camera must give.
        camera: number of the camera, device path, or a GStreamer pipeline.
        fps: frames per second to ask for, or None for the camera's own.
        lag: see `drivers.Camera`; None = unknown, frames are thrown away after every change instead.
        off_frames: "one", "per stripe" or "none".
    """
    from drivers import AcquireOptions, LaserBoard, OffFrames, OpenCvCamera

    source: int | str = int(camera) if camera.isdigit() else camera
    return Rangefinder(
        board=LaserBoard(),
        camera=OpenCvCamera(source, size=calibration.camera.size, fps=fps, lag=lag),
        options=AcquireOptions(off=OffFrames(off_frames)),
    )
