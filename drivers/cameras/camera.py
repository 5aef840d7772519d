"""Interface of a camera in a scan, and changes of its locked settings."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import TracebackType
from typing import Self, TypeVar

from drivers.errors import CameraNotOpen
from drivers.frame import Frame

T = TypeVar("T")
UNITS = {"exposure": " s", "gain": "", "white_balance": " K", "gamma": ""}
# Relative; what is read is the camera's own rounding of what was locked, so it should come back as it was.
TOLERANCE = 0.02
# Absolute, in any unit: the locked value of a gain or gamma may be 0.
ROUNDING = {"gain": 0.05, "gamma": 0.005}
WHAT_TO_DO = "see that no other program uses the camera and start again: settings are locked when it is opened"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """Settings that must not change during a scan; None leaves one as it is.

    Attributes:
        exposure: time the shutter is open [s], automatic exposure off.
        gain: gain in the camera's own unit, automatic gain off.
        white_balance: colour temperature [K], automatic white balance off.
        gamma: gamma in the camera's own unit; choose the linear value, since a stripe's centre moves with gamma.

    Raises:
        ValueError: a value that is not finite, or an exposure, temperature or gamma not above 0.
    """

    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    gamma: float | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        for each in fields(self):
            value = getattr(self, each.name)
            if value is None:
                continue
            if not math.isfinite(value) or (each.name != "gain" and value <= 0):
                raise ValueError(f"camera setting {each.name} is {value}, it must be finite and above 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldSettings:
    """Camera settings read back from the device.

    Attributes:
        values: what the camera reports, by the names and in the units of `CameraSettings`.
        automatic: names of the settings that it changes by itself.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    automatic: tuple[str, ...] = ()


class Camera(ABC):
    """Base class of all cameras, a context manager. Another camera implements its five abstract methods.

    A sixth, `held`, lets every scan check that the camera still holds what was locked.

    Attributes:
        name: name of the camera in messages.
        lag: a frame stamped t shows nothing older than t - lag [s]: exposure, read-out and transfer together.
            None when unknown: acquisition then drops frames after every change instead. `measure_lag`
            measures it.
        triggered: exposes at each pulse on its trigger line and at no other time, and gives `Frame.device_time`.
        trigger_period: shortest time between two triggers that it accepts at its present exposure [s].
        counts_frames: `Frame.counter` is the device's own, so that a frame lost before the host had it shows as a gap.
    """

    name: str = "camera"
    lag: float | None = None
    triggered: bool = False
    trigger_period: float = 0.0
    counts_frames: bool = False

    def __enter__(self) -> Self:
        """Open the camera."""
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the camera."""
        self.close()

    @abstractmethod
    def open(self) -> None:
        """Open the camera; does nothing when open.

        Raises:
            CameraNotFound: it cannot be opened.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the camera; does nothing when closed."""

    @abstractmethod
    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Fix the settings, read them back and return the values that the camera holds.

        Raises:
            CameraSettingRefused: the camera did not take one.
            CameraNotOpen: open it first.
        """

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Read the settings that are not None in `locked` back from the camera; nothing is set.

        This default, for a camera that cannot be read, reports nothing.

        Raises:
            CameraEnded: the camera does not answer.
            CameraNotOpen: open it first.
        """
        return HeldSettings()

    @abstractmethod
    def grab(self, timeout: float) -> Frame:
        """The oldest frame not yet returned, waiting for it at most `timeout` [s].

        Raises:
            CameraTimeout: none came.
            CameraEnded: none will come any more.
            CameraNotOpen: open it first.
        """

    @abstractmethod
    def flush(self) -> None:
        """Forget frames that have already arrived, so that the next one grabbed arrives after this call."""


def opened(device: T | None, camera: Camera) -> T:
    """Check that a camera is open and return its device.

    Raises:
        CameraNotOpen: there is none.
    """
    if device is None:
        raise CameraNotOpen(f"{camera.name} is not open: use `with camera:`")
    return device


def evidence_of(camera: Camera) -> str:
    """Description of the acquisition with this camera, and of the proof that each frame is the right one."""
    if camera.triggered:
        return "waits for the board's trigger: a stripe is proved by the camera's clock, a lost frame is found"
    if camera.counts_frames:
        return "runs freely: a stripe is proved by its picture and the lag, a lost frame shows in the camera's counting"
    return "runs freely: a stripe is proved by its picture and the lag, a lost frame does not show"


def setting_changes(camera: Camera, locked: CameraSettings) -> tuple[str, ...]:
    """Changes of locked settings, each in one sentence with what to do; empty when there are none.

    A setting that the camera does not report is taken to be held.

    Args:
        camera: an open camera.
        locked: what `Camera.lock` returned.

    Raises:
        CameraError: the camera does not answer.
    """
    held = camera.held(locked)
    changes = []
    for name, unit in UNITS.items():
        then, now = getattr(locked, name), held.values.get(name)
        if then is None:
            continue
        setting = name.replace("_", " ")
        if name in held.automatic:
            changes.append(f"{camera.name}: automatic {setting} is on, it was locked at {then:g}{unit}: {WHAT_TO_DO}")
        elif now is not None and abs(now - then) > max(TOLERANCE * abs(then), ROUNDING.get(name, 0.0)):
            changes.append(f"{camera.name}: {setting} is {now:g}{unit}, it was locked at {then:g}{unit}: {WHAT_TO_DO}")
    return tuple(changes)
