"""Faults around a running node: a lost router, pauses that end at any stripe, and lost joints at the end of a pause."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from drivers import LaserBoard, StripeStream
from guara_perception.app.messages import stance_to_message
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.simulated import SimulatedRobot
from guara_perception.scan import Scan, ScanStripe
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from kinematics import RobotModel, Stance
from testbed.bench_board import BenchBoard, BenchCamera, bench_backend
from testbed.recorded_view import RecordedView
from tests.guara_perception.app.node.conftest import Rig
from tests.guara_perception.app.node.live_bench import TIMEOUT, Bench, running, wait_until
from tests.thorough import further
from transport import Health, PausePhase, StancePause
from transport.messages.codec import encode
from transport.messages.stance_pause import make_stance_pause

pytestmark = pytest.mark.slow

PEER = Path(__file__).parents[3] / "transport" / "peer.py"
FPS = 200.0


# A standard scan of 70 stripes, simulated once and replayed live: the same bytes every time.


@pytest.fixture(scope="module")
def standard_scan() -> tuple[Scan, gp.Calibration]:
    robot = SimulatedRobot()
    angles = {stripe.index: stripe.mirror_angle for stripe in robot.calibration.stripes}
    pictures = {f"on {index}": on for index, on, _ in robot._rig.frames(angles)}
    pictures["off"] = robot._rig.frame(laser=0.0)
    scan = Scan(
        robot="guara",
        mode="standard",
        stamp=0,
        step=0,
        stripes=tuple(ScanStripe(index, angle, f"on {index}", "off") for index, angle in angles.items()),
        stance=next(robot.walk(cycles=0)).stance,
        stance_end=None,
        calibration_hash=None,
        source="simulated",
        read_frame=pictures.__getitem__,
    )
    return scan, robot.calibration


@pytest.fixture(scope="module")
def standard_terrain(standard_scan: tuple[Scan, gp.Calibration], robot: RobotModel) -> gp.TerrainGrid:
    return gp.process_scan(*standard_scan, robot, pictures=False)


@pytest.fixture
def standard_bench(
    standard_scan: tuple[Scan, gp.Calibration],
    standard_terrain: gp.TerrainGrid,
    robot: RobotModel,
    free_endpoint: str,
) -> Iterator[Bench]:
    scan, calibration = standard_scan
    board = BenchBoard()
    camera = BenchCamera(board, RecordedView(scan).render, fps=FPS, exposure=0.002, latency=0.001)
    rangefinder = Rangefinder(LaserBoard(backend=bench_backend(board)), camera)
    rig = Rig(rangefinder, board, camera, lambda: pytest.fail("not used"), [], standard_terrain)
    with rangefinder, running(rig, free_endpoint, robot, calibration, scan.stance, mode="standard") as made:
        yield made


def end_at(bench: Bench, stripe: int, step: int) -> Callable[[], None]:
    """Make the gait end the pause after this number of fired stripes; return a function that undoes this."""
    rangefinder = bench.rig.rangefinder
    sweep = rangefinder.sweep

    def watched(firing_order: object, band: object, should_stop: Callable[[], bool]) -> StripeStream:
        def stop() -> bool:
            if not said and len(stream._worker.fired) >= stripe:
                said.append(stripe)
                bench.gait.say(step, PausePhase.END)
                assert wait_until(should_stop)
            return should_stop()

        stream = sweep(firing_order, band, stop)  # type: ignore[arg-type]
        return stream

    said: list[int] = []
    rangefinder.sweep = watched  # type: ignore[method-assign,assignment]
    return lambda: rangefinder.__dict__.pop("sweep")


@pytest.mark.parametrize("stripe", [34, *further(35, 69)])
def test_a_standard_scan_cut_at_any_stripe_leaves_the_rest_unscanned(standard_bench: Bench, stripe: int) -> None:
    """Stripes not fired are UNSCANNED, no unknown cell is free in grid or map, and the next pause is complete."""
    bench, whole = standard_bench, standard_bench.rig.reference
    undo = end_at(bench, stripe, step=0)
    bench.gait.say(0, PausePhase.BEGIN)
    cut = bench.client.wait_for_step(0, timeout=TIMEOUT)
    fused = bench.client.wait_for_step(0, timeout=TIMEOUT, extent="map")
    undo()
    assert not bench.rig.board.view().laser_on
    # The frame of the stripe that was just fired is no longer waited for. One that came as END was read is left out, as
    # the gait's clock is known to a few milliseconds only, on a busy machine less well.
    assert 2 < cut.metadata["stripes_used"] < stripe and not cut.is_provisional
    assert "the pause ended before the scan" in cut.metadata["health"]["reasons"]
    assert bench.rig.never_safer(cut)
    for grid in (cut, fused):
        unknown = (grid.hazard & UNKNOWN_MASK) != 0
        np.testing.assert_array_equal(np.isnan(grid.elevation), unknown)
        assert not np.any((grid.traversability > 0) & unknown)
        assert (grid.to_occupancy()[unknown] == 100).all()
    assert np.any(cut.hazard & Hazard.UNSCANNED)
    lost = np.isfinite(whole.elevation) & np.isnan(cut.elevation)
    assert lost.sum() >= (70 - stripe) / 70 * 0.8 * np.isfinite(whole.elevation).sum()
    bench.gait.say(1, PausePhase.BEGIN)
    again = bench.client.wait_for_step(1, timeout=TIMEOUT)
    np.testing.assert_array_equal(again.hazard, whole.hazard)
    assert again.metadata["health"]["level"] == "ok"


@pytest.mark.parametrize("stripe", [0, *further(1)])
def test_a_scan_of_which_nothing_is_left_is_not_published(standard_bench: Bench, stripe: int) -> None:
    """END at its first stripes: the status states why there is no grid, and the next pause is complete."""
    bench = standard_bench
    undo = end_at(bench, stripe, step=0)
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: any("step 0: the joints that confirm" in item.message for item in bench.status.items()))
    undo()
    bench.gait.say(1, PausePhase.BEGIN)
    again = bench.client.wait_for_step(0, timeout=TIMEOUT)
    assert (again.step, again.metadata["sequence"]) == (1, 1)
    np.testing.assert_array_equal(again.hazard, bench.rig.reference.hazard)


def bad_end(stance: Stance, what: str) -> bytes:
    """END of step 0 as another program may send it, with lost joints."""
    message = make_stance_pause(
        StancePause(robot="guara", step=0, phase=PausePhase.END, stamp=1, stance=stance_to_message(stance))
    )
    reported = message.stance
    if what == "a joint is NaN":
        reported.joint_positions[5] = np.nan
    elif what == "all joints are NaN":
        reported.joint_positions[:] = np.nan
    elif what == "no joints":
        reported.joint_names, reported.joint_positions = [], np.zeros(0)
    elif what == "a joint is missing":
        reported.joint_names, reported.joint_positions = reported.joint_names[1:], reported.joint_positions[1:]
    elif what == "gravity is NaN":
        reported.gravity_known, reported.gravity_in_base.x = True, float("nan")
    return bytes(encode(message))


@pytest.mark.parametrize(
    "what", ["a joint is NaN", "all joints are NaN", "no joints", "a joint is missing", "gravity is NaN", "no message"]
)
def test_a_scan_whose_pause_ends_with_joints_lost_is_not_used(bench: Bench, what: str) -> None:
    """It is not known whether the robot stood still: laser off, no grid, the reason in the status, a complete next
    pause.
    """
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.rig.board.view().laser_on)
    payload = b"\x00\x01nonsense" if what == "no message" else bad_end(bench.gait.stance, what)
    bench.gait.publisher._publisher.put(payload)
    assert wait_until(lambda: any(item.name == "scan" for item in bench.status.items()))
    reported = [item for item in bench.status.items() if item.name in ("scan", "stance")]
    assert all(item.level is Health.ERROR for item in reported)
    assert any("stance" in item.message or "joint" in item.message for item in reported)
    assert not bench.rig.board.view().laser_on
    assert bench.node.latest_map is None
    bench.gait.say(1, PausePhase.BEGIN)
    first = bench.client.wait_for_step(0, timeout=TIMEOUT)
    assert first.step == 1 and first.metadata["sequence"] == 1
    np.testing.assert_array_equal(first.hazard, bench.rig.reference.hazard)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT, extent="map").step == 1
    assert wait_until(lambda: all(item.level is Health.OK for item in bench.status.items()))


@pytest.mark.parametrize("phase", list(PausePhase))
@pytest.mark.parametrize("is_usable", [True, False])
def test_news_of_a_later_pause_end_the_one_under_way(bench: Bench, phase: PausePhase, is_usable: bool) -> None:
    """The END of the pause was lost: the robot has moved on, and the current scan is not used."""
    legs = bench.gait.stance.support_feet if is_usable else ("lf", "xx", "rh")
    stance = Stance(bench.gait.stance.joint_positions, legs, bench.gait.stance.gravity_in_base)
    problems: list[str] = []
    report = bench.status.problem

    def problem(subsystem: str, message: str) -> None:
        problems.append(message)
        report(subsystem, message)

    bench.status.problem = problem  # type: ignore[method-assign]
    seen: list[int] = []
    bench.client.on_terrain(lambda terrain: seen.append(terrain.step))
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.rig.board.view().laser_on)
    bench.gait.say(1, phase, stance)
    assert wait_until(lambda: any("step 0: the pause ended without a usable stance" in message for message in problems))
    bench.gait.say(2, PausePhase.BEGIN)
    np.testing.assert_array_equal(bench.client.wait_for_step(2, timeout=TIMEOUT).hazard, bench.rig.reference.hazard)
    assert wait_until(lambda: 2 in seen) and 0 not in seen
    assert wait_until(lambda: bench.node.latest_map is not None and bench.node.latest_map.step == 2)


class Router:
    """Zenoh router in its own process at a fixed endpoint, which can be killed and restarted."""

    def __init__(self, endpoint: str) -> None:
        self._endpoint = endpoint
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(PEER), "router", self._endpoint],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None and self._process.stdout.readline().strip() == "ready"

    def kill(self) -> None:
        self._process.kill()
        self._process.wait(TIMEOUT)
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()


def test_a_router_that_dies_and_comes_back_costs_no_scan(
    rig: Rig, free_endpoint: str, bench_with: Callable[..., AbstractContextManager[Bench]]
) -> None:
    """The current scan is completed and its grid arrives later; then pauses, planners and status work as before."""
    router = Router(free_endpoint)
    try:
        with bench_with(has_router=True) as bench:
            bench.gait.say(0, PausePhase.BEGIN)
            assert bench.client.wait_for_step(0, timeout=TIMEOUT).step == 0
            bench.gait.say(0, PausePhase.END)
            assert wait_until(lambda: bench.node.wait_for_step(0, TIMEOUT) and bool(bench.session.links()))

            bench.gait.say(1, PausePhase.BEGIN)
            assert wait_until(lambda: rig.board.view().laser_on)
            router.kill()
            assert bench.node.wait_for_step(1, TIMEOUT)
            assert wait_until(lambda: not bench.session.links() and not bench.client.is_alive)
            scanner = next(item for item in bench.status.items() if item.name == "scanner")
            assert (scanner.level, scanner.values["step"], scanner.values["failures"]) == (Health.OK, "1", "0")
            assert bench.node.latest_map is not None and bench.node.latest_map.step == 1

            router.start()
            late = bench.client.wait_for_step(1, timeout=TIMEOUT)
            np.testing.assert_array_equal(late.hazard, rig.reference.hazard)
            bench.gait.say(1, PausePhase.END)
            bench.gait.say(2, PausePhase.BEGIN)
            after = bench.client.wait_for_step(2, timeout=TIMEOUT)
            np.testing.assert_array_equal(after.hazard, rig.reference.hazard)
            assert bench.client.wait_for_step(2, timeout=TIMEOUT, extent="map").step == 2
            with gp.TerrainClient(free_endpoint, timeout=TIMEOUT) as newcomer:
                assert newcomer.wait_for_step(2, timeout=TIMEOUT).step == 2

            def reported() -> dict[str, str]:
                status = bench.client.status()
                items = () if status is None else status.items
                # Two readings per pause are few: `stillness` states what they cannot detect.
                assert all(item.level is Health.OK for item in items if item.name != "stillness")
                return {name: value for item in items for name, value in item.values.items()}

            assert wait_until(lambda: reported().get("last_scan_step") == "2" and reported().get("links") == "1")
    finally:
        router.kill()
