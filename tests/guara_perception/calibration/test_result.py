"""Records of the calibration file that are computed from the fit."""

from types import SimpleNamespace

import numpy as np

from guara_perception.calibration.plates import PlateLine
from guara_perception.calibration.result import paper_record
from guara_perception.calibration.surface_map import SurfaceMap
from tests.guara_perception.recordings import truth


def test_stripes_on_plates_of_one_height_have_no_constants() -> None:
    """Several plates of one height are not enough: the stripe is omitted, and the calibration continues."""
    transform = np.diag([1.0, -1.0, -1.0, 1.0])
    transform[2, 3] = 0.5
    fit = SimpleNamespace(camera=truth().camera, transform_camera_to_footprint=transform)

    def line(index: int, plate: int, height: float) -> PlateLine:
        columns = np.linspace(200.0, 1000.0, 9)
        pixels = np.column_stack((columns, 300.0 + 40.0 * plate + 0.1 * columns))
        return PlateLine(index, 0.1, plate, height, pixels, np.ones(9), 0.1)

    lines = [line(0, 0, 0.0), line(0, 1, 0.04), line(2, 0, 0.04), line(2, 1, 0.04), line(4, 0, 0.0)]
    record = paper_record(SurfaceMap(np.eye(3), 1.0, np.zeros((4, 2))), fit, lines)
    assert [stripe["index"] for stripe in record["stripes"]] == [0]
