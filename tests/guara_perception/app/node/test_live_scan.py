"""Live scans with the real driver over an emulated board, without faults and with every fault at several times."""

import dataclasses
import weakref
from collections.abc import Iterator

import numpy as np
import pytest

import guara_perception as gp
from drivers import AcquireOptions, CameraSettings, DriverError, Frame, StripeCapture, StripeStream
from drivers.board.protocol import Request
from drivers.errors import CameraEnded
from guara_perception.app.node.live_scan import LiveScan, live_scan
from guara_perception.app.node.simulated import SimulatedRobot
from guara_perception.terrain.layers.hazard import Hazard
from testbed.bench_board import CameraFault, Fault, FaultKind
from tests.guara_perception.app.node.conftest import Rig
from tests.thorough import further

pytestmark = pytest.mark.slow

TRANSFER_FAULTS = [
    FaultKind.UNPLUG,
    FaultKind.UNPLUG_AFTER,
    FaultKind.STALL,
    FaultKind.TIMEOUT,
    FaultKind.TIMEOUT_AFTER,
    FaultKind.SHORT_READ,
    FaultKind.GARBAGE,
]
STATE_FAULTS = [FaultKind.LASER_STUCK_OFF, FaultKind.BLIND_SENSOR, FaultKind.JAMMED, FaultKind.HOT]


def scan_again_is_whole(rig: Rig) -> bool:
    """True if the next scan gives the grid of an undisturbed scan."""
    rig.board.mend()
    rig.board.replug()
    rig.camera.faults.clear()
    processor = rig.processor()
    scan = live_scan(rig.rangefinder, processor, rig.firing_order, should_stop=lambda: False)
    terrain = processor.finish()
    known = np.isfinite(terrain.elevation).mean()
    return not scan.failed and known > 0.98 * np.isfinite(rig.reference.elevation).mean() and rig.never_safer(terrain)


def test_a_live_scan_gives_the_grid_of_the_recording(rig: Rig) -> None:
    """Driver, board and camera deliver the same bytes as the folder."""
    processor = rig.processor()
    scan = live_scan(rig.rangefinder, processor, rig.firing_order, should_stop=lambda: False)
    assert (scan.failed, scan.stopped_early, scan.problems) == (False, False, ())
    np.testing.assert_array_equal(processor.finish().hazard, rig.reference.hazard)
    assert scan.end > scan.start


def test_a_bad_frame_costs_its_own_stripe_of_a_group(rig: Rig) -> None:
    """Stripes of one group are processed together, except those with an unusable frame."""
    processor = rig.processor()
    real, reported = rig.camera.grab, []

    def grab(timeout: float) -> Frame:
        frame = real(timeout)
        seen.append(frame.counter)
        # Counted by grabbed frames, since a busy machine skips numbers; several, since one may be unused.
        return dataclasses.replace(frame, image=frame.image[::2, ::2]) if 14 <= len(seen) < 20 else frame

    seen: list[int] = []
    rig.camera.grab = grab  # type: ignore[method-assign]
    scan = live_scan(
        rig.rangefinder,
        processor,
        rig.firing_order,
        should_stop=lambda: False,
        on_stripe=lambda capture, _: reported.append(capture.index),
    )
    assert reported == [index for index, _ in rig.firing_order]
    bad = [index for index, profile in processor.profiles.items() if profile.is_frame_bad]
    assert bad and set(processor.points) == set(reported) - set(bad)
    assert any("changed the size of its images" in problem for problem in scan.problems)


