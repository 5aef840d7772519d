"""Exposure metering."""

import numpy as np
import pytest

from drivers import LaserBoard, ReplayCamera, meter_exposure
from drivers.errors import CameraError, CameraSettingRefused, CameraTimeout, LaserNotSeen
from testbed.bench_board import BenchBoard, BenchCamera


@pytest.fixture
def ready(board: LaserBoard) -> LaserBoard:
    board.ensure_ready()
    return board


@pytest.mark.parametrize("exposure", [0.0002, 0.002, 0.0045])
def test_ridge_ends_within_the_wanted_levels(
    ready: LaserBoard, camera: BenchCamera, emulated: BenchBoard, scene, exposure: float
) -> None:
    """From a dark, correct or clipped start, the stripe ends bright and unclipped, with the laser off."""
    scene.ambient, scene.brightness = 20.0, 120.0
    result = meter_exposure(ready, camera, 0.1, exposure=exposure, limits=(0.0001, 0.005), levels=(0.5, 0.8))
    assert result.settled and result.advice == ""
    assert 0.5 <= result.stripe_level <= 0.8 and result.clipped_fraction == 0.0
    # The scene is linear: level = (ambient + brightness) * exposure / 2 ms, in counts of 255.
    assert result.stripe_level == pytest.approx(140 * result.exposure / 0.002 / 255, abs=0.03)
    assert result.background_level == pytest.approx(20 * result.exposure / 0.002 / 255, abs=0.03)
    assert not emulated.view().laser_on


def test_too_bright_a_scene_is_reported(ready: LaserBoard, camera: BenchCamera, scene) -> None:
    """Clipped even at the shortest exposure; the advice is to close the iris."""
    scene.brightness = 2000.0
    result = meter_exposure(ready, camera, 0.1, exposure=0.002, limits=(0.001, 0.005))
    assert not result.settled and result.clipped_fraction > 0.5
    assert "close the iris" in result.advice and result.exposure == pytest.approx(0.001)


def test_too_dark_a_scene_is_reported(ready: LaserBoard, camera: BenchCamera, scene) -> None:
    """Dim even at the longest exposure; the advice is to open the iris."""
    scene.ambient, scene.brightness = 5.0, 25.0
    result = meter_exposure(ready, camera, 0.1, exposure=0.002, limits=(0.0005, 0.004))
    assert not result.settled and "open the iris" in result.advice


@pytest.mark.parametrize("rounds", [1, 2])
def test_without_success_it_tells_the_exposure_that_is_set(
    ready: LaserBoard, camera: BenchCamera, scene, rounds: int
) -> None:
    """After the last round, in a scene that needs a longer exposure than allowed."""
    scene.ambient, scene.brightness = 5.0, 25.0
    result = meter_exposure(ready, camera, 0.1, exposure=0.001, limits=(0.0005, 0.0025), max_rounds=rounds)
    assert not result.settled and result.exposure == pytest.approx((0.001, 0.0025)[rounds - 1])


def test_at_least_one_round_is_needed(ready: LaserBoard, camera: BenchCamera) -> None:
    with pytest.raises(ValueError, match="max_rounds is 0; allowed: 1 or more"):
        meter_exposure(ready, camera, 0.1, max_rounds=0)


def test_without_exposure_it_only_measures(ready: LaserBoard, camera: BenchCamera) -> None:
    """A camera whose exposure cannot be set is measured only."""
    result = meter_exposure(ready, camera, 0.1)
    assert result.exposure is None
    assert result.stripe_level == pytest.approx(190 / 255, abs=0.03)


def test_no_stripe_at_all_is_an_error(ready: LaserBoard, camera: BenchCamera, emulated: BenchBoard, scene) -> None:
    """A covered laser cannot be metered, and the laser is off afterwards."""
    scene.swallow = True
    with pytest.raises(LaserNotSeen, match="no column of the image shows the laser"):
        meter_exposure(ready, camera, 0.1, exposure=0.002, limits=(0.001, 0.005))
    assert not emulated.view().laser_on


def test_a_replay_cannot_be_set(ready: LaserBoard) -> None:
    """A replay rejects an exposure."""
    with ReplayCamera([]) as tape, pytest.raises(CameraSettingRefused):
        meter_exposure(ready, tape, 0.1, exposure=0.002)


def test_pictures_of_two_sizes_are_refused(ready: LaserBoard) -> None:
    """The size changed between off and on frame."""
    frames = [np.zeros((10, 20), np.uint8), np.zeros((20, 20), np.uint8)]
    with ReplayCamera(frames) as tape, pytest.raises(CameraError, match=r"from \(10, 20\) to \(20, 20\)"):
        meter_exposure(ready, tape, 0.1)


@pytest.mark.slow
def test_no_frame_is_a_timeout(ready: LaserBoard) -> None:
    """The camera is slower than the timeout."""
    with ReplayCamera([np.zeros((4, 4), np.uint8)] * 2, fps=0.1) as tape, pytest.raises(CameraTimeout, match="metered"):
        meter_exposure(ready, tape, 0.1)


@pytest.mark.parametrize(("name", "pair"), [("limits", (0.02, 0.01)), ("levels", (0.0, 0.5))])
def test_impossible_ranges_are_refused(
    ready: LaserBoard, camera: BenchCamera, name: str, pair: tuple[float, float]
) -> None:
    """The message contains both ends."""
    with pytest.raises(ValueError, match=f"{name} are {pair[0]} ... {pair[1]}; they must increase"):
        meter_exposure(ready, camera, 0.1, **{name: pair})
