"""Scans by board sweeps through `acquire`: every frame is verified by its times, or its stripe is lost."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from drivers import (
    AcquireOptions,
    BoardConfig,
    LaserBoard,
    OffFrames,
    StripeVerdict,
    SweepOptions,
    acquire,
    prepare,
    timing,
)
from drivers.emulator import EmulatedClock, EmulatorConfig
from drivers.errors import BoardTooOld, CameraNotTriggered, LaserRefused
from testbed.bench_board import BenchBoard, BenchCamera, Fault, FaultKind, bench_backend
from testbed.triggered_camera import EmulatedTriggeredCamera
from tests.drivers.conftest import PATIENCE

STRIPES = 70
FIRING_ORDER = [(index, -0.14 + 0.46 * index / (STRIPES - 1)) for index in range(STRIPES)]
SWEEP = AcquireOptions(sweep=SweepOptions(flash=0.004))


class Rig:
    """Emulated board with a triggered camera whose images show the position of the mirror."""

    def __init__(self, config: EmulatorConfig | None = None) -> None:
        self.emulated = BenchBoard(config)
        self.camera = EmulatedTriggeredCamera(self.emulated, self.emulated.shutter, self.render)

    @staticmethod
    def row_of(mirror_angle: float) -> int:
        return round(20 + (mirror_angle + 0.15) * 400)

    def render(self, view, settings) -> np.ndarray:
        image = np.full((256, 96, 3), 40, np.uint8)
        if view.laser_fraction > 0.2:
            row = self.row_of(view.mirror_angle)
            image[row - 1 : row + 2, :, 2] = 200
        return image

    def scan(self, board: LaserBoard, options: AcquireOptions = SWEEP, firing_order=FIRING_ORDER):
        with self.camera, acquire(board, self.camera, firing_order, options) as stripes:
            return list(stripes), stripes.report


@pytest.fixture
def rig() -> Iterator[Rig]:
    with timing.on_clock(EmulatedClock()):
        yield Rig()


@pytest.fixture
def board(rig: Rig) -> Iterator[LaserBoard]:
    with LaserBoard(BoardConfig(handle_signals=False), backend=bench_backend(rig.emulated)) as device:
        yield device


def wrong(rig: Rig, stripes) -> list[int]:
    """Indices of the stripes whose image shows another than the commanded angle."""
    found = []
    for stripe in stripes:
        if stripe.on is None:
            continue
        lit = np.flatnonzero(stripe.on[:, 0, 2] > 100)
        if lit.size and abs(lit.mean() - rig.row_of(stripe.mirror_angle)) > 1.5:
            found.append(stripe.index)
    return found


@pytest.mark.parametrize("wired", [False, True])
@pytest.mark.parametrize("off", list(OffFrames))
def test_a_sweep_brings_every_stripe_proved(rig: Rig, board: LaserBoard, off: OffFrames, wired: bool) -> None:
    """In order, in step, each image as commanded; the report says if exposures were counted."""
    rig.emulated.shutter.wired = wired
    stripes, report = rig.scan(board, AcquireOptions(off=off, sweep=SweepOptions()))
    assert [stripe.index for stripe in stripes] == [index for index, _ in FIRING_ORDER]
    assert report.in_step and not report.problems and not wrong(rig, stripes)
    assert ("exposures not counted" in " ".join(report.notes)) == (not wired)
    assert not rig.emulated.view().laser_on


@pytest.mark.parametrize("off", list(OffFrames))
@pytest.mark.parametrize("dropped", [frozenset(), frozenset({5}), frozenset({6}), frozenset({73})])
def test_dark_flashes_come_with_their_stripes(
    rig: Rig, board: LaserBoard, off: OffFrames, dropped: frozenset[int]
) -> None:
    """Verified like every frame, and dark; a lost one is repeated with its stripe."""
    rig.camera.dropped = dropped
    code = frozenset({4, 30, 50, 69})
    stripes, report = rig.scan(board, AcquireOptions(off=off, sweep=SweepOptions(), dark_after=code))
    assert sorted(stripe.index for stripe in stripes) == [index for index, _ in FIRING_ORDER]
    assert not wrong(rig, stripes) and report.in_step and (dropped or not report.problems)
    darks = {stripe.index: stripe.dark for stripe in stripes if stripe.dark is not None}
    assert code <= set(darks) and (dropped or code == set(darks))
    assert all(picture.max() < 100 for picture in darks.values())


def test_a_board_of_the_protocol_before_takes_none(board: LaserBoard) -> None:
    """The scan continues without them, and a note says so."""
    old = EmulatorConfig(identity=replace(EmulatorConfig().identity, protocol=(1, 1)))
    rig = Rig(old)
    with LaserBoard(BoardConfig(handle_signals=False), backend=bench_backend(rig.emulated)) as device:
        stripes, report = rig.scan(device, AcquireOptions(sweep=SweepOptions(), dark_after=frozenset({69})))
    assert report.in_step and all(stripe.dark is None for stripe in stripes)
    assert any(note.startswith("no dark flashes: the board speaks protocol 1.1") for note in report.notes)


def test_it_takes_little_longer_than_the_motion(rig: Rig, board: LaserBoard) -> None:
    """At most 1.15 times motion, settling and flash by the board's motion profile; 0.65 s in all."""
    prepare(board, FIRING_ORDER)
    before = len(rig.emulated.triggers())
    stripes, _ = rig.scan(board)
    triggers = rig.emulated.triggers()[before:]
    motion_profile = board.motion_profile()
    steps = [board.step_at(angle) for _, angle in FIRING_ORDER]
    moves = sum(motion_profile.time(after - here) for here, after in zip(steps, steps[1:], strict=False))
    bound = moves + len(steps) * (motion_profile.settle + 0.004)
    assert len(stripes) == STRIPES and triggers[-1] + 0.004 - triggers[0] <= min(1.15 * bound, 0.65)


