"""Simulated robot with a running node: adaptive scans, and the walk of `guara run --simulated`."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.demo.check import true_elevation
from guara_perception.app.files.open_scan import open_scan
from guara_perception.app.messages import message_to_terrain
from guara_perception.app.node import simulated_gaits
from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.node.simulated import SimulatedGait, SimulatedRobot
from guara_perception.app.node.simulated_gaits import walk_until_stopped
from guara_perception.app.record.simulated import SimulatedWorkshop
from guara_perception.settings import Settings
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from testbed.altered_robot import altered_guara
from transport import Session, open_client, open_node
from transport.messages.codec import read_time
from transport.recording import open_recording
from transport.server import PerceptionServer
from transport.stance_link import StancePublisher, StanceReceiver

pytestmark = pytest.mark.slow

TIMEOUT = 180.0
# A quarter of the usual pixels; the tests do not depend on them.
SIZE = (320, 256)
FLAT = """
x = [-1.0, 3.0]
y = [-0.8, 0.8]
"""


@contextmanager
def walking(
    robot: SimulatedRobot, endpoint: str, recorder: ScanRecorder | None = None
) -> Iterator[tuple[PerceptionNode, SimulatedGait, gp.TerrainClient, Session]]:
    with robot.rangefinder, open_node(listen=endpoint) as session:
        server = PerceptionServer(session)
        scanner = PauseScanner(robot.robot, robot.calibration, robot.rangefinder, server, recorder=recorder)
        node = PerceptionNode(scanner, "adaptive")
        with node:
            StanceReceiver(session, on_pause=node.on_pause, on_refused=node.on_refused)
            with open_client(endpoint) as client_session, gp.TerrainClient(endpoint) as client:
                yield node, SimulatedGait(StancePublisher(client_session), "guara"), client, session


@pytest.mark.parametrize("make", [SimulatedRobot, SimulatedWorkshop])
def test_the_simulated_board_reaches_every_angle_of_the_robot(
    make: type[SimulatedRobot] | type[SimulatedWorkshop], tmp_path: Path
) -> None:
    """Also for a robot whose mirror is so far ahead that the default travel of the emulated board is too short."""
    folder = altered_guara(tmp_path, ("mirror_angle_first = -0.110", "mirror_angle_first = -0.310"))
    made = make(folder, size=SIZE)
    with made.rangefinder as rangefinder:
        for angle in Settings.of(made.robot).mirror_angles:
            step = rangefinder.board.step_at(angle)
            assert rangefinder.board.identity.angle_of(step) == pytest.approx(angle, abs=1e-4)


def test_clear_ground_is_scanned_coarsely(free_endpoint: str, tmp_path: Path) -> None:
    """Without an obstacle, 35 stripes are enough."""
    world = tmp_path / "flat.toml"
    world.write_text(FLAT)
    robot = SimulatedRobot(world=world, size=SIZE, fps=120.0)
    with walking(robot, free_endpoint) as (_, gait, client, _):
        gait.begin(next(robot.walk(cycles=0)))
        terrain = client.wait_for_step(0, timeout=TIMEOUT)
    assert (terrain.metadata["mode"], terrain.metadata["stripes_used"]) == ("coarse", 35)
    assert np.isfinite(terrain.elevation).mean() > 0.97


def test_an_obstacle_brings_the_stripes_between_within_the_pause(free_endpoint: str, tmp_path: Path) -> None:
    """The dark patch of the demo: a coarse grid, then 70 stripes with the true heights, all recorded."""
    robot = SimulatedRobot(size=SIZE, fps=120.0)
    path = tmp_path / "walk.mcap"
    recorder = ScanRecorder(path, robot="guara", calibration=robot.calibration)
    pause = next(robot.walk(cycles=0))
    with recorder, walking(robot, free_endpoint, recorder) as (node, gait, client, _):
        gait.begin(pause)
        assert node.wait_for_step(0, TIMEOUT)
        client.wait_for_step(0, timeout=TIMEOUT, extent="map")
        terrain = client.wait_for_step(0, timeout=TIMEOUT, refined_only=True)
    assert (terrain.metadata["mode"], terrain.metadata["stripes_used"]) == ("standard", 70)
    error = np.abs(terrain.elevation - true_elevation(robot.world, pause, terrain))
    assert np.nanmedian(error) < 0.003
    assert not np.any((terrain.traversability > 0) & ((terrain.hazard & UNKNOWN_MASK) != 0))
    again = gp.process_scan(open_scan(path), robot.calibration, robot.robot, pictures=False)
    np.testing.assert_array_equal(again.hazard, terrain.hazard)
    with open_recording(path) as recording:
        first, second = recording.terrains("footprint")
        times = [read_time(stripe.header.stamp) for stripe in recording.messages("scan/stripe")]
    # The planner received the coarse grid first, which announces a refinement.
    assert (first.mode, second.mode) == ("coarse", "standard") and first.provisional and second.provisional
    coarse, fine = message_to_terrain(first).metadata, message_to_terrain(second).metadata
    assert coarse["refinement_follows"] and not fine["refinement_follows"]
    # The coarse stripes are recorded twice, and times within a topic do not decrease.
    assert len(times) == 35 + 70 and times == sorted(times)


def test_the_simulated_walk_goes_on_until_it_is_stopped(free_endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each walk has its own epoch, its pauses in order, and a new map."""
    monkeypatch.setattr("guara_perception.app.node.simulated_gaits.REST_S", 0.0)
    monkeypatch.setattr("guara_perception.app.node.simulated_gaits.CYCLES", 0.5)
    robot = SimulatedRobot(size=SIZE, fps=120.0)
    stop = threading.Event()
    seen: list[tuple[str, int]] = []
    told: list[str] = []
    with walking(robot, free_endpoint) as (node, _, client, session):
        arguments = (robot, node, session, "guara", stop, told.append)
        walk = threading.Thread(target=walk_until_stopped, args=arguments, daemon=True)
        walk.start()
        for terrain in client.stream(TIMEOUT, "map"):
            pause = (terrain.metadata["epoch"], terrain.step)
            if pause not in seen:
                seen.append(pause)
            if len({epoch for epoch, _ in seen}) == 3:
                break
        stop.set()
        walk.join(TIMEOUT)
    assert not walk.is_alive()
    assert [step for _, step in seen] == [0, 1, 2, 0, 1, 2, 0]
    assert told == ["the simulated walk is over; the robot returns to the start for another walk"] * 2


