"""Locking of settings in V4L2's units, with a capture that records the settings."""

import cv2
import pytest

from drivers import CameraSettings
from drivers.cameras.opencv_camera import held_settings, lock_settings
from drivers.errors import CameraSettingRefused


class Capture:
    """Device with integer controls, some of which may be missing or fixed."""

    def __init__(self) -> None:
        self.held: dict[int, float] = {}
        self.missing: set[int] = set()
        self.stubborn: dict[int, float] = {}
        self.order: list[int] = []

    def set(self, propId: int, value: float) -> bool:  # noqa: N803 - OpenCV's name
        self.order.append(propId)
        if propId in self.missing:
            return False
        self.held[propId] = self.stubborn.get(propId, round(value))
        return True

    def get(self, propId: int) -> float:  # noqa: N803
        return self.held.get(propId, 0.0)


def test_all_settings_are_held_with_the_automatics_off() -> None:
    """Exposure is in units of 100 us, and automatic modes are turned off before values are set."""
    capture = Capture()
    wanted = CameraSettings(exposure=0.0123, gain=4.0, white_balance=4500.0, gamma=100.0)
    held = lock_settings(capture, wanted, "cam")
    assert held.exposure == pytest.approx(0.0123)
    assert (held.gain, held.white_balance, held.gamma) == (4.0, 4500.0, 100.0)
    assert capture.held[cv2.CAP_PROP_EXPOSURE] == 123
    assert capture.held[cv2.CAP_PROP_AUTO_EXPOSURE] == 1 and capture.held[cv2.CAP_PROP_AUTO_WB] == 0
    assert capture.order.index(cv2.CAP_PROP_AUTO_EXPOSURE) < capture.order.index(cv2.CAP_PROP_EXPOSURE)
    assert capture.order.index(cv2.CAP_PROP_AUTO_WB) < capture.order.index(cv2.CAP_PROP_WB_TEMPERATURE)


def test_what_is_not_asked_for_is_left_alone() -> None:
    """None leaves a setting unchanged."""
    capture = Capture()
    assert lock_settings(capture, CameraSettings(gain=2.0), "cam") == CameraSettings(gain=2.0)
    assert capture.order == [cv2.CAP_PROP_GAIN]


def test_a_missing_setting_is_named() -> None:
    """The message names the setting, the value, and what to do."""
    capture = Capture()
    capture.missing.add(cv2.CAP_PROP_GAMMA)
    with pytest.raises(CameraSettingRefused, match=r"cam has no setting gamma \(asked for 100\).*v4l2-ctl"):
        lock_settings(capture, CameraSettings(gamma=100.0), "cam")


@pytest.mark.parametrize(
    ("prop", "settings", "expected_text"),
    [
        (cv2.CAP_PROP_EXPOSURE, CameraSettings(exposure=0.01), r"exposure \[100 us\] 100, but reports 333"),
        (cv2.CAP_PROP_AUTO_EXPOSURE, CameraSettings(exposure=0.01), "manual exposure 1, but reports 333"),
        (cv2.CAP_PROP_GAIN, CameraSettings(gain=10.0), "gain 10, but reports 333"),
        (cv2.CAP_PROP_WB_TEMPERATURE, CameraSettings(white_balance=5000.0), r"balance \[K\] 5000, but reports 333"),
    ],
)
def test_a_value_that_was_not_taken_is_refused(prop: int, settings: CameraSettings, expected_text: str) -> None:
    """The value read back counts, even if `set` reports success."""
    capture = Capture()
    capture.stubborn[prop] = 333.0
    with pytest.raises(CameraSettingRefused, match=expected_text):
        lock_settings(capture, settings, "cam")


def test_what_is_held_is_read_without_setting_anything() -> None:
    """Locked settings are read in the units of `CameraSettings`; an active automatic mode is named."""
    capture = Capture()
    locked = lock_settings(capture, CameraSettings(exposure=0.0123, gain=4.0, white_balance=4500.0), "cam")
    reported = len(capture.order)
    held = held_settings(capture, locked)
    assert held.values == {"exposure": pytest.approx(0.0123), "gain": 4.0, "white_balance": 4500.0}
    assert held.automatic == () and len(capture.order) == reported
    capture.held |= {cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_AUTO_WB: 1.0, cv2.CAP_PROP_GAIN: 9.0}
    held = held_settings(capture, locked)
    assert held.automatic == ("exposure", "white_balance") and held.values["gain"] == 9.0


def test_a_device_that_tells_nothing_is_not_believed() -> None:
    """OpenCV returns -1 or 0 for values that it cannot read."""
    capture = Capture()
    capture.held = {cv2.CAP_PROP_EXPOSURE: -1.0, cv2.CAP_PROP_AUTO_EXPOSURE: 1.0, cv2.CAP_PROP_GAIN: -1.0}
    held = held_settings(capture, CameraSettings(exposure=0.01, gain=2.0, gamma=1.0))
    assert held.values == {} and held.automatic == ()