@pytest.mark.parametrize("wired", [False, True])
@pytest.mark.parametrize(
    "shutter",
    [
        {"missed": frozenset({0})},
        {"missed": frozenset({1})},
        {"missed": frozenset({5, 6, 7})},
        {"missed": frozenset({70})},
        {"doubled": frozenset({0, 3, 30})},
        {"late": {2: 0.003, 40: 0.0015}},
        {"late": {0: 0.02}, "missed": frozenset({9}), "doubled": frozenset({12})},
    ],
)
def test_triggers_gone_wrong_never_give_a_wrong_stripe(rig: Rig, board: LaserBoard, shutter, wired: bool) -> None:
    """Missed, doubled and late triggers are repeated, and the scan is complete."""
    rig.emulated.shutter.wired = wired
    for name, value in shutter.items():
        setattr(rig.emulated.shutter, name, value)
    stripes, report = rig.scan(board)
    assert not wrong(rig, stripes)
    assert sorted(stripe.index for stripe in stripes) == [index for index, _ in FIRING_ORDER]
    assert all(stripe.on is not None for stripe in stripes)
    assert report.in_step


def test_a_stripe_whose_frame_is_lost_is_taken_again(rig: Rig, board: LaserBoard) -> None:
    rig.camera.dropped = frozenset({4, 33})
    stripes, report = rig.scan(board)
    assert len(stripes) == STRIPES and not wrong(rig, stripes)
    assert "stripes repeated: 2" in report.notes


def test_stripes_taken_again_do_not_wait(rig: Rig, board: LaserBoard) -> None:
    """The clocks are already matched, so uneven waits are not needed."""
    prepare(board, FIRING_ORDER)
    rig.camera.dropped = frozenset(range(41, 46))
    stripes, report = rig.scan(board)
    assert len(stripes) == STRIPES and not wrong(rig, stripes)
    assert "stripes repeated: 5" in report.notes
    gaps = np.diff(rig.emulated.triggers())
    assert gaps.size == STRIPES + 5 and gaps[-4:].max() < 1.05 * np.median(gaps)


def test_what_is_missed_every_time_is_lost(rig: Rig, board: LaserBoard) -> None:
    """A camera that misses every second trigger: its frames can be verified, and none is guessed."""
    rig.emulated.shutter.missed = frozenset(range(1, 400, 2))
    stripes, report = rig.scan(board, AcquireOptions(sweep=SweepOptions(repeats=0)))
    lost = [stripe for stripe in stripes if stripe.verdict is StripeVerdict.LOST]
    assert 30 <= len(lost) <= STRIPES and not wrong(rig, stripes)
    assert any("no frame arrived" in problem for problem in report.problems)