def test_a_walk_that_finds_no_foothold_is_followed_by_another(
    free_endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The planner finds no foothold once: the reason is reported, and the next walk begins."""
    monkeypatch.setattr("guara_perception.app.node.simulated_gaits.REST_S", 0.0)
    refusals = iter([None])
    planned = simulated_gaits.plan_swing
    monkeypatch.setattr(simulated_gaits, "plan_swing", lambda *a, **k: next(refusals, 1) and planned(*a, **k))
    robot = SimulatedRobot(size=SIZE, fps=120.0)
    stop, told = threading.Event(), list[str]()
    with walking(robot, free_endpoint) as (node, _, client, session):
        arguments = (robot, node, session, "guara", stop, told.append)
        walk = threading.Thread(target=walk_until_stopped, args=arguments, daemon=True)
        walk.start()
        assert client.wait_for_step(1, timeout=TIMEOUT).step == 1
        stop.set()
        walk.join(TIMEOUT)
    assert not walk.is_alive() and len(told) == 1
    assert "ended early: step 0: the planner found no safe foothold" in told[0]


def test_a_scan_that_is_asked_for_ends_before_the_robot_goes_on(
    free_endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scan is completed although it takes longer than the robot rests."""
    monkeypatch.setattr("guara_perception.app.node.simulated_gaits.REST_S", 0.2)
    robot = SimulatedRobot(size=SIZE, fps=120.0)
    stop = threading.Event()
    with walking(robot, free_endpoint) as (node, _, client, session):
        walk = threading.Thread(target=walk_until_stopped, args=(robot, node, session, "guara", stop), daemon=True)
        walk.start()
        first = client.wait_for_step(0, timeout=TIMEOUT)
        asked = client.request_scan(mode="standard", timeout=TIMEOUT)
        stop.set()
        walk.join(TIMEOUT)
    assert asked.metadata["mode"] == "standard" and asked.stamp > first.stamp
