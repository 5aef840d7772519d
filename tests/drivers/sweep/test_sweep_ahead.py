"""Scans that grab while the mirror turns: only frames exposed with the mirror at rest and the laser on are used."""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from drivers import (
    AcquireOptions,
    BoardConfig,
    CameraSettings,
    Frame,
    LaserBoard,
    OffFrames,
    ReplayCamera,
    StripeCapture,
    StripeVerdict,
    acquire,
    timing,
)
from drivers.board.protocol import BoardFault, Request
from drivers.emulator import EmulatedClock, EmulatorConfig, ExposureView
from drivers.errors import LaserRefused, MirrorTimeout
from testbed.bench_board import BenchBoard, BenchCamera, CameraFault, Fault, FaultKind, bench_backend
from tests.drivers.conftest import Scene, patient_config

FIRING_ORDER = [(index, -0.1 + 0.012 * index) for index in range(24)]


class Watched:
    """Scene that records the conditions of each image."""

    def __init__(self) -> None:
        self._scene = Scene()
        self._taken: list[tuple[np.ndarray, ExposureView]] = []

    def __call__(self, view: ExposureView, settings: CameraSettings) -> np.ndarray:
        image = self._scene(view, CameraSettings(exposure=0.002))
        self._taken.append((image, view))
        return image

    def of(self, stripe: StripeCapture) -> ExposureView:
        assert stripe.on is not None
        return next(view for image, view in self._taken if stripe.on.base is image)

    def assert_still_and_lit(self, stripes: list[StripeCapture]) -> None:
        """Assert that every image was exposed with the mirror at rest at its stripe and the laser on throughout."""
        for stripe in stripes:
            view = self.of(stripe)
            assert view.mirror_travel == 0.0, stripe.index
            assert view.mirror_angle == pytest.approx(stripe.mirror_angle_reached, abs=1e-9), stripe.index
            assert view.laser_fraction == pytest.approx(1.0), stripe.index


@dataclasses.dataclass
class Rig:
    """Devices that record every exposure."""

    emulated: BenchBoard
    board: LaserBoard
    camera: BenchCamera
    scene: Watched

    def scan(self, options: AcquireOptions | None = None) -> list[StripeCapture]:
        options = options or AcquireOptions(frame_timeout=20.0, queue_size=80)
        with acquire(self.board, self.camera, FIRING_ORDER, options) as stripes:
            taken = list(stripes)
        self.report = stripes.report
        return taken


@contextmanager
def rig_of(config: EmulatorConfig, fps: float, exposure: float, latency: float) -> Iterator[Rig]:
    with timing.on_clock(EmulatedClock()):
        emulated, scene = BenchBoard(config), Watched()
        camera = BenchCamera(emulated, scene, fps=fps, exposure=exposure, latency=latency)
        with LaserBoard(BoardConfig(timeout=0.05), backend=bench_backend(emulated)) as board, camera:
            yield Rig(emulated, board, camera, scene)
        assert not emulated.view().laser_on


@pytest.fixture
def rig() -> Iterator[Rig]:
    with rig_of(patient_config(), 200.0, 0.002, 0.001) as made:
        yield made


@pytest.mark.slow
@pytest.mark.parametrize("settle", [0.0, 0.003, 0.012, 0.03])
@pytest.mark.parametrize(
    ("fps", "exposure", "latency"), [(60.0, 0.008, 0.005), (60.0, 0.016, 0.0005), (200.0, 0.002, 0.004)]
)
def test_no_frame_is_used_that_saw_the_mirror_move(settle: float, fps: float, exposure: float, latency: float) -> None:
    """Motions end long before an exposure, during it, or after several; forwards and, farther, backwards."""
    with rig_of(patient_config(settle=settle), fps, exposure, latency) as rig:
        taken = rig.scan()
        rig.scene.assert_still_and_lit(taken)
        assert len(taken) == len(FIRING_ORDER) and rig.report.in_step and not rig.report.problems


