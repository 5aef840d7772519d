"""Measurement of a camera's lag."""

import pytest

from drivers import AcquireOptions, LaserBoard, OffFrames, ReplayCamera, acquire, measure_lag
from drivers.errors import CameraTimeout, LaserNotSeen, StripeClipped
from testbed.bench_board import BenchBoard, BenchCamera


@pytest.mark.slow
@pytest.mark.parametrize(("exposure", "latency"), [(0.004, 0.002), (0.006, 0.03)])
def test_measured_lag_is_never_too_short(
    board: LaserBoard, emulated: BenchBoard, scene, exposure: float, latency: float
) -> None:
    """The upper bound covers exposure and latency, also beyond a period; a scan that uses it is in step."""
    board.ensure_ready()
    board.go_to_angle(0.1)
    scene.ambient, scene.brightness = 10.0, 50.0
    with BenchCamera(emulated, scene, fps=60.0, exposure=exposure, latency=latency) as camera:
        measured = measure_lag(board, camera)
        assert not emulated.view().laser_on
        # A frame with nine tenths of the light counts as lit, so the lag may be short by a tenth of the exposure.
        assert measured.lag >= 0.9 * exposure + latency - 1e-4
        assert measured.period == pytest.approx(1 / 60, rel=1e-6)
        # The true lag is within the uncertainty.
        assert measured.lag - measured.uncertainty <= exposure + latency
        camera.lag = measured.lag
        firing_order = [(index, -0.1 + 0.03 * index) for index in range(8)]
        with acquire(
            board, camera, firing_order, AcquireOptions(off=OffFrames.PER_STRIPE, frame_timeout=20)
        ) as stripes:
            list(stripes)
        assert stripes.report.in_step


def test_a_clipped_stripe_is_refused(board: LaserBoard, camera: BenchCamera, scene) -> None:
    """Half an exposure of a clipped stripe looks like a whole one, which would make the lag too short."""
    board.ensure_ready()
    board.go_to_angle(0.1)
    scene.brightness = 1000.0
    with pytest.raises(StripeClipped, match="of the stripe is clipped; allowed: at most 10%"):
        measure_lag(board, camera)


def test_a_covered_laser_has_no_lag(board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, scene) -> None:
    """Images that do not depend on the laser raise an error; the laser is off afterwards."""
    scene.swallow = True
    with pytest.raises(LaserNotSeen, match="on and off do not differ"):
        measure_lag(board, camera)
    assert not emulated.view().laser_on


def test_a_laser_that_stops_answering_is_reported(board: LaserBoard, camera: BenchCamera, scene) -> None:
    """If images no longer follow the switch, the measurement fails in bounded time."""
    real, calls = board.laser_on, []

    def on_once():
        calls.append(1)
        return real() if len(calls) == 1 else board.status()

    board.laser_on = on_once  # type: ignore[method-assign]
    with pytest.raises(LaserNotSeen, match="frames after the laser was switched on"):
        measure_lag(board, camera)


def test_a_replay_has_no_rhythm(board: LaserBoard, scene) -> None:
    """A replay has no lag to measure."""
    import numpy as np

    from drivers import Frame

    same = [Frame(np.zeros((4, 4), np.uint8), 3, 0.0)] * 40
    with (
        ReplayCamera(same) as tape,
        pytest.raises(CameraTimeout, match="stamps or counters of the frames .* do not increase"),
    ):
        measure_lag(board, tape)


def test_too_few_toggles_are_refused(board: LaserBoard, camera: BenchCamera) -> None:
    """Three switchings are too few."""
    with pytest.raises(ValueError, match="toggles is 3; allowed: at least 4"):
        measure_lag(board, camera, toggles=3)
