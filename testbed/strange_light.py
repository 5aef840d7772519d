"""Scans with foreign light, or with frames from another instant, acquired with the real driver.

Frames are composed from the laser light in the images of a scan (laser-on minus laser-off) and any additional light.
The emulated board reports the state of laser and mirror in each exposure. Faults of the camera change which image is
delivered, or its time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers import AcquireOptions, BoardConfig, Frame, LaserBoard, SweepOptions
from drivers.cameras.camera import Camera, CameraSettings
from drivers.emulator import EmulatedClock, ExposureView
from guara_perception.app.node.live_scan import LiveScan, live_scan
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.arrays import Float32, Image
from guara_perception.scanning.scan_processor import ScanProcessor
from testbed.bench_board import BenchBoard, BenchCamera, bench_backend
from testbed.scenes import ScanInMemory
from testbed.triggered_camera import EmulatedTriggeredCamera

# Duration of a flash with a triggered camera [s]; frame rate of a free-running camera [1/s].
FLASH, FPS = 0.004, 30.0
# Standard deviation of the noise added to each image [grey levels].
NOISE = 1.0


@dataclass(frozen=True, slots=True)
class Instant:
    """State of laser and mirror in one exposure.

    Attributes:
        stripe: number of the stripe nearest to the mirror angle, from 0 in the order of the pattern.
        is_lit: True if the laser was on.
        shot: number of the exposure, from 0.
        time: time since the first exposure [s].
    """

    stripe: int
    is_lit: bool
    shot: int
    time: float = 0.0


# Function that returns light (h, w, 3) to be added to the image of a scene at an instant [grey levels].
Extra = Callable[["Scene", Instant], Float32]


class Scene:
    """Images of a recorded or simulated scan, by stripe.

    Attributes:
        scan: the scan.
        order: indices of the stripes in the order of the scan.
        angles: (n,) mirror angles of these stripes [rad].
        pitch_px: mean distance in the image between stripes of neighbouring indices.
        dark: (h, w, 3) image without the laser.
    """

    def __init__(self, scan: ScanInMemory) -> None:
        """Separate the laser light from the light of the scene."""
        self.scan = scan
        self.order = [index for index, _, _ in scan.frames]
        self.angles = np.array([scan.calibration.stripe(index).mirror_angle for index in self.order])
        self.dark = np.mean([off for _, _, off in scan.frames[:8]], axis=0).astype(np.float32)
        self._rng = np.random.default_rng(0)
        processor = scan.processor()
        rows = np.array([processor.band(index)[0] for index in self.order], np.float64)
        inside = (rows > 0) & (rows < self.dark.shape[0])
        self.pitch_px = float(np.polyfit(np.array(self.order)[inside], rows[inside], 1)[0])
        self._shots, self._begun = 0, 0.0

    def begin(self) -> None:
        """Restart noise and count of exposures, so that the next scan has the same noise."""
        self._rng, self._shots = np.random.default_rng(1), 0

    def laser(self, stripe: int) -> Float32:
        """Light (h, w, 3) of the own laser in the image of a stripe [grey levels]."""
        _, on, off = self.scan.frames[stripe]
        light = np.maximum(on.astype(np.float32) - off, 0)
        # Remove the remaining noise.
        light[light < 6] = 0
        return light

    def shifted(self, stripe: int, pitches: float) -> Float32:
        """Light of the own laser, moved down the image by a number of stripe pitches."""
        import cv2

        matrix = np.array([[1, 0, 0], [0, 1, pitches * self.pitch_px]], np.float32)
        light = self.laser(stripe)
        return np.asarray(cv2.warpAffine(light, matrix, light.shape[1::-1]), np.float32)

    def picture(
        self, view: ExposureView, gain: float, extra: Extra | None, ambient: Callable[[Instant], float]
    ) -> Image:
        """Render the image of an exposure; `gain` is the factor of the own laser's light."""
        stripe = int(np.argmin(np.abs(self.angles - view.mirror_angle)))
        if self._shots == 0:
            self._begun = view.start
        at = Instant(stripe, view.laser_fraction > 0.2, self._shots, view.start - self._begun)
        self._shots += 1
        level = self.dark * np.float32(ambient(at))
        if at.is_lit and gain:
            level += np.float32(gain) * self.laser(at.stripe)
        if extra is not None:
            level += extra(self, at)
        level += self._rng.standard_normal(level.shape, dtype=np.float32) * np.float32(NOISE)
        return np.clip(np.rint(level), 0, 255).astype(np.uint8)


