"""`AravisCamera` when packets or the camera are lost, with Aravis's fake camera on loopback."""

from __future__ import annotations

import time

import numpy as np
import pytest

from drivers import AravisCamera
from drivers.errors import CameraEnded, CameraTimeout
from tests.drivers.cameras.test_aravis_camera import picture_of
from tests.gige import fake_gige


@pytest.mark.slow
def test_a_frame_whose_packets_were_lost_is_a_gap() -> None:
    """Incomplete images are never returned."""
    with fake_gige(lost_packets=0.005) as fake, AravisCamera(fake.name, trigger="Line1") as camera:
        counters = []
        for number in range(30):
            assert fake.expose(picture_of(number), float(number))
            try:
                frame = camera.grab(1.0)
            except CameraTimeout:
                continue
            counters.append(frame.counter)
            shown = round(frame.device_time or 0)
            assert np.array_equal(frame.image, picture_of(shown)[:, :, 2])
        gaps = np.diff(counters)
        assert 3 < len(counters) < 30 and gaps.max() > 1


@pytest.mark.slow
def test_a_camera_that_vanishes() -> None:
    """The loss is reported once the heartbeat fails."""
    with fake_gige() as fake, AravisCamera(fake.name, trigger="Line1") as camera:
        fake.__exit__(None, None, None)
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            try:
                camera.grab(0.2)
            except CameraTimeout:
                continue
            except CameraEnded as error:
                assert "check its cable and power" in str(error)
                break
        else:
            pytest.fail("the loss was not noticed")
