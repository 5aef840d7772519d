"""The laser-off picture that a scan hands to the map."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.ground_picture import GroundPicture
from guara_perception.scan import frame_reader
from guara_perception.stripes.band import FramePair
from testbed.truth import truth_calibration

DATA = Path(__file__).parents[2] / "data"


@pytest.fixture(scope="module")
def scanned() -> tuple[gp.ScanProcessor, list[FramePair]]:
    """A processor of a recorded scan without frames, and some of its frame pairs."""
    scan = gp.open_scan(DATA / "scans" / "paper")
    pairs = list(map(frame_reader(scan), scan.stripes[10:14]))
    return gp.ScanProcessor(truth_calibration(DATA), scan.robot, scan.stance, scan.mode), pairs


def without_frames(processor: gp.ScanProcessor) -> gp.ScanProcessor:
    return processor.restricted(())


def test_it_is_that_of_the_first_stripe_in_any_order(scanned: tuple[gp.ScanProcessor, list[FramePair]]) -> None:
    """The same picture, whichever stripe comes first; the camera stands where the stance says."""
    processor, pairs = without_frames(scanned[0]), scanned[1]
    for pair in reversed(pairs):
        processor.add_all([pair])
    found, off = processor.ground_picture, pairs[0].off
    assert isinstance(found, GroundPicture)
    assert off is not None
    in_order = without_frames(scanned[0])
    in_order.add_all(pairs)
    other = in_order.ground_picture
    assert isinstance(other, GroundPicture)
    np.testing.assert_array_equal(found.grey, other.grey)
    np.testing.assert_allclose(found.grey, off.mean(axis=2) if off.ndim == 3 else off, atol=60)
    np.testing.assert_array_equal(found.transform_camera_to_footprint, processor.transform_camera_to_footprint)


def test_a_scan_without_laser_off_pictures_says_so(scanned: tuple[gp.ScanProcessor, list[FramePair]]) -> None:
    """No other picture of a scan shows the texture of the ground."""
    processor = without_frames(scanned[0])
    processor.add_all([dataclasses.replace(pair, off=None) for pair in scanned[1]])
    assert processor.ground_picture == "the scan has no laser-off picture"


def test_a_copy_without_that_stripe_does_not_use_its_picture(
    scanned: tuple[gp.ScanProcessor, list[FramePair]],
) -> None:
    """A frame that must not be used provides no picture."""
    processor = without_frames(scanned[0])
    processor.add_all(scanned[1])
    first, *others = (pair.index for pair in scanned[1])
    assert isinstance(processor.restricted([first, *others]).ground_picture, GroundPicture)
    assert processor.restricted(others).ground_picture == "the scan has no laser-off picture"
