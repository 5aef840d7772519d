"""Locks the settings of a GenICam camera, in its own units, and reads each of them back."""

from __future__ import annotations

from typing import Any

from drivers.cameras.camera import CameraSettings, HeldSettings
from drivers.errors import CameraSettingRefused

MICROSECOND = 1e-6
# Relative; cameras count exposure in rows or in ticks of their clock, gain in fractions of a decibel.
EXPOSURE_TOLERANCE, GAIN_TOLERANCE = 0.05, 0.02
# Absolute: cameras round gain and gamma to about this.
ROUNDING = 0.05


def lock_settings(camera: Any, aravis: Any, settings: CameraSettings, name: str) -> CameraSettings:
    """Switch the automatics off, set what was asked for, read it back and return what the camera holds.

    Args:
        camera: an `Aravis.Camera`.
        aravis: the module.
        settings: what to set; None entries are left alone. Frames are raw, so a white balance is refused, and a gamma
            other than 1 where the camera has no such feature.
        name: name of the camera, for messages.

    Raises:
        CameraSettingRefused: the camera has no such setting, or holds another value than was asked for.
    """
    held: dict[str, float] = {}
    if settings.exposure is not None:
        if not camera.is_exposure_time_available():
            raise _missing(name, "exposure time", settings.exposure)
        if camera.is_exposure_auto_available():
            camera.set_exposure_time_auto(aravis.Auto.OFF)
        lowest, highest = (bound * MICROSECOND for bound in camera.get_exposure_time_bounds())
        if not lowest <= settings.exposure <= highest:
            raise CameraSettingRefused(
                f"{name} was asked for exposure {settings.exposure:g} s, it takes {lowest:g} ... {highest:g} s"
            )
        camera.set_exposure_time(settings.exposure / MICROSECOND)
        held["exposure"] = camera.get_exposure_time() * MICROSECOND
        _check(name, "exposure", settings.exposure, held["exposure"], EXPOSURE_TOLERANCE * settings.exposure)
    if settings.gain is not None:
        if not camera.is_gain_available():
            raise _missing(name, "gain", settings.gain)
        if camera.is_gain_auto_available():
            camera.set_gain_auto(aravis.Auto.OFF)
        lowest, highest = camera.get_gain_bounds()
        if not lowest <= settings.gain <= highest:
            raise CameraSettingRefused(
                f"{name} was asked for gain {settings.gain:g}, it takes {lowest:g} ... {highest:g}"
            )
        camera.set_gain(settings.gain)
        held["gain"] = camera.get_gain()
        _check(name, "gain", settings.gain, held["gain"], max(ROUNDING, GAIN_TOLERANCE * settings.gain))
    if settings.white_balance is not None:
        raise CameraSettingRefused(f"{name} gives raw frames, which have no white balance: leave white_balance out")
    if settings.gamma is not None:
        held["gamma"] = _lock_gamma(camera, settings.gamma, name)
    return CameraSettings(**held)


def held_settings(camera: Any, aravis: Any, locked: CameraSettings) -> HeldSettings:
    """Read what the camera holds of the settings that were locked.

    Args:
        camera: an `Aravis.Camera`.
        aravis: the module.
        locked: settings to read; None entries are not asked for.
    """
    values: dict[str, float] = {}
    automatic = []
    if locked.exposure is not None:
        values["exposure"] = camera.get_exposure_time() * MICROSECOND
        if camera.is_exposure_auto_available() and camera.get_exposure_time_auto() != aravis.Auto.OFF:
            automatic.append("exposure")
    if locked.gain is not None:
        values["gain"] = camera.get_gain()
        if camera.is_gain_auto_available() and camera.get_gain_auto() != aravis.Auto.OFF:
            automatic.append("gain")
    if locked.gamma is not None and camera.is_feature_available("Gamma"):
        values["gamma"] = float(camera.get_float("Gamma"))
    return HeldSettings(values=values, automatic=tuple(automatic))


def _lock_gamma(camera: Any, gamma: float, name: str) -> float:
    if not camera.is_feature_available("Gamma"):
        if gamma != 1.0:
            raise _missing(name, "gamma", gamma)
        return 1.0
    if camera.is_feature_available("GammaEnable"):
        camera.set_boolean("GammaEnable", True)
    camera.set_float("Gamma", gamma)
    held = float(camera.get_float("Gamma"))
    _check(name, "gamma", gamma, held, ROUNDING)
    return held


def _check(name: str, what: str, asked: float, held: float, allowed: float) -> None:
    if abs(held - asked) > allowed:
        raise CameraSettingRefused(
            f"{name} was asked for {what} {asked:g} and holds {held:g}: ask for a value it can take"
        )


def _missing(name: str, what: str, asked: float) -> CameraSettingRefused:
    return CameraSettingRefused(f"{name} has no setting {what} (asked for {asked:g}): leave it out")
