"""Detection of changed camera settings."""

from __future__ import annotations

import pytest

from drivers import Camera, CameraSettings, HeldSettings, ReplayCamera, setting_changes

LOCKED = CameraSettings(exposure=0.004, gain=0.0, white_balance=5000.0, gamma=1.0)
SAME = {"exposure": 0.004, "gain": 0.0, "white_balance": 5000.0, "gamma": 1.0}


class Reporting(ReplayCamera):
    """Camera that reports the settings given by the test."""

    def __init__(self, values: dict[str, float], automatic: tuple[str, ...] = ()) -> None:
        super().__init__([])
        self.name = "cam"
        self._held = HeldSettings(values=values, automatic=automatic)

    def held(self, locked: CameraSettings) -> HeldSettings:
        return self._held


@pytest.mark.parametrize(
    ("camera", "expected_text"),
    [
        (
            Reporting(SAME | {"exposure": 0.005}),
            "cam: exposure is 0.005 s, it was locked at 0.004 s: check that no other",
        ),
        (
            Reporting(SAME | {"gain": 6.0}),
            "cam: gain is 6, it was locked at 0: check that no other program uses the camera",
        ),
        (Reporting(SAME | {"white_balance": 4000.0}), "cam: white balance is 4000 K, it was locked at 5000 K"),
        (Reporting(SAME | {"gamma": 0.45}), "cam: gamma is 0.45, it was locked at 1"),
        (Reporting(SAME, ("exposure",)), "cam: automatic exposure is on, it was locked at 0.004 s: check"),
        (Reporting({}, ("white_balance",)), "cam: automatic white balance is on, it was locked at 5000 K"),
    ],
)
def test_a_change_is_reported_by_name_with_both_values(camera: Camera, expected_text: str) -> None:
    (reported,) = setting_changes(camera, LOCKED)
    assert reported.startswith(expected_text) and reported.endswith(
        "start again: settings are locked when it is opened"
    )


@pytest.mark.parametrize(
    ("camera", "locked"),
    [
        (Reporting(SAME), LOCKED),
        (Reporting(SAME | {"exposure": 0.00404}), LOCKED),
        (Reporting({"exposure": 9.0}, ("exposure",)), CameraSettings(gain=1.0)),
        (Reporting({}), LOCKED),
        (ReplayCamera([]), LOCKED),
    ],
)
def test_what_is_as_it_was_or_not_reported_is_no_change(camera: Camera, locked: CameraSettings) -> None:
    """Rounding, settings that were not locked, and unreadable cameras are no changes."""
    assert setting_changes(camera, locked) == ()