@pytest.mark.slow
def test_one_frame_per_stripe_is_enough_where_the_mirror_is_quick() -> None:
    """The bound on the end of the motion is so tight that no frame is wasted."""
    with rig_of(EmulatorConfig(), 30.0, 0.008, 0.008) as rig:
        rig.scan()
        assert rig.report.frames_skipped <= 4, "while homing ends"
        assert rig.report.duration < 1.5 * (len(FIRING_ORDER) + 1) / 30.0


def test_host_that_sleeps_uses_no_wrong_frame(rig: Rig) -> None:
    """For any delay between command and frame, and after it."""
    real, rng = rig.camera.grab, np.random.default_rng(1)

    def grab(timeout: float) -> Frame:
        timing.sleep(rng.choice([0.0, 0.004, 0.02]))
        frame = real(timeout)
        timing.sleep(rng.choice([0.0, 0.004, 0.02]))
        return frame

    rig.camera.grab = grab  # type: ignore[method-assign]
    taken = rig.scan()
    rig.scene.assert_still_and_lit(taken)
    assert len(taken) == len(FIRING_ORDER) and rig.report.in_step


@pytest.mark.parametrize("kind", ["drop", "repeat"])
def test_frames_dropped_and_repeated_put_nothing_out_of_step(rig: Rig, kind: str) -> None:
    """The end of each motion is read with the frame that arrives instead."""
    rig.camera.faults += [CameraFault(kind, number) for number in range(0, 4000, 3)]
    taken = rig.scan()
    rig.scene.assert_still_and_lit(taken)
    assert len(taken) == len(FIRING_ORDER)


@pytest.mark.parametrize(
    "kind", [FaultKind.GARBAGE, FaultKind.SHORT_READ, FaultKind.STALL, FaultKind.TIMEOUT, FaultKind.TIMEOUT_AFTER]
)
def test_reports_that_are_lost_put_nothing_out_of_step(rig: Rig, kind: FaultKind) -> None:
    """The status only shows that the mirror is at rest now, so the next frame is used."""
    rig.board.ensure_ready()
    rig.emulated.inject(Fault(kind, "report", skip=3, count=4))
    taken = rig.scan()
    rig.scene.assert_still_and_lit(taken)
    assert len(taken) == len(FIRING_ORDER) and rig.report.in_step and not rig.report.problems


@pytest.mark.parametrize("kind", [FaultKind.TIMEOUT_AFTER, FaultKind.GARBAGE])
def test_motion_whose_answer_was_lost_counts_from_the_answer_that_came(rig: Rig, kind: FaultKind) -> None:
    """GO_TO is executed, then repeated."""
    rig.board.ensure_ready()
    rig.emulated.inject(Fault(kind, Request.GO_TO, skip=5, count=2))
    taken = rig.scan()
    rig.scene.assert_still_and_lit(taken)
    assert len(taken) == len(FIRING_ORDER) and rig.report.in_step


def put_out(rig: Rig) -> None:
    rig.emulated._light.cut(BoardFault.WATCHDOG, rig.emulated.clock())


def hot(rig: Rig) -> None:
    rig.emulated.inject(Fault(FaultKind.HOT, amount=65))


def jam(rig: Rig) -> None:
    rig.emulated.inject(Fault(FaultKind.JAMMED))


def while_the_mirror_turns(rig: Rig, stripe: int, what: Callable[[Rig], None]) -> None:
    """Run an action after the GO_TO of a stripe, before its motion ends."""
    real, count = rig.board.go_to_step, []

    def go_to_step(step: int, *, wait: bool = True) -> float:
        reached = real(step, wait=wait)
        count.append(step)
        if len(count) == stripe + 1:
            what(rig)
        return reached

    rig.board.go_to_step = go_to_step  # type: ignore[method-assign]


