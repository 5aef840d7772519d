"""Report of a calibration for robots whose area differs from the paper's."""

import dataclasses

import pytest

from guara_perception.app.calibration_report.html import report_page
from tests.calibrated_session import calibrated_session


@pytest.mark.heavy
def test_the_report_is_about_the_area_that_the_robot_scans(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Errors in per cent refer to its depth, and each figure of the floor changes with the area."""
    result = calibrated_session(tmp_path_factory)
    pages = [
        report_page(dataclasses.replace(result, area=area)).split()
        for area in (((0.50, 0.95), (-0.27, 0.27)), ((0.55, 0.85), (-0.2, 0.2)))
    ]
    for page, depth in zip(pages, ("450", "300"), strict=True):
        assert f"{depth} mm deep surface" in " ".join(page)
    pictures = [[word for word in page if word.startswith('src="data:')] for page in pages]
    assert sum(one != other for one, other in zip(*pictures, strict=True)) == 3
