"""Abstract interface of cameras, and detection of changes of locked settings."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Self, TypeVar

from drivers import timing
from drivers.errors import CameraNotOpen, CameraSettingRefused, CameraTimeout
from drivers.frame import Frame

T = TypeVar("T")
UNITS = {"exposure": " s", "gain": "", "white_balance": " K", "gamma": ""}
# Relative difference from the locked value up to which a setting counts as unchanged.
TOLERANCE = 0.02
# Absolute tolerances that always apply, because a relative tolerance allows no deviation from a gain of 0.
ROUNDING = {"gain": 0.05, "gamma": 0.005}
WHAT_TO_DO = "check that no other program uses the camera and start again: settings are locked when it is opened"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """Settings that must not change during a scan; None leaves a setting unchanged.

    Attributes:
        exposure: exposure time [s]; locking it turns automatic exposure off.
        gain: gain in the camera's own unit. With Aravis, locking it turns automatic gain off.
        white_balance: colour temperature [K]; locking it turns automatic white balance off.
        gamma: gamma in the camera's own unit. Use the linear value, because gamma shifts the centre of a stripe.

    Raises:
        ValueError: a value is not finite, or exposure, white balance or gamma is not above 0.
    """

    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    gamma: float | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        for name, value in self.given().items():
            if not math.isfinite(value) or (name != "gain" and value <= 0):
                wanted = "finite" if name == "gain" else "finite and above 0"
                raise ValueError(f"camera setting {name} is {value}; it must be {wanted}")

    def given(self) -> dict[str, float]:
        """Return the settings that are not None, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldSettings:
    """Camera settings read back from the device.

    Attributes:
        values: reported values, with the names and units of `CameraSettings`; settings that the camera does not report
            are missing.
        automatic: names of the settings that are in automatic mode.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    automatic: tuple[str, ...] = ()


class Camera(ABC):
    """Base class of cameras; a context manager. To support another camera, implement the five abstract methods.

    If the camera can report its settings, also implement `held`, so that `setting_changes` can detect changes.

    Attributes:
        name: name of the camera in messages.
        identity: maker, model and serial number that the open camera reports, by which it is recognised; empty if
            unknown.
        lag: upper bound of exposure, read-out and transfer together [s]: a frame with stamp t shows nothing older than
            t - lag. None = unknown; then, acquisition drops frames after every change instead. `measure_lag` measures
            it.
        triggered: True if the camera exposes once per pulse on its trigger line and at no other time, and sets
            `Frame.device_time`.
        trigger_period: shortest allowed time between two triggers at the current exposure [s].
        counts_frames: True if `Frame.counter` comes from the device, so that frames lost before they reach the host
            leave gaps.
    """

    name: str = "camera"
    identity: str = ""
    lag: float | None = None
    triggered: bool = False
    trigger_period: float = 0.0
    counts_frames: bool = False

    def __enter__(self) -> Self:
        """Open the camera."""
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        """Close the camera."""
        self.close()

    @abstractmethod
    def open(self) -> None:
        """Open the camera; does nothing if it is open.

        Raises:
            CameraNotFound: the camera cannot be opened.
            CameraError: the camera cannot be used, for example because a library is missing.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the camera; does nothing if it is closed."""

    @abstractmethod
    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Lock the settings, and return the values read back from the camera.

        Raises:
            CameraSettingRefused: the camera rejected a setting.
            CameraError: the camera does not respond or reports an error.
            CameraNotOpen: the camera is not open.
        """

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Read the settings that are not None in `locked` back from the camera.

        The default implementation reports no value and no automatic mode; it is for cameras without readable settings.

        Raises:
            CameraEnded: the camera does not respond.
            CameraNotOpen: the camera is not open.
        """
        return HeldSettings()

    @abstractmethod
    def grab(self, timeout: float) -> Frame:
        """Return the next frame; wait for at most `timeout` [s].

        Raises:
            CameraTimeout: no frame arrived in time.
            CameraEnded: the camera will not deliver any more frames.
            CameraNotOpen: the camera is not open.
        """

    @abstractmethod
    def flush(self) -> None:
        """Discard the frames that have already arrived; the next frame grabbed arrives after this call.

        Raises:
            CameraNotOpen: the camera is not open.
        """


def opened(device: T | None, camera: Camera) -> T:
    """Check that a camera is open, and return its device.

    Raises:
        CameraNotOpen: the device is None.
    """
    if device is None:
        raise CameraNotOpen(f"{camera.name} is not open: use `with camera:`")
    return device


def wait_until_due(camera: Camera, wait: float, timeout: float) -> None:
    """Wait for the next frame of an emulated or replayed camera.

    Args:
        camera: camera, for the error message.
        wait: time until the frame is due [s]; 0 or less if it is due already.
        timeout: longest wait [s].

    Raises:
        CameraTimeout: the frame is not due within `timeout`.
    """
    timing.sleep(max(0.0, min(wait, timeout)))
    if wait > timeout:
        raise CameraTimeout(f"{camera.name} delivered no frame within {timeout:g} s")


def check_held(camera: str, setting: str, asked: float, held: float, allowed: float, tool: str = "") -> None:
    """Check that a setting read back differs by at most `allowed` from the requested value.

    Args:
        camera: name of the camera, for the error message.
        setting: name of the setting, for the error message.
        asked: requested value.
        held: value read back.
        allowed: largest difference.
        tool: text appended to the error message, such as a program that lists the possible values.

    Raises:
        CameraSettingRefused: the difference is larger.
    """
    if abs(held - asked) > allowed:
        raise CameraSettingRefused(
            f"{camera} was asked for {setting} {asked:g}, but reports {held:g}: ask for a value that it supports{tool}"
        )


def evidence_of(camera: Camera) -> str:
    """Describe how frames of a camera are assigned to stripes and verified."""
    if camera.triggered:
        return "waits for the board's trigger: stripes are verified by the camera's clock, lost frames are detected"
    if camera.counts_frames:
        return "runs freely: stripes are verified by image and lag, lost frames are detected by the camera's counter"
    return "runs freely: stripes are verified by image and lag, lost frames are not detected"


def setting_changes(camera: Camera, locked: CameraSettings) -> tuple[str, ...]:
    """Describe each change of a locked setting, and what to do about it; empty if no setting has changed.

    Settings that the camera does not report are assumed to be unchanged.

    Args:
        camera: open camera.
        locked: settings returned by `Camera.lock`.

    Raises:
        CameraError: the camera does not respond or is not open.
    """
    held = camera.held(locked)
    changes = []
    for name, then in locked.given().items():
        setting, unit, now = name.replace("_", " "), UNITS[name], held.values.get(name)
        if name in held.automatic:
            changes.append(f"{camera.name}: automatic {setting} is on, it was locked at {then:g}{unit}: {WHAT_TO_DO}")
        elif now is not None and abs(now - then) > max(TOLERANCE * abs(then), ROUNDING.get(name, 0.0)):
            changes.append(f"{camera.name}: {setting} is {now:g}{unit}, it was locked at {then:g}{unit}: {WHAT_TO_DO}")
    return tuple(changes)
