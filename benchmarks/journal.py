"""Walks resumed after a restart of the node, and detection of robots that were carried in the meantime.

`python -m benchmarks journal killed [--kills 40]`: nodes of their own, killed at random instants of a walk. The gait
continues; after one pause without a confirmed map it stands until there is one. After one kill in four, the newest
journal is truncated, between pauses with maps. The first map after each restart is compared with that of a walk without
restarts, in which every pause was scanned at the time at which the gait began it, so that ground ages equally in both.

`python -m benchmarks journal carried [--cases 50]`: robots with stiff legs that are carried by 20 mm to 1 m, turned by
2 degrees and more, or tilted, while the gait claims that no foot left the ground; and as many that were not moved.
"""

from __future__ import annotations

import random
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks.command import options, run_part
from benchmarks.fused_walk import oracle_of
from benchmarks.peers import free_endpoint, wait_for_map
from benchmarks.usable_ground import UNSAFE, cells
from guara_perception.app.node.claim import Seal
from guara_perception.app.node.journal import Journal
from guara_perception.app.node.simulated import SimulatedGait
from guara_perception.app.node.walk_map import WalkMap
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, specimen
from guara_perception.simulation.gait import WaveGait
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.specimen import rotation
from guara_perception.simulation.walk import WalkPause, fresh_reading, simulate_walk
from guara_perception.simulation.world import World
from kinematics import RobotModel, Stance, load_robot
from kinematics.transforms import translation
from testbed.journalled_node import Walk, start
from testbed.moved_mount import moved_about
from testbed.random_world import random_world
from testbed.scanned_walk import ScannedPause, footprint_to_world, scanned_walk, swept
from testbed.true_ground import TrueGround
from transport import clock, open_node
from transport.stance_link import StancePublisher

# [s] Longest wait of the gait for a map if it may continue without one, and if it must have one.
IMPATIENT_S, PATIENT_S = 2.0, 120.0
# [s] Rest after HOLD, and the swing; longest time from a BEGIN to a kill.
REST_S, SWING_S, KILL_S = 1.5, 1.0, 6.0
# [s] Between two HOLD.
HOLD_S = 0.2
FIRST_KILL = 3
CUT_EVERY = 4


def scan(rangefinder: SimulatedRangefinder, pause: WalkPause, moved: Float | None = None) -> ScannedPause:
    """Scan from a pause, or from its pose (4, 4) multiplied from the left by `moved`."""
    pose = pause.transform_base_to_world if moved is None else moved @ pause.transform_base_to_world
    rangefinder.set_pose(pose, pause.joint_positions)
    robot = rangefinder.robot
    processor = gp.ScanProcessor(rangefinder.calibration, robot, pause.stance, "coarse", step=pause.step)
    processor, wide, _ = swept(processor, rangefinder, Settings.of(robot).pattern("coarse"), None)
    return ScannedPause(pause, wide, processor.ground_picture, rangefinder.world, np.empty((0, 2), np.intp))


def fuse(walk_map: WalkMap, item: ScannedPause, time: float | None = None) -> gp.TerrainGrid:
    """Fuse a scan of the walk "w"; according to the gait, all feet stood since the previous pause.

    The scan ended at `time` of `transport.clock` [s]; None = now.
    """
    pause = item.pause
    fused = walk_map.update(
        pause.step,
        pause.stance,
        item.scan,
        pause.known_ground,
        epoch="w",
        time=clock.now() if time is None else time,
        picture=item.picture,
        standing_pauses=dict.fromkeys(pause.stance.support_feet, 1),
    )
    walk_map.keep()
    return fused


def judged(robot: RobotModel, truth: TrueGround, pause: WalkPause, fused: gp.TerrainGrid) -> Counter[str]:
    """Counts of a map: cells against the oracle, and places for all feet."""
    counts: Counter[str] = Counter()
    to_world = footprint_to_world(pause.transform_base_to_world, fused)
    cells(counts, robot, fused, *oracle_of(robot, truth, fused, to_world))
    gait = WaveGait.of(robot)
    for leg in gait.lift_order:
        counts["footholds"] += plan_foothold(fused, leg, gait.landing(leg), robot=robot) is not None
    return counts


