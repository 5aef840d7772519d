"""Finds and false alarms of the check of drift: true scans, moved mounts and lost steps in simulation.

`python -m benchmarks calibration drift [--scans N] [--walks N] [--jobs N] [--json]`; about ten
minutes of processor time.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np

from benchmarks.command import options
from benchmarks.mounting import moved, moved_about
from drivers.emulator.config import STEP
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.drift import DRIFTING, HOLDS, UNKNOWN, Drift, DriftWatch
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.simulation.features import Box
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.specimen import rotation, specimen
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import World
from kinematics import RobotModel, load_robot

PAUSES = 3
SPECIMENS = 7
STRIPES = range(0, 70, 2)
UNDULATION_M = 0.002
# Sizes of each drift, of which the last must be found: [degrees], [degrees], [motor steps].
SIZES = {
    "camera": (0.02, 0.05, 0.1, 0.2, 0.5),
    "laser": (0.01, 0.02, 0.05, 0.1, 0.2),
    "steps": (1.0, 2.0, 4.0, 8.0, 16.0),
}
UNITS = {"camera": "degrees", "laser": "degrees", "steps": "steps"}


@dataclass(frozen=True, slots=True)
class Injected:
    """A drift after calibration.

    Attributes:
        camera: turn of the camera about its optical centre (3,) [rad].
        laser: turn of laser and mirror about the mirror's axis point (3,) [rad].
        steps: error of the mirror from some stripe of the first scan on; it is not homed afterwards [motor steps].
    """

    camera: tuple[float, ...] = (0.0, 0.0, 0.0)
    laser: tuple[float, ...] = (0.0, 0.0, 0.0)
    steps: float = 0.0

    @classmethod
    def of(cls, kind: str, size: float, rng: np.random.Generator) -> Injected:
        """A drift of this size in a random direction."""
        if kind == "steps":
            return cls(steps=size * float(rng.choice((-1.0, 1.0))))
        direction = rng.standard_normal(3)
        turn = tuple((np.deg2rad(size) * direction / np.linalg.norm(direction)).tolist())
        return cls(camera=turn) if kind == "camera" else cls(laser=turn)

    def apply(self, calibration: Calibration, robot: RobotModel) -> Calibration:
        """Calibration of the rangefinder after the drift."""
        camera = moved_about(rotation(self.camera), calibration.transform_camera_to_base[:3, 3])
        laser = moved_about(rotation(self.laser), robot.transform_laser_to_base[:3, 3])
        return moved(calibration, camera=camera, laser=laser)


@dataclass(slots=True)
class Tally:
    """Single scans by verdict, and walks of three pauses.

    Attributes:
        scans: number by verdict.
        walks: number in all.
        warned: walks in which the watch warned within three pauses.
        reasons: reasons of all scans judged as drifting, to be printed.
    """

    scans: dict[str, int] = field(default_factory=lambda: dict.fromkeys((HOLDS, DRIFTING, UNKNOWN), 0))
    walks: int = 0
    warned: int = 0
    reasons: list[str] = field(default_factory=list)

    def add(self, walk: Sequence[Drift]) -> None:
        """Count one walk."""
        watch, warned = DriftWatch(), False
        for drift in walk:
            self.scans[drift.verdict] += 1
            if drift.verdict == DRIFTING:
                self.reasons += drift.reasons
            watch.add(drift)
            warned |= watch.verdict == DRIFTING
        self.walks, self.warned = self.walks + 1, self.warned + warned


def world_of(rng: np.random.Generator, *, is_rough: bool) -> World:
    """A flat floor, or ground that undulates by 2 mm, with up to five boxes on it."""
    boxes = tuple(
        Box(
            x=float(rng.uniform(0.55, 1.1)),
            y=float(rng.uniform(-0.22, 0.22)),
            size=(float(rng.uniform(0.05, 0.15)), float(rng.uniform(0.05, 0.15))),
            height=float(rng.uniform(0.01, 0.08)),
            yaw=float(rng.uniform(0, 3)),
            material="wood",
        )
        for _ in range(int(rng.integers(0, 6)))
    )
    undulation = UNDULATION_M if is_rough else 0.0
    return World(features=boxes, undulation=undulation, seed=int(rng.integers(1 << 30)), flat_until=0.55)


def scan(
    robot: RobotModel, rig: SimulatedRangefinder, known: Calibration, pause: WalkPause, offsets: Sequence[float]
) -> Drift:
    """Scan at a pause and check; `known` is the calibration in use, `offsets` are errors of the mirror angle [rad]."""
    rig.set_pose(pause.transform_base_to_world, pause.joint_positions)
    processor = ScanProcessor(known, robot, pause.stance, "coarse")
    off = rig.frame(laser=0.0)
    for index, offset in zip(STRIPES, offsets, strict=True):
        processor.add(index, rig.frame(mirror_angle=known.stripe(index).mirror_angle + offset), off)
    return processor.drift()


@cache
def guara() -> RobotModel:
    """The robot, loaded once in each process."""
    return load_robot("guara")


def walk(seed: int, kind: str = "", size: float = 0.0, *, is_rough: bool = False) -> list[Drift]:
    """The checks of three pauses of a walk with noise in joints, contacts and the direction of gravity.

    A drift of `kind` has been there from the start, in a random direction; steps are lost once, within the first scan.
    """
    robot, rng = guara(), np.random.default_rng(seed)
    known = specimen(robot, seed=seed % SPECIMENS)
    world = world_of(rng, is_rough=is_rough)
    injected = Injected.of(kind, size, np.random.default_rng(seed + 10_000)) if kind else Injected()
    rig = SimulatedRangefinder(world, injected.apply(known, robot), robot, seed)
    lost_from, lost = int(rng.integers(1, len(STRIPES))), injected.steps * STEP
    checks = []
    for number, pause in zip(range(PAUSES), simulate_walk(world, robot, seed=seed), strict=False):
        offsets = [lost if number > 0 or index >= lost_from else 0.0 for index in range(len(STRIPES))]
        checks.append(scan(robot, rig, known, pause, offsets))
    return checks


def tally(pool: Executor, walks: int, first_seed: int, kind: str = "", size: float = 0.0, **options: bool) -> Tally:
    """Many walks, each with a drift of its own direction when there is a kind."""
    result = Tally()
    for checks in pool.map(partial(walk, kind=kind, size=size, **options), range(first_seed, first_seed + walks)):
        result.add(checks)
    return result


def _show(name: str, result: Tally) -> None:
    scans = ", ".join(f"{count} {verdict}" for verdict, count in result.scans.items())
    print(f"{name}: {sum(result.scans.values())} scans, {scans}; {result.warned} of {result.walks} walks warned")
    print("".join(f"    {reason}\n" for reason in result.reasons), end="", flush=True)


def main() -> None:
    """False alarms and finds of the check for drift [--scans N, --walks N, --jobs N, --json]."""
    asked = options(
        __doc__,
        scans=(201, "true scans of a flat floor"),
        walks=(20, "walks of three pauses for each drift that must be found"),
        curve_walks=(5, "walks for each smaller drift"),
        jobs=(1, "processes"),
        json=(False, "one JSON object as the last line"),
    )
    curves: dict[str, list[dict[str, float]]] = {kind: [] for kind in SIZES}
    with ProcessPoolExecutor(asked.jobs) as pool:
        true_walks = -(-asked.scans // PAUSES)
        true = tally(pool, true_walks, 0)
        _show("true, flat floor", true)
        rough = tally(pool, -(-true_walks // 5), 5000, is_rough=True)
        _show("true, rough ground", rough)
        for kind, sizes in SIZES.items():
            for size in sizes:
                walks = asked.walks if size == sizes[-1] else asked.curve_walks
                result = tally(pool, walks, 1000, kind, size)
                by_one = result.scans[DRIFTING] / sum(result.scans.values())
                found = result.warned / result.walks
                curves[kind].append({"level": size, "walks": walks, "found": found, "found_by_one": by_one})
                print(
                    f"{kind} {size:g} {UNITS[kind]}: {walks} walks, found {found:.0%} within {PAUSES} pauses, "
                    f"{by_one:.0%} by one scan",
                    flush=True,
                )
    with_floor = true.scans[HOLDS] + true.scans[DRIFTING]
    alarms = (true.scans[DRIFTING] + rough.scans[DRIFTING]) / max(with_floor + rough.scans[DRIFTING], 1)
    passed = alarms <= 0.01 and all(points[-1]["found"] >= 0.9 for points in curves.values())
    print(f"false alarms {alarms:.1%} of {with_floor} scans with a floor (at most 1 %)")
    print("every limit is met" if passed else "a limit is NOT met")
    if asked.json:
        whole = {"true": true.scans, "rough": rough.scans, "false_alarms": alarms, "curves": curves, "passed": passed}
        print(json.dumps(whole))
    raise SystemExit(0 if passed else 1)
