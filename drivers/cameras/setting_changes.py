"""Compares what a camera holds with what was locked: another program, or the camera itself, may have changed it."""

from __future__ import annotations

from drivers.cameras.camera import Camera, CameraSettings

UNITS = {"exposure": " s", "gain": "", "white_balance": " K", "gamma": ""}
# Relative; what is read is the camera's own rounding of what was locked, so it should come back as it was.
TOLERANCE = 0.02
# Absolute, in any unit: the locked value of a gain or gamma may be 0.
ROUNDING = {"gain": 0.05, "gamma": 0.005}
WHAT_TO_DO = "see that no other program uses the camera and start again: settings are locked when it is opened"


def setting_changes(camera: Camera, locked: CameraSettings) -> tuple[str, ...]:
    """Which settings are not as they were locked, each in one sentence with what to do; empty when all are.

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