class Gait:
    """Gait and planner that continue while the node is killed at random instants."""

    def __init__(self, walk: Walk, folder: Path, chance: random.Random) -> None:
        """Start router and node."""
        self.walk, self.folder, self.chance = walk, folder, chance
        self.endpoint = free_endpoint()
        self.session = open_node(listen=self.endpoint)
        self.gait = SimulatedGait(StancePublisher(self.session), "guara", seed=walk.seed)
        self.client = gp.TerrainClient(self.endpoint)
        self.kills, self.cut, self.waited, self.missed = 0, 0, 0.0, 0
        # Time of each BEGIN by `transport.clock` [s].
        self.begun: list[float] = []
        walk.save(folder / "walk.pickle")
        self._start()

    def _start(self) -> None:
        self.node = start(self.endpoint, self.folder / "state", self.folder / "walk.pickle", self.folder / "log.txt")

    def close(self) -> None:
        """End all."""
        self.node.kill()
        self.node.wait()
        self.client.close()
        self.session.close()

    def kill(self, is_cut: bool) -> None:
        """End the node without notice, perhaps cut its newest journal, and start it again."""
        self.node.kill()
        self.node.wait()
        files = sorted((self.folder / "state").glob("guara-*.journal"), key=lambda path: path.stat().st_mtime)
        if is_cut and len(files) > 1:
            content = files[-1].read_bytes()
            files[-1].write_bytes(content[: self.chance.randrange(len(content))])
            self.cut += 1
        self._start()

    def maps_after_kills(self, most: int) -> Iterator[tuple[WalkPause, gp.TerrainGrid]]:
        """Walk; yields the first map after each restart with its pause."""
        killer: threading.Timer | None = None
        run, must_wait, is_cut, in_a_row = None, True, False, 0
        for pause in self.walk.pauses:
            if killer is None and pause.step >= FIRST_KILL and self.kills < most:
                self.kills += 1
                # A truncated journal counts as a missed pause; the pauses around it are not missed as well.
                is_cut = self.kills >= CUT_EVERY * (self.cut + 1) and in_a_row > 1
                killer = threading.Timer(self.chance.uniform(0.0, KILL_S), self.kill, (is_cut,))
                killer.start()
            self.gait.begin(pause)
            self.begun.append(clock.now())
            patience = PATIENT_S if must_wait or is_cut or self.chance.random() < 0.5 else IMPATIENT_S
            begun = time.monotonic()
            fused = self.map_of(pause, patience)
            must_wait, in_a_row = fused is None, 0 if fused is None else in_a_row + 1
            self.missed += fused is None
            if fused is not None:
                self.waited = max(self.waited, time.monotonic() - begun)
                if run not in (None, fused.metadata["run"]):
                    killer, is_cut = None, False
                    yield pause, fused
                run = fused.metadata["run"]
                time.sleep(REST_S)
            self.gait.end(pause)
            time.sleep(SWING_S)

    def map_of(self, pause: WalkPause, patience: float) -> gp.TerrainGrid | None:
        """Stand until the map of a pause is confirmed; None if none was in time [s]."""

        def hold() -> None:
            self.gait.hold(pause)
            time.sleep(HOLD_S)

        return wait_for_map(self.client, pause.step, patience, hold, confirmed_only=True)


def killed() -> None:
    """Nodes killed at random instants of walks whose gait runs on."""
    asked = options(__doc__, kills=(40, "how many"), cycles=(10, "cycles of each walk"), first=(0, "first world"))
    robot, chance = load_robot("guara"), random.Random(0)
    total, without, kills, cut, resumed, maps = Counter[str](), Counter[str](), 0, 0, 0, 0
    seed = asked.first
    while kills < asked.kills:
        world, items = scanned_walk(robot, seed, cycles=asked.cycles)
        truth, left = TrueGround.of(world), deque(items)
        whole = WalkMap(robot, specimen(robot, (640, 512), seed))
        with tempfile.TemporaryDirectory() as place:
            gait = Gait(Walk(world, seed, tuple(item.pause for item in items)), Path(place), chance)
            try:
                for pause, fused in gait.maps_after_kills(asked.kills - kills):
                    while left and left[0].pause.step <= pause.step:
                        item = left.popleft()
                        one = fuse(whole, item, gait.begun[item.pause.step])
                    now, then = (judged(robot, truth, pause, each) for each in (fused, one))
                    total, without, maps = total + now, without + then, maps + 1
                    unsafe = [now[name] - then[name] for name in UNSAFE]
                    print(
                        f"world {seed} step {pause.step}: {now['footholds']} of {then['footholds']} footholds, free "
                        f"and safe {now['free and safe']} of {then['free and safe']}, more unsafe {unsafe} "
                        f"{fused.metadata['restarts']}",
                        flush=True,
                    )
                    resumed += not fused.metadata["restarts"]
            finally:
                gait.close()
            kills, cut = kills + gait.kills, cut + gait.cut
        print(f"world {seed}: the gait waited {gait.waited:.1f} s at most, {gait.missed} pauses had no map")
        seed += 1
    share = 100 * total["footholds"] / max(without["footholds"], 1)
    print(f"kills {kills}, journals cut {cut}; maps after restarts {maps}, walks that went on {resumed}")
    print(f"footholds {total['footholds']} of {without['footholds']} without restarts: {share:.1f} %")
    for name in ("free and safe", *UNSAFE):
        print(f"  {name}: {total[name]}, without restarts {without[name]}")
    more = sum(max(total[name] - without[name], 0) for name in UNSAFE)
    sys.exit(0 if share >= 95.0 and not more else 1)


