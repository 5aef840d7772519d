"""Locks the settings of a camera opened by OpenCV, in V4L2's units, and reads each of them back."""

from __future__ import annotations

from typing import Protocol

from drivers.cameras.camera import CameraSettings, HeldSettings
from drivers.errors import CameraSettingRefused

# Unit of V4L2's control exposure_time_absolute [s].
V4L2_EXPOSURE_UNIT = 1e-4
V4L2_MANUAL_EXPOSURE = 1.0
# Relative difference allowed between what was asked for and what the driver rounds it to.
TOLERANCE = 0.02
EXPOSURE_TOLERANCE = 0.05


class Capture(Protocol):
    """The part of `cv2.VideoCapture` that settings need."""

    def set(self, propId: int, value: float) -> bool:
        """Set a property; False when the device does not have it."""

    def get(self, propId: int) -> float:
        """The value of a property."""


def lock_settings(capture: Capture, settings: CameraSettings, name: str) -> CameraSettings:
    """Switch the automatics off, set what was asked for, read it back and return what the camera holds.

    Args:
        capture: an open capture.
        settings: what to set; None entries are left alone.
        name: name of the camera, for messages.

    Raises:
        CameraSettingRefused: the camera has no such setting, or holds another value than was asked for.
    """
    import cv2

    held = {}
    if settings.exposure is not None:
        _set(capture, cv2.CAP_PROP_AUTO_EXPOSURE, V4L2_MANUAL_EXPOSURE, "manual exposure", name)
        wanted = settings.exposure / V4L2_EXPOSURE_UNIT
        got = _set(capture, cv2.CAP_PROP_EXPOSURE, wanted, "exposure [100 us]", name, EXPOSURE_TOLERANCE)
        held["exposure"] = got * V4L2_EXPOSURE_UNIT
    if settings.gain is not None:
        held["gain"] = _set(capture, cv2.CAP_PROP_GAIN, settings.gain, "gain", name)
    if settings.white_balance is not None:
        _set(capture, cv2.CAP_PROP_AUTO_WB, 0.0, "manual white balance", name)
        held["white_balance"] = _set(
            capture, cv2.CAP_PROP_WB_TEMPERATURE, settings.white_balance, "white balance [K]", name
        )
    if settings.gamma is not None:
        held["gamma"] = _set(capture, cv2.CAP_PROP_GAMMA, settings.gamma, "gamma", name)
    return CameraSettings(**held)


def held_settings(capture: Capture, locked: CameraSettings) -> HeldSettings:
    """Read what the camera holds of the settings that were locked; values that it does not report (0, -1) are left out.

    Args:
        capture: an open capture.
        locked: settings to read; None entries are not asked for.
    """
    import cv2

    asked = {
        "exposure": (cv2.CAP_PROP_EXPOSURE, V4L2_EXPOSURE_UNIT, cv2.CAP_PROP_AUTO_EXPOSURE, V4L2_MANUAL_EXPOSURE),
        "gain": (cv2.CAP_PROP_GAIN, 1.0, None, 0.0),
        "white_balance": (cv2.CAP_PROP_WB_TEMPERATURE, 1.0, cv2.CAP_PROP_AUTO_WB, 0.0),
        "gamma": (cv2.CAP_PROP_GAMMA, 1.0, None, 0.0),
    }
    values, automatic = {}, []
    for name, (prop, unit, switch, off) in asked.items():
        if getattr(locked, name) is None:
            continue
        got = capture.get(prop)
        if got > 0 or (name == "gain" and got == 0):
            values[name] = got * unit
        if switch is not None and capture.get(switch) != off:
            automatic.append(name)
    return HeldSettings(values=values, automatic=tuple(automatic))


def _set(capture: Capture, prop: int, value: float, what: str, name: str, tolerance: float = TOLERANCE) -> float:
    taken = capture.set(prop, value)
    got = capture.get(prop)
    if not taken:
        raise CameraSettingRefused(
            f"{name} has no setting {what} (asked for {value:g}): set it with the maker's tool (`v4l2-ctl -L`), "
            "or leave it out"
        )
    # One unit of rounding is always allowed: most V4L2 controls are whole numbers.
    if abs(got - value) > max(tolerance * abs(value), 0.5):
        raise CameraSettingRefused(
            f"{name} was asked for {what} {value:g} and holds {got:g}: ask for a value it can take (`v4l2-ctl -L`)"
        )
    return got
