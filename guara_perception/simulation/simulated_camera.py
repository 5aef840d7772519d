"""Emulated camera of `drivers` with frames rendered by the simulated rangefinder, lit by the emulated board's laser."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from drivers import Image
from drivers.cameras.camera import CameraSettings
from drivers.emulator.emulated_camera import EmulatedCamera
from drivers.emulator.views import ExposureView

if TYPE_CHECKING:
    from drivers.emulator.emulated_camera import Exposes
    from guara_perception.simulation.rangefinder import SimulatedRangefinder

# Nominal exposure of the simulated light [s].
NOMINAL_EXPOSURE_S = 0.008


def simulated_camera(
    rangefinder: SimulatedRangefinder, board: Exposes, *, fps: float = 30.0, latency: float = 0.008
) -> EmulatedCamera:
    """Create a free-running camera whose frames a simulated rangefinder renders.

    Args:
        rangefinder: simulated rangefinder with a pose. The pose may be changed between scans, in the thread that grabs
            frames.
        board: emulated board, in this process or another, whose laser and mirror illuminate the scene.
        fps: frames per second.
        latency: time from the end of an exposure to the arrival of its frame [s].
    """
    return EmulatedCamera(
        board,
        renderer(rangefinder),
        fps=fps,
        exposure=min(NOMINAL_EXPOSURE_S, 1.0 / fps),
        latency=latency,
        name="simulated camera",
    )


def renderer(rangefinder: SimulatedRangefinder) -> Callable[[ExposureView, CameraSettings], Image]:
    """Create the function with which an `EmulatedCamera` renders an exposure.

    The brightness is proportional to exposure time and gain; white balance and gamma settings have no effect.
    """

    def render(seen: ExposureView, settings: CameraSettings) -> Image:
        exposure = (settings.exposure or NOMINAL_EXPOSURE_S) / NOMINAL_EXPOSURE_S
        gain = 1.0 if settings.gain is None else settings.gain
        return rangefinder.frame(
            laser=seen.laser_fraction,
            mirror_angle=seen.mirror_angle,
            mirror_travel=seen.mirror_travel,
            exposure=exposure * gain,
        )

    return render