class LateFrames(Camera):
    """Camera whose frames contain the pixels of an earlier frame, but correct stamps and counters."""

    def __init__(self, camera: Camera, late: int, first: int) -> None:
        """Deliver pixels that are `late` frames old from frame number `first` on, counted from the first grab."""
        self._camera, self._late, self._first = camera, late, first
        self.name, self.triggered = camera.name, camera.triggered
        self._before: list[Image] = []

    lag = property(lambda self: self._camera.lag)
    trigger_period = property(lambda self: self._camera.trigger_period)

    def open(self) -> None:
        """Open the camera."""
        self._camera.open()

    def close(self) -> None:
        """Close the camera."""
        self._camera.close()

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Lock the settings of the camera."""
        return self._camera.lock(settings)

    def flush(self) -> None:
        """Discard the frames that have arrived."""
        self._camera.flush()

    def grab(self, timeout: float) -> Frame:
        """Return the next frame, with old pixels."""
        frame = self._camera.grab(timeout)
        self._before.append(frame.image)
        number = len(self._before) - 1
        late = self._late if number >= self._first else 0
        return dataclasses.replace(frame, image=self._before[max(number - late, 0)])


class JumpingClock(EmulatedTriggeredCamera):
    """Triggered camera whose clock jumps at frame `at` by a number `gaps` of trigger intervals."""

    gaps, at = 0, 10**9

    def _frame(self, number: int, start: float, end: float) -> Frame:
        frame = super()._frame(number, start, end)
        if number < self.at:
            return frame
        openings = self._board.openings()
        gap = openings[self.at][0] - openings[self.at - 1][0]
        assert frame.device_time is not None
        return dataclasses.replace(frame, device_time=frame.device_time + self.gaps * gap)


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault of light or frames.

    Attributes:
        name: name of the fault in tables.
        gain: factor of the own laser's light.
        extra: additional light; None = none.
        ambient: factor of the ambient light at an instant.
        late: number of frames by which pixels are late, from frame `first` on.
        first: number of the frame at which `late` or `gaps` takes effect.
        gaps: number of trigger intervals by which the camera's clock jumps at frame `first`.
    """

    name: str
    gain: float = 1.0
    extra: Extra | None = None
    ambient: Callable[[Instant], float] = lambda _: 1.0
    late: int = 0
    first: int = 0
    gaps: int = 0


def beside(pitches: float, gain: float, shots: range | None = None) -> Extra:
    """Create the light of another robot's sweep, whose line is beside the own line.

    Args:
        pitches: distance of the lines in stripe pitches.
        gain: brightness relative to the own line.
        shots: exposures with this light; None = all but the first two, so that the first laser-off image is clean.
    """

    def light(scene: Scene, at: Instant) -> Float32:
        if at.shot < 2 if shots is None else at.shot not in shots:
            return np.zeros_like(scene.dark)
        # In laser-off exposures, the foreign line is beside the position of the own line.
        return np.float32(gain) * scene.shifted(at.stripe, pitches)

    return light


def ghost(pitches: float, gain: float) -> Extra:
    """Create a reflection of the own line, which is visible only in laser-on exposures; arguments as in `beside`."""

    def light(scene: Scene, at: Instant) -> Float32:
        return np.float32(gain) * scene.shifted(at.stripe, pitches) if at.is_lit else np.zeros_like(scene.dark)

    return light


def blob(scene: Scene, mask: Float32, level: float = 120.0) -> Extra:
    """Create constant red light of a level where `mask` (h, w) is 1, in all exposures but the first."""
    light = np.zeros_like(scene.dark)
    light[:, :, 2] = np.float32(level) * mask

    def shine(_: Scene, at: Instant) -> Float32:
        return light if at.shot else np.zeros_like(light)

    return shine


def take(
    scene: Scene, fault: Fault, *, triggered: bool, options: AcquireOptions | None = None
) -> tuple[ScanProcessor, LiveScan]:
    """Acquire a scan of the scene with a fault, with emulated board, driver and the scan loop of the node.

    Args:
        scene: scene in front of the camera.
        fault: the fault.
        triggered: True = the board triggers the camera; False = the camera runs freely, and the host controls each
            step.
        options: options of the acquisition; None = as in the node.
    """
    scene.begin()
    clock = EmulatedClock()
    board = BenchBoard(clock=clock.monotonic)
    board.bus_delay = 0.0003

    def render(view: ExposureView, _: CameraSettings) -> Image:
        return scene.picture(view, fault.gain, fault.extra, fault.ambient)

    camera: Camera
    if triggered:
        board.shutter.wired, board.shutter.exposure = True, FLASH
        jumping = JumpingClock(board, board.shutter, render)
        if fault.gaps:
            jumping.gaps, jumping.at = fault.gaps, fault.first
        camera = jumping
    else:
        camera = BenchCamera(board, render, fps=FPS, exposure=0.008, latency=0.001)
    if fault.late:
        camera = LateFrames(camera, fault.late, fault.first)
    given = options or AcquireOptions(together=16)
    if triggered:
        given = dataclasses.replace(given, sweep=SweepOptions(flash=FLASH))
    driver = LaserBoard(BoardConfig(handle_signals=False), backend=bench_backend(board))
    order = list(zip(scene.order, scene.angles.tolist(), strict=True))
    processor = scene.scan.processor()
    with Rangefinder(driver, camera, given, clock=clock) as rangefinder:
        rangefinder.lost_steps(order)
        taken = live_scan(rangefinder, processor, order, should_stop=lambda: False)
    return processor, taken
