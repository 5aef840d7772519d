"""Robot that moves during its pause: grids are provisional until the gait confirms them, and otherwise withdrawn."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.open_scan import open_scans
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.simulation.walk import fresh_reading
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from kinematics import RobotModel, Stance
from testbed.moved_robot import scan_of_a_moved_robot
from tests.guara_perception.app.node.live_bench import TIMEOUT, Bench, wait_until
from tests.guara_perception.app.node.test_node_faults import bad_end
from transport import GroundPatch, PausePhase, StanceMessage, StancePause
from transport.messages.codec import encode
from transport.messages.stance_pause import make_stance_pause
from transport.stance_link import StancePublisher

pytestmark = pytest.mark.slow


def both(bench: Bench, step: int, *, confirmed: bool = False) -> tuple[gp.TerrainGrid, gp.TerrainGrid]:
    """Scan and map of a pause."""
    footprint = bench.client.wait_for_step(step, timeout=TIMEOUT, confirmed=confirmed)
    return footprint, bench.client.wait_for_step(step, timeout=TIMEOUT, extent="map", confirmed=confirmed)


def reported(bench: Bench, expected_text: str) -> bool:
    return wait_until(lambda: any(expected_text in item.message for item in bench.status.items()))


def is_withdrawn(terrain: gp.TerrainGrid) -> bool:
    """True if all cells are unknown, none is free in any encoding, and the record says that the grid is withdrawn."""
    unknown = (terrain.hazard & UNKNOWN_MASK) != 0
    free = (
        (terrain.traversability > 0) | (terrain.to_occupancy(allow_stale=True) < 100) | np.isfinite(terrain.elevation)
    )
    return bool(unknown.all() and not free.any() and terrain.metadata["health"]["level"] == "failed")


def wait_for_withdrawal(bench: Bench, extent: str = "footprint") -> gp.TerrainGrid:
    """Wait until the newest grid withdraws another, and return it."""

    def is_there() -> bool:
        received = bench.client._client.receiver(extent).latest()
        return (
            received is not None
            and received.message.health_reasons[:1] != ()
            and ("withdrawn" in received.message.health_reasons[0])
        )

    assert wait_until(is_there)
    return bench.client.latest(extent=extent, allow_stale=True)


def test_a_grid_is_provisional_until_end_has_confirmed_it(bench: Bench) -> None:
    """Before END the grid is provisional, afterwards confirmed."""
    bench.gait.say(0, PausePhase.BEGIN)
    for grid in both(bench, 0):
        assert grid.is_provisional and "provisional" in repr(grid.metadata)
    bench.gait.say(0, PausePhase.END)
    footprint, fused = both(bench, 0, confirmed=True)
    assert not footprint.is_provisional and not fused.is_provisional
    np.testing.assert_array_equal(footprint.hazard, bench.rig.reference.hazard)
    assert np.isfinite(fused.elevation).any()


def test_a_robot_that_stands_keeps_its_scans(bench: Bench) -> None:
    """With noise in every reading, including BEGIN, each pause is confirmed, with and without HOLD."""
    rng = np.random.default_rng(1)
    for step in range(8):
        bench.gait.say(step, PausePhase.BEGIN, fresh_reading(bench.gait.stance, rng))
        bench.client.wait_for_step(step, timeout=TIMEOUT)
        for _ in range(10 if step % 2 else 0):
            bench.gait.say(step, PausePhase.HOLD)
        bench.gait.say(step, PausePhase.END)
        for grid in both(bench, step, confirmed=True):
            assert np.isfinite(grid.elevation).any()
    assert not any("withdrawn" in item.message for item in bench.status.items())


ENDS: dict[str, Callable[[Bench], None]] = {
    "END with the camera elsewhere": lambda bench: bench.gait.say(0, PausePhase.END, bench.gait.moved()),
    "HOLD with the camera elsewhere": lambda bench: bench.gait.say(0, PausePhase.HOLD, bench.gait.moved()),
    "END that cannot be read": lambda bench: bench.gait.publisher._publisher.put(b"\x00\x01nonsense"),
    "END with a joint that is NaN": lambda bench: bench.gait.publisher._publisher.put(
        bad_end(bench.gait.stance, "a joint is NaN")
    ),
    "a second BEGIN with other joints": lambda bench: bench.gait.say(0, PausePhase.BEGIN, bench.gait.moved()),
    "BEGIN of the next pause, without END": lambda bench: bench.gait.say(1, PausePhase.BEGIN, bench.gait.moved()),
}


@pytest.mark.parametrize("how", ENDS)
def test_a_grid_that_the_pause_contradicts_is_withdrawn(bench: Bench, how: str) -> None:
    """The gait reports after the scan that the robot moved, or does not confirm it: grid and map are then unknown."""
    heard: list[tuple[str, gp.TerrainGrid]] = []
    for extent in ("footprint", "map"):
        bench.client.on_terrain(lambda grid, extent=extent: heard.append((extent, grid)), extent)
    bench.gait.say(0, PausePhase.BEGIN)
    footprint, fused = both(bench, 0)
    assert (footprint.traversability > 0).any() and np.isfinite(fused.elevation).any()
    ENDS[how](bench)
    for extent in ("footprint", "map"):
        assert wait_until(lambda extent=extent: any(name == extent and is_withdrawn(grid) for name, grid in heard))
        assert all(is_withdrawn(grid) or grid.is_provisional for name, grid in heard if name == extent)
    assert reported(bench, "withdrawn") or "BEGIN" in how


def assert_shows_the_same(one: gp.TerrainGrid, other: gp.TerrainGrid) -> None:
    """Two maps of the same memory: equal bit for bit where their poses are.

    Where a busy machine lost frames, registration gave their pauses poses that differ by micrometres, so that a few
    cells lie on the other side of a border.
    """
    apart = np.subtract(*(grid.metadata["transform_footprint_to_odom"] for grid in (one, other)))
    is_other = (one.looks != other.looks) | (np.isnan(one.elevation) != np.isnan(other.elevation))
    if np.any(apart):
        assert np.abs(apart).max() < 1e-4 and is_other.sum() < 0.005 * np.count_nonzero(other.looks)
        return
    assert not is_other.any() and not np.any((one.hazard == 0) & (other.hazard != 0))
    np.testing.assert_array_equal(one.elevation, other.elevation)


def test_what_a_withdrawn_scan_gave_to_the_map_is_undone(bench: Bench) -> None:
    """The next map knows exactly what the previous pause saw, bit for bit; the pause after it is complete."""
    bench.gait.say(0, PausePhase.BEGIN)
    both(bench, 0)
    bench.gait.say(0, PausePhase.END)
    both(bench, 0, confirmed=True)
    bench.gait.say(1, PausePhase.BEGIN)
    before = both(bench, 1)[1]
    bench.gait.say(1, PausePhase.END)
    confirmed = both(bench, 1, confirmed=True)[1]
    np.testing.assert_array_equal(confirmed.elevation, before.elevation)
    bench.gait.say(2, PausePhase.BEGIN)
    assert both(bench, 2)[1].looks.max() == confirmed.looks.max() + 1
    bench.gait.say(2, PausePhase.END, bench.gait.moved())
    assert is_withdrawn(wait_for_withdrawal(bench))
    after = wait_for_withdrawal(bench, "map")
    assert after.step == 2 and "withdrawn" in after.metadata["health"]["reasons"][0]
    assert_shows_the_same(after, confirmed)
    bench.gait.say(3, PausePhase.BEGIN)
    footprint, fused = both(bench, 3)
    assert bench.rig.never_safer(footprint)
    if footprint.metadata["health"]["level"] == "ok":
        np.testing.assert_array_equal(footprint.hazard, bench.rig.reference.hazard)
    assert fused.looks.max() == confirmed.looks.max() + 1 and fused.metadata["restarts"] == []


def test_a_hold_after_the_last_frame_confirms_and_one_before_it_does_not(bench: Bench) -> None:
    """The robot still stands; later announcements do not undo what the scan added to the map."""
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.rig.board.view().laser_on)
    bench.gait.say(0, PausePhase.HOLD)
    assert all(grid.is_provisional for grid in both(bench, 0))
    # Joints read before the last frame, which arrive late.
    bench.gait.say(0, PausePhase.HOLD, stamp=bench.gait.first_stamp)
    bench.gait.say(0, PausePhase.HOLD)
    footprint, fused = both(bench, 0, confirmed=True)
    assert not footprint.is_provisional and not fused.is_provisional
    assert bench.client.request_scan("coarse", timeout=TIMEOUT).is_provisional
    bench.gait.say(0, PausePhase.END, bench.gait.moved())
    assert is_withdrawn(wait_for_withdrawal(bench))
    # The map contains only the first scan, which was confirmed.
    assert np.isfinite(bench.client.latest(extent="map").elevation).any()


def test_a_movement_ends_the_scan_at_once(bench: Bench) -> None:
    """A HOLD with other joints during a sweep: laser off, no grid, and the next pause is scanned."""
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.rig.board.view().laser_on)
    bench.gait.say(0, PausePhase.HOLD, bench.gait.moved())
    assert reported(bench, "camera moved by")
    assert wait_until(lambda: not bench.rig.board.view().laser_on)
    with pytest.raises(gp.ScanFailed, match="not in a stance pause"):
        bench.client.request_scan("coarse", timeout=TIMEOUT)
    bench.gait.say(1, PausePhase.BEGIN)
    first = bench.client.wait_for_step(0, timeout=TIMEOUT)
    assert (first.step, first.metadata["sequence"]) == (1, 1)


def test_a_pause_expires_when_its_gait_has_died(bench: Bench) -> None:
    """The grid is withdrawn after the available time and the grace; scans are refused after the available time."""
    bench.gait.say(0, PausePhase.BEGIN, time_available=8.0)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT).is_provisional
    message = bench.client._client.receiver().latest().message
    assert message.valid_for <= 8.0 + 2.0
    bench.gait.session.close()
    assert reported(bench, "no END arrived within the 8 s of the pause")
    assert is_withdrawn(wait_for_withdrawal(bench)) and is_withdrawn(wait_for_withdrawal(bench, "map"))
    with pytest.raises(gp.ScanFailed, match="not in a stance pause"):
        bench.client.request_scan("coarse", timeout=TIMEOUT)


def test_a_second_begin_with_the_same_joints_says_nothing_new(bench: Bench) -> None:
    """A gait may repeat BEGIN for nodes that start late, at no cost to the scan."""
    bench.gait.say(0, PausePhase.BEGIN, epoch="walk-a")
    both(bench, 0)
    bench.gait.say(0, PausePhase.BEGIN, epoch="walk-a")
    bench.gait.say(0, PausePhase.END, epoch="walk-a")
    assert both(bench, 0, confirmed=True)[0].metadata["sequence"] == 2


def test_a_second_begin_of_a_gait_without_epochs_is_another_pause(bench: Bench) -> None:
    """The gait restarted its count in the same posture: the robot may have been carried in between."""
    bench.gait.say(0, PausePhase.BEGIN)
    both(bench, 0)
    before = bench.node._pause
    bench.gait.say(0, PausePhase.BEGIN)
    assert wait_until(lambda: bench.node._pause is not before)
    assert before is not None and before.broken and before.still_until <= before.begun


@pytest.mark.parametrize(
    ("position", "expected_text"),
    [(1e6, "is at 1e+06 rad, half a turn or more beyond its limits"), (3.0, "joints at impossible positions")],
)
def test_joints_that_no_robot_can_have_are_refused(bench: Bench, position: float, expected_text: str) -> None:
    """A million radians, and positions beyond all limits: reported in the status and not scanned; the next pause is."""
    wild = Stance(dict.fromkeys(bench.gait.stance.joint_positions, position), bench.gait.stance.support_feet, None)
    bench.gait.say(0, PausePhase.BEGIN, wild)
    assert reported(bench, expected_text)
    bench.gait.say(1, PausePhase.BEGIN)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT).step == 1


def test_a_phase_that_is_not_known_changes_nothing(bench: Bench) -> None:
    """An announcement of a later version is reported as unknown, and the pause continues."""
    bench.gait.say(0, PausePhase.BEGIN)
    both(bench, 0)
    stance = StanceMessage(joint_positions=bench.gait.stance.joint_positions, support_feet=("lf",))
    message = make_stance_pause(StancePause(robot="guara", step=0, phase=PausePhase.END, stamp=1, stance=stance))
    message.phase = 9
    bench.gait.publisher._publisher.put(bytes(encode(message)))
    assert reported(bench, "phase is 9; known: 1 (BEGIN), 2 (END) and 3 (HOLD)")
    bench.gait.say(0, PausePhase.END)
    assert not both(bench, 0, confirmed=True)[0].is_provisional


def test_the_frame_of_a_footprint_ends_with_its_pause(bench: Bench) -> None:
    """After the next BEGIN the footprint is stale for every client; the map remains valid."""
    bench.gait.say(0, PausePhase.BEGIN)
    both(bench, 0)
    bench.gait.say(0, PausePhase.END)
    both(bench, 0, confirmed=True)
    bench.node._server.begin_step(1)

    def is_reported() -> bool:
        try:
            bench.client.latest()
        except gp.StaleTerrain as error:
            return "1 pause old; allowed: 0" in str(error)
        return False

    assert wait_until(is_reported)
    assert bench.client.latest(extent="map").step == 0


@pytest.mark.parametrize("what", ["BEGIN with a foot that the robot has not", "END whose BEGIN was missed"])
def test_a_pause_that_cannot_be_scanned_ends_the_use_of_the_one_before(bench: Bench, what: str) -> None:
    """The robot is elsewhere, even if the node cannot scan there; the confirmed grid is not valid there."""
    for extent in ("footprint", "map"):
        bench.client.counts(extent)
    bench.gait.say(0, PausePhase.BEGIN)
    both(bench, 0)
    bench.gait.say(0, PausePhase.END)
    both(bench, 0, confirmed=True)
    assert bench.client.latest().step == 0
    if what.startswith("BEGIN"):
        wrong = Stance(bench.gait.stance.joint_positions, ("lf", "xx", "rh"), None)
        bench.gait.say(3, PausePhase.BEGIN, wrong)
    else:
        bench.gait.say(3, PausePhase.END)

    def is_refused() -> bool:
        try:
            bench.client.latest()
        except gp.StaleTerrain as error:
            return "3 pauses old; allowed: 0" in str(error)
        return False

    assert wait_until(is_refused)


@pytest.mark.parametrize("epoch", ["", "walk-a"])
def test_a_later_pause_of_the_same_number_ends_the_use_of_the_one_before(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, epoch: str
) -> None:
    """A gait that restarts at 0: the confirmed grid belongs to another place, although step and walk are equal."""
    bench.client.counts()
    bench.gait.say(0, PausePhase.BEGIN, epoch=epoch)
    bench.client.wait_for_step(0, timeout=TIMEOUT)
    bench.gait.say(0, PausePhase.END, epoch=epoch)
    bench.client.wait_for_step(0, timeout=TIMEOUT, confirmed=True)
    assert bench.client.latest().step == 0
    monkeypatch.setattr(bench.node._scanner, "scan", Mock(side_effect=gp.PerceptionError("the scanner is broken")))
    bench.gait.say(0, PausePhase.BEGIN, epoch=epoch)
    assert reported(bench, "the scanner is broken")

    def is_refused() -> bool:
        try:
            bench.client.latest()
        except gp.StaleTerrain as error:
            return "has since published or skipped sequence" in str(error)
        return False

    assert wait_until(is_refused)


GROUND = [(0.5, -0.1), (0.6, -0.1), (0.6, 0.1)]


def patches(count: int = 1, corners: int = 3, height: float = 0.0, sigma: float = 0.002, reach: float = 0.0) -> object:
    """Known ground as declared by the gait."""
    outline = [*GROUND, *[(0.5 - 0.001 * i - reach, 0.0) for i in range(corners - 3)]]
    return tuple(GroundPatch(outline=outline, height=height, sigma=sigma) for _ in range(count))


REFUSED_GROUND: dict[str, tuple[dict[str, object], str]] = {
    "another frame": ({"known_ground": patches(), "frame_id": "odom"}, "declared in frame 'odom'"),
    "too many": ({"known_ground": patches(17)}, "has 17 patches"),
    "too many corners": ({"known_ground": patches(corners=17)}, "number of corners is 17"),
    "too low": ({"known_ground": patches(height=-1e5)}, "height [m] is -100000"),
    "too doubtful": ({"known_ground": patches(sigma=1.0)}, "sigma [m] is 1;"),
    "too far": ({"known_ground": patches(corners=4, reach=1e6)}, "largest absolute coordinate [m] is 1e+06"),
}


def test_ground_that_nobody_can_know_is_refused_in_words(bench: Bench) -> None:
    """No patch is added to the map; each pause is scanned, and valid ground of the next pause is used."""
    for step, (what, (fields, expected_text)) in enumerate(REFUSED_GROUND.items()):
        bench.gait.say(step, PausePhase.BEGIN, **fields)
        assert reported(bench, expected_text), what
        assert both(bench, step)[1].metadata["known_ground"] == [], what
        bench.gait.say(step, PausePhase.END)
    last = len(REFUSED_GROUND)
    bench.gait.say(last, PausePhase.BEGIN, known_ground=patches())
    assert len(both(bench, last)[1].metadata["known_ground"]) == 1
    assert all(item.name != "known_ground" for item in bench.status.items())


def test_the_node_is_not_moved_by_what_is_said_to_another_robot(bench: Bench) -> None:
    """A BEGIN for robot `other` on this robot's key is reported and not scanned; its END does not end the pause."""
    key = bench.gait.publisher._publisher
    stance = StanceMessage(
        joint_positions=bench.gait.stance.joint_positions, support_feet=bench.gait.stance.support_feet
    )
    for phase in (PausePhase.BEGIN, PausePhase.END):
        key.put(encode(make_stance_pause(StancePause(robot="other", step=0, phase=phase, stamp=1, stance=stance))))
        assert reported(bench, "the announcement is for robot 'other'; this node is 'guara'")
        bench.gait.say(0, PausePhase.BEGIN)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT).metadata["sequence"] == 1