def test_frames_are_given_back_before_the_next_group_is_awaited(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """While 16 frames are collected, only one of the previous 16 is kept, for comparison with the next frame."""
    real_grab, real_groups = rig.camera.grab, StripeStream.groups

    def grab(timeout: float) -> Frame:
        # The emulation may keep its own image.
        frame = real_grab(timeout)
        return dataclasses.replace(frame, image=frame.image.copy())

    def groups(stream: StripeStream) -> Iterator[tuple[StripeCapture, ...]]:
        for group in real_groups(stream):
            frames = [weakref.ref(capture.on) for capture in group if capture.on is not None]
            sizes.append(len(frames))
            handed_over = [group]
            del group
            yield handed_over.pop()
            held.append(sum(frame() is not None for frame in frames))

    sizes: list[int] = []
    held: list[int] = []
    rig.camera.grab = grab  # type: ignore[method-assign]
    monkeypatch.setattr(StripeStream, "groups", groups)
    monkeypatch.setattr(rig.rangefinder, "options", AcquireOptions(together=16))
    scan = live_scan(rig.rangefinder, rig.processor(), rig.firing_order, should_stop=lambda: False)
    assert not scan.failed and max(sizes) >= 8
    assert len(held) == len(sizes) and max(held) <= 1


@pytest.mark.parametrize("stop_at", [0, 1, 17])
def test_a_pause_that_ends_leaves_the_rest_unscanned(rig: Rig, stop_at: int) -> None:
    """Stripes that were not fired are UNSCANNED, and no cell becomes safer."""
    processor = rig.processor()
    done: list[int] = []
    scan = live_scan(
        rig.rangefinder,
        processor,
        rig.firing_order,
        should_stop=lambda: len(done) >= stop_at,
        on_stripe=lambda capture, _: done.append(capture.index),
    )
    terrain = processor.finish()
    assert scan.stopped_early or len(done) == len(rig.firing_order)
    assert rig.never_safer(terrain)
    last = max(done, default=-2)
    beyond = [index for index in processor.profiles if index > last + 4]
    assert not beyond
    if len(done) < 30:
        assert np.any(terrain.hazard & Hazard.UNSCANNED)
    assert scan_again_is_whole(rig)


@pytest.mark.parametrize("kind", TRANSFER_FAULTS, ids=lambda kind: kind.value)
@pytest.mark.parametrize("skip", [0, *further(40)])
def test_no_transfer_fault_makes_anything_safer(rig: Rig, kind: FaultKind, skip: int) -> None:
    """USB faults early or late in a scan are survived, and reported if data were lost."""
    rig.board.inject(Fault(kind, skip=skip, count=4))
    processor = rig.processor()
    try:
        scan = live_scan(rig.rangefinder, processor, rig.firing_order, should_stop=lambda: False)
        lost = len(processor.points) < len(rig.firing_order)
        assert not lost or scan.problems
    except DriverError as error:
        pytest.fail(f"a device error escaped: {error}")
    assert rig.never_safer(processor.finish())
    assert scan_again_is_whole(rig)


@pytest.mark.parametrize("kind", STATE_FAULTS, ids=lambda kind: kind.value)
def test_no_device_fault_makes_anything_safer(rig: Rig, kind: FaultKind) -> None:
    """A device that does not do what it reports is detected, or loses returns; it never adds any."""
    rig.board.inject(Fault(kind, amount=95))
    processor = rig.processor()
    live_scan(rig.rangefinder, processor, rig.firing_order, should_stop=lambda: False)
    assert rig.never_safer(processor.finish())
    assert scan_again_is_whole(rig)


def test_lost_steps_are_counted_when_the_mirror_comes_home(rig: Rig) -> None:
    """Homing after the scan shows how many motor steps the mirror lost."""
    rig.board.inject(Fault(FaultKind.LOST_STEP, Request.GO_TO, skip=10, amount=40))
    live_scan(rig.rangefinder, rig.processor(), rig.firing_order, should_stop=lambda: False)
    assert abs(rig.rangefinder.lost_steps(rig.firing_order)) == 40
    assert rig.rangefinder.lost_steps(rig.firing_order) == 0
    assert scan_again_is_whole(rig)


CAMERA_FAULTS = ("drop", "repeat", "freeze", "silence", "resize", "brighten")


# Each kind early or late in the scan; `make test-heavy` tests both.
@pytest.mark.parametrize(
    ("kind", "first"),
    [
        pytest.param(kind, first, marks=[pytest.mark.heavy] * ((number + late) % 2))
        for number, kind in enumerate(CAMERA_FAULTS)
        for late, first in enumerate((1, 20))
    ],
)
def test_no_camera_fault_makes_anything_safer(rig: Rig, kind: str, first: int) -> None:
    """Lost, repeated or frozen frames, or frames of another size or exposure, affect their own stripe only."""
    rig.camera.faults.append(CameraFault(kind, first, 3))
    processor = rig.processor()
    live_scan(rig.rangefinder, processor, rig.firing_order, should_stop=lambda: False)
    assert rig.never_safer(processor.finish())
    assert scan_again_is_whole(rig)


@pytest.fixture(scope="module")
def simulated() -> SimulatedRobot:
    """Camera whose image brightens with exposure and gain; both are locked when it is opened."""
    return SimulatedRobot(fps=120.0)


def short_scan(simulated: SimulatedRobot) -> LiveScan:
    stance = next(simulated.walk(cycles=0)).stance
    processor = gp.ScanProcessor(simulated.calibration, simulated.robot, stance, "coarse")
    order = [(stripe.index, stripe.mirror_angle) for stripe in simulated.calibration.stripes[20:32:2]]
    return live_scan(simulated.rangefinder, processor, order, should_stop=lambda: False)


def test_settings_that_hold_and_good_light_are_not_reported(simulated: SimulatedRobot) -> None:
    """In repeated scans."""
    with simulated.rangefinder:
        assert [short_scan(simulated).problems for _ in range(2)] == [(), ()]


@pytest.mark.parametrize(
    ("changed", "expected_texts"),
    [
        (
            {"gain": 12.0},
            ("gain is 12, it was locked at 1", "% of the picture is clipped without the laser"),
        ),
        ({"gain": 3.0}, ("gain is 3, it was locked at 1", "of the stripe is clipped: expose less or close the iris")),
        ({"exposure": 0.0008}, ("exposure is 0.0008 s, it was locked at", "too dark: expose longer, open the iris")),
    ],
)
def test_what_another_program_changes_is_reported_with_what_it_does_to_the_light(
    simulated: SimulatedRobot, changed: dict[str, float], expected_texts: tuple[str, str]
) -> None:
    """The scan is taken, and the next one reports the change again."""
    with simulated.rangefinder as rangefinder:
        rangefinder.camera.lock(CameraSettings(**changed))
        for _ in range(2):
            scan = short_scan(simulated)
            assert not scan.failed
            for text in expected_texts:
                assert any(text in problem for problem in scan.problems), (text, scan.problems)
        rangefinder.lock(rangefinder.settings)
        assert short_scan(simulated).problems == ()


def test_a_camera_that_does_not_answer_is_reported(rig: Rig) -> None:
    """If reading back fails, the camera's error is among the problems."""
    rig.rangefinder.lock(CameraSettings(gain=1.0))

    def gone(locked: CameraSettings) -> None:
        raise CameraEnded("camera 0 does not answer")

    rig.camera.held = gone  # type: ignore[method-assign, assignment]
    scan = live_scan(rig.rangefinder, rig.processor(), rig.firing_order, should_stop=lambda: False)
    assert "camera 0 does not answer" in scan.problems
