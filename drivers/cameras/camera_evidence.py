"""What a camera can prove of its frames."""

from __future__ import annotations

from drivers.cameras.camera import Camera


def evidence_of(camera: Camera) -> str:
    """Say how a scan with this camera is taken, and what proves that a frame is the right one."""
    if camera.triggered:
        return "waits for the board's trigger: a stripe is proved by the camera's clock, a lost frame is found"
    if camera.counts_frames:
        return "runs freely: a stripe is proved by its picture and the lag, a lost frame shows in the camera's counting"
    return "runs freely: a stripe is proved by its picture and the lag, a lost frame does not show"