def test_a_camera_without_trigger_is_refused(rig: Rig, board: LaserBoard) -> None:
    with (
        BenchCamera(rig.emulated, rig.render, fps=100, exposure=0.004) as camera,
        pytest.raises(CameraNotTriggered, match="runs freely"),
        acquire(board, camera, FIRING_ORDER, SWEEP) as stripes,
    ):
        list(stripes)


def test_a_board_of_1_0_is_distinguished_from_one_that_sweeps(rig: Rig) -> None:
    """It rejects a sweep with a message."""
    import dataclasses

    old = dataclasses.replace(EmulatorConfig().identity, protocol=(1, 0))
    rig = Rig(EmulatorConfig(identity=old))
    with (
        LaserBoard(BoardConfig(handle_signals=False), backend=bench_backend(rig.emulated)) as board,
        pytest.raises(BoardTooOld, match=r"speaks protocol 1\.0 .*flash"),
    ):
        rig.scan(board)


def test_heat_ends_the_sweep_in_the_dark(rig: Rig, board: LaserBoard) -> None:
    """The board overheats during an exposure, while the reader of the stripes may be far behind."""
    pictures = itertools.count()

    def render(view, settings) -> np.ndarray:
        if next(pictures) == STRIPES // 4:
            rig.emulated.inject(Fault(FaultKind.HOT, amount=70))
        return rig.render(view, settings)

    camera = EmulatedTriggeredCamera(rig.emulated, rig.emulated.shutter, render)
    with (
        camera,
        pytest.raises(LaserRefused, match="too hot"),
        acquire(board, camera, FIRING_ORDER, SWEEP) as stripes,
    ):
        list(stripes)
    assert not rig.emulated.view().laser_on
    assert len(rig.emulated.triggers()) < STRIPES


def test_leaving_early_puts_the_laser_out(rig: Rig, board: LaserBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sweep ends with the block; its second half waits for this, however slow the machine."""
    here, leaving, pictures, off = threading.get_ident(), threading.Event(), itertools.count(), board.laser_off

    def laser_off():
        if threading.get_ident() == here:
            leaving.set()
        return off()

    def render(view, settings) -> np.ndarray:
        if next(pictures) > STRIPES // 2:
            leaving.wait(PATIENCE)
        return rig.render(view, settings)

    monkeypatch.setattr(board, "laser_off", laser_off)
    camera = EmulatedTriggeredCamera(rig.emulated, rig.emulated.shutter, render)
    with camera, acquire(board, camera, FIRING_ORDER, SWEEP) as stripes:
        next(iter(stripes))
        assert not leaving.is_set()
    assert not rig.emulated.view().laser_on
    assert len(rig.emulated.triggers()) < STRIPES


@pytest.mark.parametrize(
    "wrong", [{"flash": 0.0}, {"flash": 1.0}, {"period": -1.0}, {"tolerance": 0.1}, {"repeats": 9}]
)
def test_options_check_themselves(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="allowed: "):
        SweepOptions(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("fps", "off"),
    [
        *((fps, OffFrames.ONE) for fps in (18, 30, 60, 120, 240)),
        *((fps, OffFrames.PER_STRIPE) for fps in (33, 60, 240)),
    ],
)
def test_a_slow_camera_is_proved_too(fps: int, off: OffFrames) -> None:
    """Uneven intervals show although the camera needs time between triggers, and the sweep is hardly longer."""
    with timing.on_clock(EmulatedClock()):
        rig = Rig()
        rig.camera = EmulatedTriggeredCamera(rig.emulated, rig.emulated.shutter, rig.render, fps=fps)
        with LaserBoard(BoardConfig(handle_signals=False), backend=bench_backend(rig.emulated)) as board:
            prepare(board, FIRING_ORDER)
            taken, report = rig.scan(board, AcquireOptions(off=off, sweep=SweepOptions(flash=0.004)))
        assert [stripe.verdict for stripe in taken] == [StripeVerdict.OK] * STRIPES
        assert not any("repeated" in note for note in report.notes)
        frames = len(rig.emulated.triggers())
        assert frames == (STRIPES + 1 if off is OffFrames.ONE else 2 * STRIPES)
        gaps = np.diff(rig.emulated.triggers())
        assert gaps.min() >= 1 / fps - 1e-6
        if fps <= 60:
            assert gaps.sum() < (frames - 1) / fps + 0.05
