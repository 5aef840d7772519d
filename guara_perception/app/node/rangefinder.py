"""Rangefinder: laser board and camera, used together for sweeps."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

from drivers import (
    AcquireOptions,
    Board,
    Camera,
    CameraSettings,
    DriverError,
    StripeStream,
    acquire,
    draw_code,
    prepare,
    setting_changes,
    timing,
)
from drivers.timing import EmulatedClock
from guara_perception.calibration.calibration import Calibration, check_identity
from guara_perception.scanning.background import aligned

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.timing import Clock


FiringOrder = Sequence[tuple[int, float]]


def firing_order(calibration: Calibration, indices: Collection[int]) -> FiringOrder:
    """Calibrated stripes among `indices` as (index, mirror angle [rad]), in firing order."""
    return [(stripe.index, stripe.mirror_angle) for stripe in calibration.stripes if stripe.index in indices]


# [s] Standard deviation of a flash time derived from a frame's stamp: `measure_lag` is accurate to one or two
# milliseconds, and transfer times vary by about the same amount.
LAG_SIGMA = 0.002

# Number of stripes processed together, which takes a fifth less processor time than separate processing.
STRIPES_TOGETHER = 2


@dataclass
class Rangefinder:
    """Laser board and camera, open inside a `with` block. Leaving the block turns the laser off.

    Attributes:
        board: the laser board.
        camera: the camera.
        options: acquisition options.
        settings: settings to which the camera is locked when it is opened; None = leave the camera unchanged.
        identity: identity of the calibrated camera, empty if unknown; a camera with another identity is rejected.
        clock: clock of all devices of this process while the rangefinder is open; None = the machine's clock. With the
            clock of emulated devices, waiting takes no time, so the devices lose no frame on a busy machine.
    """

    board: Board
    camera: Camera
    options: AcquireOptions = AcquireOptions(together=STRIPES_TOGETHER)
    settings: CameraSettings | None = None
    identity: str = ""
    clock: Clock | None = None
    _locked: CameraSettings | None = field(default=None, repr=False)
    _entered: list[Board | Camera] = field(default_factory=list, repr=False)
    _clock_held: ExitStack = field(default_factory=ExitStack, repr=False)

    def __enter__(self) -> Self:
        """Open both devices.

        Raises:
            CalibrationMismatch: the camera is not the calibrated one.
            drivers.DriverError: a device cannot be opened, or the camera rejects a setting.
        """
        try:
            if self.clock is not None:
                self._clock_held.enter_context(timing.on_clock(self.clock))
            for device in (self.board, self.camera):
                device.__enter__()
                self._entered.append(device)
            check_identity(self.camera.identity, self.identity, "the connected device")
            if self.settings is not None:
                self.lock(self.settings)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """Close both devices in the order of opening, so that the board turns the laser off first."""
        while self._entered:
            self._entered.pop(0).__exit__(None, None, None)
        self._clock_held.close()

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Lock the open camera to `settings`, and return the settings that `setting_changes` will compare with.

        Raises:
            drivers.CameraError: the camera rejects a setting.
        """
        self._locked = self.camera.lock(settings)
        return self._locked

    def setting_changes(self) -> tuple[str, ...]:
        """Changes of the locked settings as texts, each with its remedy; empty if no setting is locked or changed.

        Reading the settings from the camera takes a few milliseconds. If this fails, the error is the only text.
        """
        if self._locked is None:
            return ()
        try:
            return setting_changes(self.camera, self._locked)
        except DriverError as error:
            return (str(error),)

    def sweep(
        self, firing_order: FiringOrder, band: Callable[[int], tuple[int, int]], should_stop: Callable[[], bool]
    ) -> StripeStream:
        """Return the stripes of a scan as a stream for a `with` block, with new random dark flashes.

        See `drivers.acquire` for the arguments.
        """
        options = replace(self.options, dark_after=draw_code([index for index, _ in firing_order]))
        return acquire(
            self.board, self.camera, firing_order, options, band=band, should_stop=should_stop, align=aligned
        )

    def flash(self, stamp: float) -> tuple[float, float] | None:
        """Middle of the flash in the frame with `stamp`, on the machine's monotonic clock, and its sigma [s].

        None if the camera's `lag` is unknown or 0.
        """
        lag = self.camera.lag
        if not lag:
            return None
        exposure = None if self._locked is None else self._locked.exposure
        if exposure is None:
            # Without the exposure, assume a uniform distribution from `lag` before the frame's stamp to the stamp.
            return stamp - lag / 2, math.hypot(lag / math.sqrt(12.0), LAG_SIGMA)
        if self.options.sweep is not None:
            exposure = min(exposure, self.options.sweep.flash)
        return stamp - lag + min(exposure, lag) / 2, LAG_SIGMA

    def keep_time(self) -> None:
        """Advance an emulated clock to the machine's time, so that flashes can be compared with joint samples."""
        if isinstance(self.clock, EmulatedClock):
            self.clock.catch_up()

    def lost_steps(self, firing_order: FiringOrder) -> int:
        """Home the mirror, move it to the first stripe, and return the motor steps lost since the last homing.

        If steps were lost, some stripes since that homing were not at their commanded angles; their heights are wrong.

        Raises:
            drivers.BoardError: the board cannot be reached, made ready or homed, or the first angle is outside its
                travel.
            drivers.BadFiringOrder: the firing order is not valid.
        """
        return prepare(self.board, firing_order)