def carried_by(number: int, chance: np.random.Generator, pause: WalkPause) -> tuple[str, Float]:
    """Description of the disturbance in case `number`, and its motion (4, 4) in the world."""
    kind = ("carried", "turned", "tilted")[number % 3]
    about = pause.transform_footprint_to_world[:3, 3]
    if kind == "carried":
        distance, heading = 0.02 * 50.0 ** (number % 18 / 17), chance.uniform(-np.pi, np.pi)
        shift = distance * np.array([np.cos(heading), np.sin(heading), 0.0])
        return f"carried by {1e3 * distance:.0f} mm", translation(shift)
    angle = np.radians(2.0 * (60.0 if kind == "turned" else 5.0) ** (number % 17 / 16)) * chance.choice((-1.0, 1.0))
    axis = np.array([0.0, 0.0, 1.0])
    if kind == "tilted":
        heading = chance.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    return f"{kind} by {np.degrees(abs(angle)):.1f} degrees", moved_about(rotation(-angle * axis), about)


def carried() -> None:
    """Robots that were carried between two pauses, and robots that were not."""
    asked = options(__doc__, cases=(50, "of each"), before=(6, "pauses before"))
    robot, chance = load_robot("guara"), np.random.default_rng(0)
    handed_out, refused, reasons = 0, 0, Counter[str]()
    went_on = 0
    for number in range(asked.cases):
        # Level ground with texture is the hardest: no height shows a motion.
        world = World(seed=number) if number % 2 else random_world(number)
        calibration = specimen(robot, (640, 512), number)
        rangefinder = SimulatedRangefinder(world, calibration, robot, number)
        with tempfile.TemporaryDirectory() as place:
            seal = Seal.of("guara", robot, calibration)
            with Journal(Path(place), robot, seal) as journal:
                walk_map = WalkMap(robot, calibration, journal)
                for pause in simulate_walk(world, robot, cycles=asked.before / 4, seed=number):
                    fuse(walk_map, scan(rangefinder, pause))
                journal.write(walk_map.claim(clock.now()))
                journal.confirm()
            what, motion = carried_by(number, chance, pause)
            for moved in (None, motion):
                stance = fresh_reading(pause.stance, chance)
                gravity = np.array(pause.stance.gravity_in_base) + chance.normal(0.0, robot.noise.imu_sigma, 3)
                if moved is not None:
                    base = pause.transform_base_to_world[:3, :3]
                    gravity = (moved[:3, :3] @ base).T @ base @ gravity
                stance = Stance(stance.joint_positions, stance.support_feet, tuple(gravity.tolist()))
                scanned = scan(rangefinder, replace(pause, step=pause.step + 1, stance=stance), moved)
                with Journal(Path(place), robot, seal) as journal:
                    fused = fuse(WalkMap(robot, calibration, journal), scanned)
                    item = journal.item()
                fresh = fuse(WalkMap(robot, calibration), scanned)
                is_new = all(np.array_equal(fused.layer(n), fresh.layer(n), equal_nan=True) for n in fresh.layers)
                if moved is None:
                    went_on += item.values["resumed"] == "1" and not is_new
                    still = item.message
                    # A refused journal is gone: it is written again for the robot that is carried.
                    with Journal(Path(place), robot, seal) as journal:
                        journal.write(walk_map.claim(clock.now()))
                        journal.confirm()
                else:
                    handed_out += not is_new
                    refused += is_new and item.values["refused"] == "1"
            reasons[item.message.removeprefix("a new walk begins: ").split(":")[0]] += 1
            print(f"case {number}: {what}: {item.message}; left alone: {still}", flush=True)
    print(f"carried: {refused} of {asked.cases} began a new walk, ground of before handed out in {handed_out}")
    print(f"left alone: {went_on} of {asked.cases} went on")
    for reason, count in reasons.most_common():
        print(f"  {count:3d} {reason}")
    sys.exit(0 if refused == asked.cases and not handed_out and went_on == asked.cases else 1)


def main() -> None:
    """Command line."""
    run_part("journal", {"killed": killed, "carried": carried})


if __name__ == "__main__":
    main()
