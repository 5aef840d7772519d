"""Two robots that face each other and scan the same floor: pauses, spoilt sweeps, and random times of the next."""

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

# Distance between the robots' footprints [m]: what one scans, the other scans from the far side.
DISTANCE = 1.45
# Brightest level of the other's line, as that of our own on the same floor.
LEVEL = 90.0


@dataclass(frozen=True, slots=True)
class Sweep:
    """A sweep of one robot.

    Attributes:
        start: when it begins [s].
        lit: (n,) mirror angle of each frame [rad], NaN while the laser is dark.
    """

    start: float
    angles: tuple[float, ...]

    def angle_at(self, time: float) -> float:
        """Mirror angle at a time [s], NaN where nothing shines."""
        frame = int(np.floor((time - self.start) * FPS))
        return self.angles[frame] if 0 <= frame < len(self.angles) else np.nan

    @property
    def duration(self) -> float:
        """Time until the last frame [s]."""
        return len(self.angles) / FPS


@dataclass(frozen=True, slots=True)
class PauseOutcome:
    """One pause of one robot.

    Attributes:
        processor: the scan that counts, refused or not.
        sweeps: number of sweeps that it took.
    """

    processor: ScanProcessor
    sweeps: int


class FacingRobots:
    """Two robots of one kind over a world that looks the same from both sides."""

    def __init__(self, world: World, size: tuple[int, int], seed: int = 0) -> None:
        """Render the frames of one of them; the other sees the same."""
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
        """A sweep with a code of its own."""
        code = draw_code(self.scene.order)
        angles: list[float] = [np.nan]
        for index, angle in zip(self.scene.order, self.scene.angles.tolist(), strict=True):
            angles += [angle, np.nan] if index in code else [angle]
        return Sweep(start, tuple(angles))

    def light(self, others: Sequence[Sweep], start: float) -> Fault:
        """The light of the other's sweeps in the pictures of a sweep that begins at `start` [s]."""
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
        """One pause of both, which begin `offset` [s] apart: each sweeps until it is not refused, or gives up."""
        starts, done = [0.0, offset], list[PauseOutcome | None]((None, None))
        sweeps: tuple[list[Sweep], list[Sweep]] = ([self.plan(0.0)], [self.plan(offset)])
        while None in done:
            # The one that ends first: nothing that the other decides later can still shine on it.
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
