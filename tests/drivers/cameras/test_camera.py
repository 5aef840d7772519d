"""Camera settings, and the base class as a context manager."""

import math

import numpy as np
import pytest

from drivers import Camera, CameraSettings, Frame


@pytest.mark.parametrize(
    ("changes", "expected_text"),
    [
        ({"exposure": 0.0}, "exposure is 0.0; it must be finite and above 0"),
        ({"white_balance": -1.0}, "white_balance is -1.0"),
        ({"gamma": math.nan}, "gamma is nan"),
        ({"gain": math.inf}, "gain is inf; it must be finite$"),
    ],
)
def test_a_bad_setting_is_refused(changes: dict, expected_text: str) -> None:
    """The message contains name and value."""
    with pytest.raises(ValueError, match=expected_text):
        CameraSettings(**changes)


def test_gain_may_be_zero_or_less() -> None:
    """Cameras state gain in decibels or in units of their own that start at zero."""
    assert CameraSettings(gain=0.0).gain == 0.0 and CameraSettings(gain=-3.0).gain == -3.0


class Own(Camera):
    """Smallest possible camera: five methods."""

    def __init__(self) -> None:
        self.is_open = False

    def open(self) -> None:
        self.is_open = True

    def close(self) -> None:
        self.is_open = False

    def lock(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def grab(self, timeout: float) -> Frame:
        return Frame(np.zeros((2, 2), np.uint8), 0, 0.0)

    def flush(self) -> None:
        pass


def test_an_own_camera_needs_five_methods_and_is_closed_by_its_block() -> None:
    """The inherited context manager closes it, also after an exception."""
    camera = Own()
    with pytest.raises(KeyError), camera:
        assert camera.is_open
        raise KeyError
    assert not camera.is_open and camera.lag is None


def test_a_camera_without_its_methods_cannot_be_made() -> None:
    """Missing methods raise an error at construction, not during a scan."""
    with pytest.raises(TypeError, match="grab"):
        type("Half", (Camera,), {"open": lambda self: None})()