def test_mirror_that_jams_in_mid_scan_ends_it(rig: Rig) -> None:
    """Frames continue to arrive, but none is used for a stripe whose mirror never came to rest."""
    rig.board.config = BoardConfig(timeout=0.05, motion_timeout=0.3)
    while_the_mirror_turns(rig, 5, jam)
    taken = []
    with acquire(rig.board, rig.camera, FIRING_ORDER, AcquireOptions(queue_size=80, frame_timeout=0.1)) as stripes:
        with pytest.raises(MirrorTimeout, match="did not come to rest"):
            taken.extend(stripes)
    rig.scene.assert_still_and_lit(taken)
    assert 0 < len(taken) < len(FIRING_ORDER)


@pytest.mark.slow
def test_laser_that_the_board_puts_out_in_mid_scan_is_lit_again() -> None:
    """The report of the motion shows it; the frame is not used, and the scan's report says so."""
    with rig_of(patient_config(settle=0.01), 200.0, 0.002, 0.001) as rig:
        while_the_mirror_turns(rig, 7, put_out)
        taken = rig.scan()
        rig.scene.assert_still_and_lit(taken)
        assert all(stripe.verdict is StripeVerdict.OK for stripe in taken) and len(taken) == len(FIRING_ORDER)
        assert rig.report.problems == ("times that the board refused to switch the laser on because of a fault: 1",)


def test_laser_that_the_board_will_not_light_again_ends_the_scan() -> None:
    """The error names over-temperature."""
    with rig_of(patient_config(settle=0.01), 200.0, 0.002, 0.001) as rig:
        while_the_mirror_turns(rig, 7, hot)
        with pytest.raises(LaserRefused, match="too hot"):
            rig.scan()
        rig.emulated.mend()
        rig.board.ensure_ready()


@pytest.mark.slow
def test_laser_rests_before_its_limit() -> None:
    """The laser rests after at most half of the board's limit, so the board never turns it off."""
    config = patient_config()
    config = dataclasses.replace(
        config, identity=dataclasses.replace(config.identity, laser_limit=0.2, laser_rest=0.02)
    )
    with rig_of(config, 50.0, 0.002, 0.001) as rig:
        taken = rig.scan()
        rig.scene.assert_still_and_lit(taken)
        assert rig.report.in_step and not rig.report.problems
        assert BoardFault.LASER_TIME not in rig.board.status().faults
        events = rig.emulated.switchings()
    assert sum(event.on for event in events) >= 3


class Obedient(ReplayCamera):
    """Camera that must not be read while the mirror moves, because each grab takes the next frame."""

    def watch(self, emulated: BenchBoard, moving: list[bool]) -> None:
        self._emulated, self._moving = emulated, moving

    def grab(self, timeout: float) -> Frame:
        self._moving.append(self._emulated.view().moving)
        return super().grab(timeout)


def test_recorded_frame_is_not_asked_for_before_the_mirror_is_still(rig: Rig) -> None:
    """It would be lost if it had to be skipped."""
    frames = [np.full((40, 60, 3), 10 + number, dtype=np.uint8) for number in range(len(FIRING_ORDER))]
    moving: list[bool] = []
    with Obedient(frames) as tape:
        tape.watch(rig.emulated, moving)
        with acquire(rig.board, tape, FIRING_ORDER, AcquireOptions(off=OffFrames.NONE)) as stripes:
            for index, stripe in enumerate(stripes):
                np.testing.assert_array_equal(stripe.on, frames[index])
    assert moving == [False] * len(FIRING_ORDER)


def test_camera_of_unknown_lag_is_not_asked_before_the_mirror_is_still(rig: Rig) -> None:
    """The exposure times of its frames are unknown, so those after the end of the motion are dropped."""
    rig.camera.lag = None
    real, moving = rig.camera.grab, []

    def grab(timeout: float) -> Frame:
        moving.append(rig.emulated.view().moving and rig.emulated.view().laser_on)
        return real(timeout)

    rig.camera.grab = grab  # type: ignore[method-assign]
    taken = rig.scan()
    rig.scene.assert_still_and_lit(taken)
    assert len(taken) == len(FIRING_ORDER) and not any(moving)