def test_walks_have_an_identity(bench: Bench) -> None:
    """Grids have the epoch of BEGIN; without one, counting from 0 begins another walk; late messages are refused."""
    bench.gait.say(5, PausePhase.BEGIN, epoch="walk-a")
    assert {grid.metadata["epoch"] for grid in both(bench, 5)} == {"walk-a"}
    bench.gait.say(5, PausePhase.END, epoch="walk-a")
    bench.gait.say(4, PausePhase.BEGIN, epoch="walk-a")
    assert reported(bench, "comes late: step 5 of walk 'walk-a' has begun")
    bench.gait.say(0, PausePhase.BEGIN, epoch="walk-b")
    footprint, fused = both(bench, 0)
    assert footprint.metadata["epoch"] == fused.metadata["epoch"] == "walk-b" and fused.looks.max() == 1
    bench.gait.say(0, PausePhase.END, epoch="walk-b")
    bench.gait.say(6, PausePhase.BEGIN, epoch="walk-a")
    assert reported(bench, "belongs to walk 'walk-a', which is over")
    walks = []
    for step in (7, 8, 0):
        bench.gait.say(step, PausePhase.BEGIN)
        walks.append(both(bench, step)[0].metadata["epoch"])
        bench.gait.say(step, PausePhase.END)
        both(bench, step, confirmed=True)
    assert walks[0] == walks[1] != walks[2] and "walk-b" not in walks


