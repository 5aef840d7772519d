"""Two robots that face each other and scan the same floor; refused sweeps are repeated after random delays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers import draw_code
from guara_perception.app.node.sweep import MOST_SWEEPS, retry_delay
from guara_perception.arrays import Float32
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.simulation import Light, SimulatedRangefinder, World, specimen
from guara_perception.simulation.rangefinder import LaserPlanes
from kinematics import load_robot
from kinematics.transforms import inverse
from testbed.scenes import ScanInMemory, scan_stance, simulated
from testbed.strange_light import FPS, Fault, Instant, Scene, take

# Distance between the robots' footprints [m], at which they scan the same area from opposite sides.
DISTANCE = 1.45
# Peak level of the other robot's line, equal to that of the own line on the same floor [grey levels].
LEVEL = 90.0


@dataclass(frozen=True, slots=True)
class Sweep:
    """Sweep of one robot.

    Attributes:
        start: start time [s].
        angles: mirror angle of each frame [rad], NaN if the laser is off.
    """

    start: float
    angles: tuple[float, ...]

    def angle_at(self, time: float) -> float:
        """Mirror angle at a time [s]; NaN if the laser is off."""
        frame = int(np.floor((time - self.start) * FPS))
        return self.angles[frame] if 0 <= frame < len(self.angles) else np.nan

    @property
    def duration(self) -> float:
        """Duration of the sweep [s]."""
        return len(self.angles) / FPS


@dataclass(frozen=True, slots=True)
class PauseOutcome:
    """Result of a pause of one robot.

    Attributes:
        processor: last scan, refused or not.
        sweeps: number of sweeps.
    """

    processor: ScanProcessor
    sweeps: int


class FacingRobots:
    """Two identical robots over a world that looks the same from both sides."""

    def __init__(self, world: World, size: tuple[int, int], seed: int = 0) -> None:
        """Render the frames of one robot; those of the other are the same."""
        scan: ScanInMemory = simulated(size, 70, light=Light(), seed=seed, is_uncertain=False, world=world)
        self.scene = Scene(scan)
        robot = load_robot("guara")
        rangefinder = SimulatedRangefinder(world, specimen(robot, size), robot, seed)
        stance = scan_stance(robot)
        pose = robot.stance_pose(stance).transform_base_to_footprint
        self._points = rangefinder.set_pose(pose, robot.posture("scan"))
        turned = np.diag([-1.0, -1.0, 1.0, 1.0])
        turned[0, 3] = DISTANCE
        self._planes = LaserPlanes.of(scan.calibration)
        self._footprint_to_other = inverse(turned @ pose)
        self._sigma = rangefinder.light.stripe_sigma

    def plan(self, start: float) -> Sweep:
        """Plan a sweep with a new random code."""
        code = draw_code(self.scene.order)
        angles: list[float] = [np.nan]
        for index, angle in zip(self.scene.order, self.scene.angles.tolist(), strict=True):
            angles += [angle, np.nan] if index in code else [angle]
        return Sweep(start, tuple(angles))

    def light(self, others: Sequence[Sweep], start: float) -> Fault:
        """Light of the other robot's sweeps in the images of a sweep that begins at `start` [s]."""
        view = self._points
        points = (view.points + view.origin).reshape(-1, 3)

        def shine(scene: Scene, at: Instant) -> Float32:
            level = np.zeros_like(scene.dark)
            angle = next((a for other in others if not np.isnan(a := other.angle_at(start + at.time))), np.nan)
            if np.isnan(angle):
                return level
            plane = self._planes.plane_at(angle) @ self._footprint_to_other
            distance = points @ plane[:3].astype(np.float32) + np.float32(plane[3])
            shape = scene.dark.shape[:2]
            level[:, :, 2] = (LEVEL * np.exp(-0.5 * (distance / self._sigma) ** 2)).reshape(shape)
            return level

        return Fault("other robot", extra=shine)

    def pause(self, offset: float) -> tuple[PauseOutcome, PauseOutcome]:
        """Simulate a pause of both robots, which begin `offset` [s] apart.

        Each robot repeats its sweep while it is refused, up to MOST_SWEEPS times.
        """
        starts, done = [0.0, offset], list[PauseOutcome | None]((None, None))
        sweeps: tuple[list[Sweep], list[Sweep]] = ([self.plan(0.0)], [self.plan(offset)])
        while None in done:
            # Process the earlier sweep first: later decisions of the other robot cannot affect it.
            which = min((i for i in (0, 1) if done[i] is None), key=lambda i: starts[i])
            own = sweeps[which][-1]
            processor, _ = take(self.scene, self.light(sweeps[1 - which], own.start), triggered=False)
            if processor.refused and len(sweeps[which]) < MOST_SWEEPS:
                starts[which] = own.start + own.duration + retry_delay(own.duration)
                sweeps[which].append(self.plan(starts[which]))
            else:
                done[which] = PauseOutcome(processor, len(sweeps[which]))
        first, second = done
        assert first is not None and second is not None
        return first, second
