"""Messages that a node sends to viewers in addition to its grids."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.app.scene.live import PICTURE_WIDTH_PX, THINNED, LiveView
from guara_perception.app.scene.scene import cloud_points
from guara_perception.scanning.process import run_scan
from kinematics import RobotModel
from transport.messages.codec import read_time


class Sender:
    """Sender that stores the messages."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, make: Any) -> None:
        self.sent = list(make())


def capture(index: int, level: int | None) -> Any:
    return SimpleNamespace(index=index, on=None if level is None else np.full((512, 640, 3), level, np.uint8))


def shown(view: LiveView, sender: Sender) -> int | None:
    """Grey level of the image that is sent; None if there is none."""
    view.send({}, 7)
    if len(sender.sent) < 2:
        return None
    assert read_time(sender.sent[1].header.stamp) == 7
    picture = cv2.imdecode(sender.sent[1].data, cv2.IMREAD_COLOR)
    assert picture.shape == (384, PICTURE_WIDTH_PX, 3)
    return round(float(picture.mean()))


def test_the_median_stripe_is_shown() -> None:
    """In any order of stripes; the first stripe if none near the median was captured; lost frames are skipped."""
    sender = Sender()
    view = LiveView(sender, centre=35)  # type: ignore[arg-type]
    assert shown(view, sender) is None
    for index in (0, 10, 34, 36, 69):
        view.add(capture(index, index))
    assert shown(view, sender) == 34
    view.add(capture(35, None))
    assert shown(view, sender) == 34
    buffer = capture(35, 35)
    view.add(buffer)
    # Cameras reuse their buffers.
    buffer.on[:] = 200
    assert shown(view, sender) == 35
    view.begin()
    assert shown(view, sender) is None
    view.add(capture(2, 2))
    view.add(capture(4, 4))
    assert shown(view, sender) == 2


def test_the_points_are_those_of_the_scan(paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel) -> None:
    """Every third point, all finite, with the stamp of the scan."""
    sender = Sender()
    processor = run_scan(paper_scan, calibration, robot)
    LiveView(sender, centre=35).send(processor.points, 99)  # type: ignore[arg-type]
    (cloud,) = sender.sent
    points = np.vstack([stripe.points for stripe in processor.points.values()])
    points = points[np.isfinite(points).all(axis=1)]
    np.testing.assert_allclose(cloud_points(cloud), points[::THINNED], atol=1e-6)
    assert read_time(cloud.header.stamp) == 99 and cloud.header.frame_id == "base_footprint"