def test_no_frame_after_the_robot_moved_is_confirmed_by_an_end_that_comes_late(free_endpoint: str) -> None:
    """In dim light the frames do not show the motion; all frames together contain many wrong free cells."""
    found = scan_of_a_moved_robot(free_endpoint)
    assert found.wrong_in_all_frames > 100
    assert (found.confirmed_wrong, found.map_wrong) == (0, 0)


def test_frames_after_the_joints_of_end_leave_grid_and_map(
    bench_with: Callable[..., AbstractContextManager[Bench]],
    robot: RobotModel,
    calibration: gp.Calibration,
    tmp_path: Path,
) -> None:
    """An END that was held up for most of a scan: stripes until its joints were read are confirmed, no others.

    The recording says that not all of its frames may be used.
    """
    path = tmp_path / "walk.mcap"
    recorder = ScanRecorder(path, robot="guara", calibration=calibration, jpeg_quality=80)
    with recorder, bench_with(recorder) as bench:
        bench.rig.camera._period = 0.05
        bench.gait.say(0, PausePhase.BEGIN)
        provisional, fused = both(bench, 0)
        message = bench.client._client.receiver().latest().message
        middle = (message.scan_start + message.scan_end) // 2
        bench.gait.say(0, PausePhase.END, stamp=middle)
        cut, fused_cut = both(bench, 0, confirmed=True)
        assert 4 < cut.metadata["stripes_used"] < 25 and provisional.metadata["stripes_used"] == 35
        assert "were taken after the last joint reading that confirms the scan" in str(
            cut.metadata["health"]["reasons"]
        )
        gone = np.isfinite(provisional.elevation) & np.isnan(cut.elevation)
        assert gone.sum() > 1000 and bench.rig.never_safer(cut)
        assert np.mean((cut.hazard[gone] & Hazard.UNSCANNED) != 0) > 0.9
        assert 0 < np.isfinite(fused_cut.elevation).sum() < np.isfinite(fused.elevation).sum() - 1000
        assert fused_cut.looks.max() == 1
        bench.gait.say(1, PausePhase.BEGIN)
        assert both(bench, 1)[1].looks.max() == 2
        bench.gait.say(1, PausePhase.END)
        both(bench, 1, confirmed=True)
    first, second = open_scans(path)
    assert "were read before" in first.withdrawn and not second.withdrawn


