"""Locking and reading back the settings of a GenICam camera."""

from __future__ import annotations

from typing import Any

from drivers.cameras.camera import UNITS, CameraSettings, HeldSettings, check_held
from drivers.errors import CameraSettingRefused

# Absolute tolerance of gain and gamma, because cameras round them.
ROUNDING = 0.05
# Per setting: name in Aravis's methods, unit, relative tolerance, absolute tolerance. Cameras round exposure to rows or
# clock ticks, and gain to fractions of a decibel.
FEATURES = {"exposure": ("exposure_time", 1e-6, 0.05, 0.0), "gain": ("gain", 1.0, 0.02, ROUNDING)}


def lock_settings(camera: Any, aravis: Any, settings: CameraSettings, name: str) -> CameraSettings:
    """Turn automatic modes off, apply the settings, and return the values read back from the camera.

    Args:
        camera: open `Aravis.Camera`.
        aravis: module `Aravis`.
        settings: settings to apply; None entries are not changed. Because frames are raw, a white balance is rejected;
            so is a gamma other than 1 if the camera has no gamma feature.
        name: name of the camera, for error messages.

    Raises:
        CameraSettingRefused: the camera lacks a setting, does not allow a value, or reports a different one.
    """
    held: dict[str, float] = {}
    for setting, (feature, unit, tolerance, rounding) in FEATURES.items():
        asked = getattr(settings, setting)
        if asked is None:
            continue
        if not getattr(camera, f"is_{feature}_available")():
            raise _missing(name, feature.replace("_", " "), asked)
        if getattr(camera, f"is_{setting}_auto_available")():
            getattr(camera, f"set_{feature}_auto")(aravis.Auto.OFF)
        lowest, highest = (bound * unit for bound in getattr(camera, f"get_{feature}_bounds")())
        if not lowest <= asked <= highest:
            unit_name = UNITS[setting]
            raise CameraSettingRefused(
                f"{name} was asked for {setting} {asked:g}{unit_name}; allowed: {lowest:g} ... {highest:g}{unit_name}"
            )
        getattr(camera, f"set_{feature}")(asked / unit)
        held[setting] = getattr(camera, f"get_{feature}")() * unit
        check_held(name, setting, asked, held[setting], max(rounding, tolerance * asked))
    if settings.white_balance is not None:
        raise CameraSettingRefused(f"{name} delivers raw frames, which have no white balance: leave white_balance out")
    if settings.gamma is not None:
        held["gamma"] = _lock_gamma(camera, settings.gamma, name)
    return CameraSettings(**held)


def held_settings(camera: Any, aravis: Any, locked: CameraSettings) -> HeldSettings:
    """Read the locked settings back from the camera.

    Args:
        camera: open `Aravis.Camera`.
        aravis: module `Aravis`.
        locked: settings to read; None entries are not read.
    """
    values: dict[str, float] = {}
    automatic = []
    for setting, (feature, unit, _, _) in FEATURES.items():
        if getattr(locked, setting) is None:
            continue
        values[setting] = getattr(camera, f"get_{feature}")() * unit
        has_automatic = getattr(camera, f"is_{setting}_auto_available")()
        if has_automatic and getattr(camera, f"get_{feature}_auto")() != aravis.Auto.OFF:
            automatic.append(setting)
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
    check_held(name, "gamma", gamma, held, ROUNDING)
    return held


def _missing(name: str, what: str, asked: float) -> CameraSettingRefused:
    return CameraSettingRefused(f"{name} has no setting {what} (asked for {asked:g}): leave it out")
