"""Free-running emulated camera whose frames can have faults."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from drivers.cameras.camera import CameraSettings, HeldSettings
from drivers.emulator.emulated_camera import EmulatedCamera
from drivers.frame import Frame, read_only


@dataclass(frozen=True, slots=True)
class CameraFault:
    """Fault of the frames `first` ... `first + count - 1` of a `BenchCamera`.

    Attributes:
        kind: "drop" (the frame never arrives), "repeat" (the previous frame is repeated with its number), "freeze" (the
            previous image is repeated with a new number), "silence" (no frame arrives meanwhile), "resize" (half the
            size), "brighten" (twice the exposure).
        first: number of the first frame.
        count: number of frames.

    Raises:
        ValueError: unknown kind.
    """

    kind: str
    first: int
    count: int = 1

    def __post_init__(self) -> None:
        """Check the kind."""
        if self.kind not in KINDS:
            raise ValueError(f"unknown camera fault {self.kind!r}, allowed: {', '.join(KINDS)}")

    def holds(self, number: int) -> bool:
        """True if frame `number` has the fault."""
        return self.first <= number < self.first + self.count


KINDS = ("drop", "repeat", "freeze", "silence", "resize", "brighten")


class BenchCamera(EmulatedCamera):
    """Emulated camera with faults.

    Attributes:
        faults: faults of its frames.
        automatic: settings in automatic mode, as if switched by another program; affects only `held`.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Prepare the camera; arguments as for `EmulatedCamera`."""
        super().__init__(*arguments, **options)
        self.faults: list[CameraFault] = []
        self.automatic: set[str] = set()
        self._last: Frame | None = None

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Report all settings, and those in `automatic` as automatic."""
        return replace(super().held(locked), automatic=tuple(self.automatic))

    def _next_number(self, now: float) -> int:
        number = super()._next_number(now)
        for fault in sorted(self.faults, key=lambda fault: fault.first):
            if fault.kind in ("drop", "silence") and fault.holds(number):
                number = fault.first + fault.count
        return number

    def _expose(self, number: int, start: float) -> Frame:
        kinds = {fault.kind for fault in self.faults if fault.holds(number)}
        last, settings = self._last, self._settings
        if last is not None and "repeat" in kinds:
            return last
        if "brighten" in kinds:
            self._settings = replace(settings, exposure=2 * self._exposure)
        frame = super()._expose(number, start)
        self._settings = settings
        if last is not None and "freeze" in kinds:
            frame = replace(frame, image=last.image)
        elif "resize" in kinds:
            frame = replace(frame, image=read_only(frame.image[::2, ::2]))
        self._last = frame
        return frame