def test_an_end_that_was_read_before_the_scan_withdraws_it(bench: Bench) -> None:
    """Nothing is left of the scan: grid and map are unknown."""
    bench.gait.say(0, PausePhase.BEGIN)
    both(bench, 0)
    bench.gait.say(0, PausePhase.END, stamp=bench.gait.first_stamp + 1)
    assert is_withdrawn(wait_for_withdrawal(bench)) and is_withdrawn(wait_for_withdrawal(bench, "map"))
    assert reported(bench, "the joints that confirm the scan were read before it was complete")


def test_without_the_gaits_clock_grids_stay_provisional_and_out_of_the_map(
    bench_with: Callable[..., AbstractContextManager[Bench]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The status states the reason and the remedy; once the clock is known, the pause is confirmed."""
    monkeypatch.setattr(StancePublisher, "_answer", lambda self, query: query.drop())
    with bench_with() as bench:
        bench.gait.say(0, PausePhase.BEGIN)
        both(bench, 0)
        bench.gait.say(0, PausePhase.END)
        assert reported(bench, "the gait's clock is unknown (guara/gait/v1/clock gives no answer")
        assert reported(bench, "Announce pauses with the StancePublisher of this version")
        message = bench.client._client.receiver().latest().message
        assert message.provisional and not message.withdrawn
        bench.gait.say(1, PausePhase.BEGIN)
        assert both(bench, 1)[1].looks.max() == 1
        bench.gait.say(1, PausePhase.END)
        monkeypatch.undo()
        StancePublisher(bench.gait.session)
        footprint, fused = both(bench, 1, confirmed=True)
        assert not footprint.is_provisional and np.isfinite(fused.elevation).any()
        assert wait_until(lambda: all(item.name != "gait_clock" for item in bench.status.items()))


def test_a_movement_that_comes_to_light_after_end_withdraws_what_was_confirmed(bench: Bench) -> None:
    """A delayed HOLD that was read before END withdraws scan and map; one read during the swing changes nothing."""
    bench.gait.say(0, PausePhase.BEGIN)
    both(bench, 0)
    held_up = time.time_ns()
    bench.gait.say(0, PausePhase.END)
    both(bench, 0, confirmed=True)
    bench.gait.say(0, PausePhase.HOLD, bench.gait.moved())
    assert np.isfinite(bench.client.latest().elevation).any()
    bench.gait.say(0, PausePhase.HOLD, bench.gait.moved(), stamp=held_up)
    assert is_withdrawn(wait_for_withdrawal(bench)) and is_withdrawn(wait_for_withdrawal(bench, "map"))


def test_a_begin_that_comes_after_the_end_of_its_pause_turns_no_laser_on(bench: Bench) -> None:
    """It was delayed for longer than the pause: no scan is started, and the status says so."""
    # Until the gait's clock is known, a pause lasts from the arrival of its BEGIN.
    assert wait_until(
        lambda: (
            (status := bench.client.status()) is not None
            and any(item.values.get("gait") == "heard" for item in status.items)
        )
    )
    bench.gait.say(0, PausePhase.BEGIN, time_available=4.0, stamp=time.time_ns() - 60 * 10**9)
    assert wait_until(lambda: any("step 0" in item.message for item in bench.status.items()))
    assert not bench.rig.board.view().laser_on and bench.client.counts()["received"] == 0
    bench.gait.say(1, PausePhase.BEGIN)
    assert bench.client.wait_for_step(0, timeout=TIMEOUT).step == 1
