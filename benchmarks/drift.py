"""Prints how far the map drifts sideways over the ground, with and without laying each scan onto it, walk by walk.

Three kinds of walks: over mixed analytic ground, over level ground, which shows no sideways motion, and through
simulated frames. Drift is measured on ground seen at the near edge of the area, when the hind feet come to it.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks.scanned_walk import scanned_walk
from benchmarks.terrain import FIRST_HIND_PAUSE, FOOT_HALF
from guara_perception.arrays import Float
from kinematics import LegOdometry, RobotModel, Stance, load_robot
from testbed.analytic_walk import Ground, LevelGround, scan, walk

# From the near edge of the scanned area to the hind feet.
PAUSES_BETWEEN = 21
SEEN_AT_M = ((0.50, -0.18), (0.50, 0.18))


@dataclass(frozen=True)
class WalkedPause:
    """One pause of a walk.

    Attributes:
        stance: stance as the robot reports it.
        scan: grid of the scan taken there.
        to_world: (4, 4), where the scan's footprint truly was.
        known_ground: what the gait declared.
        feet: (n, 3) points in base_footprint under the hind feet's next footholds, at the true height of the ground.
    """

    stance: Stance
    scan: gp.TerrainGrid
    to_world: Float
    known_ground: tuple[gp.KnownGround, ...]
    feet: Float


@dataclass(frozen=True)
class MapErrors:
    """The result of a walk, in millimetres: sideways rms, the worst, height rms under hind feet, scans not used."""

    x: float
    y: float
    worst: float
    feet: float
    refused: int

    @property
    def sideways(self) -> float:
        """Mean of x and y."""
        return (self.x + self.y) / 2


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=20, help="first seed; the settings were chosen on 0 to 9")
    parser.add_argument("--walks", type=int, default=10, help="over mixed analytic ground")
    parser.add_argument("--flat", type=int, default=3, help="over level ground")
    parser.add_argument("--frames", type=int, default=0, help="through simulated frames; slow where no file is kept")
    parser.add_argument("--cycles", type=int, default=10)
    parser.add_argument("--kept", type=Path, help="folder that keeps the scans from run to run")
    arguments = parser.parse_args()
    robot = load_robot("guara")
    seeds = range(arguments.first, arguments.first + max(arguments.walks, arguments.flat))
    for name, walks in (
        ("mixed ground", [(s, analytic(robot, s, arguments.cycles, arguments.kept)) for s in seeds[: arguments.walks]]),
        (
            "level ground",
            [(s, analytic(robot, s, arguments.cycles, arguments.kept, level=True)) for s in seeds[: arguments.flat]],
        ),
        ("frames", [(s, frames(robot, s, arguments.cycles, arguments.kept)) for s in range(arguments.frames)]),
    ):
        if walks:
            compare(name, ((seed, errors_of(robot, list(pauses))) for seed, pauses in walks))


def compare(name: str, walks: Iterable[tuple[int, tuple[MapErrors, MapErrors]]]) -> None:
    """Print walks without and with registration, each as soon as it is done."""
    pairs = []
    print(f"{name}: sideways drift over {PAUSES_BETWEEN} pauses, x and y rms; height rms under hind feet [mm]")
    for seed, (off, on) in walks:
        print(
            f"  walk {seed:3d}  {off.x:5.2f} {off.y:5.2f} -> {on.x:5.2f} {on.y:5.2f}  worst {off.worst:5.1f} ->"
            f" {on.worst:5.1f}  feet {off.feet:5.2f} -> {on.feet:5.2f}  {on.refused:2d} scans not used",
            flush=True,
        )
        pairs.append((off, on))
    off, on = (rms([pair[i] for pair in pairs]) for i in (0, 1))
    worse = max(on.sideways - off.sideways for off, on in pairs), max(on.feet - off.feet for off, on in pairs)
    print(
        f"  all: sideways {off.sideways:.2f} -> {on.sideways:.2f} mm, feet {off.feet:.2f} -> {on.feet:.2f} mm; "
        f"the walks that gained least: sideways {worse[0]:+.2f} mm, feet {worse[1]:+.2f} mm"
    )


def rms(walks: list[MapErrors]) -> MapErrors:
    """Of several walks: rms of x and y, the worst of all, the mean of the feet's rms, the sum of scans not used."""
    return MapErrors(
        x=float(np.sqrt(np.mean([each.x**2 for each in walks]))),
        y=float(np.sqrt(np.mean([each.y**2 for each in walks]))),
        worst=max(each.worst for each in walks),
        feet=float(np.mean([each.feet for each in walks])),
        refused=sum(each.refused for each in walks),
    )


def errors_of(robot: RobotModel, pauses: list[WalkedPause]) -> tuple[MapErrors, MapErrors]:
    """Errors of a walk without and with registration."""
    return _walk_errors(robot, pauses, registered=False), _walk_errors(robot, pauses, registered=True)


def _walk_errors(robot: RobotModel, pauses: list[WalkedPause], *, registered: bool) -> MapErrors:
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    poses: list[Float] = []
    errors: list[Float] = []
    refused = 0
    for pause in pauses:
        pose = odometry.update(pause.stance)
        fused = terrain_map.update(
            pause.scan,
            pose.transform_footprint_to_odom,
            pose.covariance,
            known_ground=pause.known_ground,
            covariance_since_last=pose.covariance_since_last if registered else None,
            own_covariance=pose.own_covariance if registered else None,
        )
        refused += registered and fused.metadata["registration_refused"] is not None
        poses.append(np.array(fused.metadata["transform_footprint_to_odom"]))
        if pause.scan.step >= FIRST_HIND_PAUSE and len(pause.feet):
            error = np.asarray(fused.height_at(pause.feet[:, 0], pause.feet[:, 1]), np.float64) - pause.feet[:, 2]
            errors.append(error[np.isfinite(error)])
    aside = []
    for before, now in zip(range(len(pauses) - PAUSES_BETWEEN), range(PAUSES_BETWEEN, len(pauses)), strict=True):
        found = np.linalg.inv(poses[now]) @ poses[before]
        true = np.linalg.inv(pauses[now].to_world) @ pauses[before].to_world
        aside += [((found - true) @ (*point, 0.0, 1.0))[:2] for point in SEEN_AT_M]
    sideways = 1e3 * np.array(aside)
    x, y = np.sqrt(np.mean(sideways**2, axis=0))
    heights = 1e3 * np.concatenate(errors)
    return MapErrors(float(x), float(y), float(np.abs(sideways).max()), float(np.sqrt(np.mean(heights**2))), refused)


def analytic(
    robot: RobotModel, seed: int, cycles: int, kept: Path | None = None, *, level: bool = False
) -> Iterator[WalkedPause]:
    """A walk over analytic ground: joint and contact noise, no frames."""
    ground = Ground.random(seed)
    if level:
        ground = LevelGround(ground.boxes[:0], ground.dark[:0], ground.phases)
    file = None if kept is None else kept / f"{'level' if level else 'mixed'}-wide-{seed}-{cycles}.pickle"
    if file is not None and file.is_file():
        items = pickle.loads(file.read_bytes())
    else:
        items = [(pause, scan(robot, ground, pause, seed)) for pause in walk(robot, ground, cycles, seed)]
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(pickle.dumps(items))
    for pause, terrain in items:
        to_footprint = np.array(terrain.metadata["transform_base_to_footprint"])
        to_world = pause.transform_base_to_world @ np.linalg.inv(to_footprint)
        under = np.concatenate([_sole(pause.next_footholds[leg][:2]) for leg in ("lh", "rh")])
        height = ground.height_at(under[:, 0], under[:, 1])
        yield WalkedPause(pause.stance, terrain, to_world, (), _in_footprint(to_world, under, height))


def frames(robot: RobotModel, seed: int, cycles: int, kept: Path | None) -> Iterator[WalkedPause]:
    """A walk through simulated frames."""
    world, pauses = scanned_walk(robot, seed, cycles=cycles, kept=kept)
    for item in pauses:
        to_footprint = np.array(item.scan.metadata["transform_base_to_footprint"])
        to_world = item.pause.transform_base_to_world @ np.linalg.inv(to_footprint)
        under = np.empty((0, 2))
        if item.pause.nominal[0] < 0:
            under = _sole(np.array(item.pause.to_world(*item.pause.nominal)))
        height = world.height(under[:, 0], under[:, 1])
        yield WalkedPause(
            item.pause.stance, item.scan, to_world, item.pause.known_ground, _in_footprint(to_world, under, height)
        )


def _sole(centre: Float) -> Float:
    """Points (n, 2) under a sole."""
    dx, dy = (a.ravel() for a in np.meshgrid(*(np.linspace(-half, half, 8) for half in FOOT_HALF)))
    return np.asarray(centre + np.column_stack((dx, dy)))


def _in_footprint(to_world: Float, points_xy: Float, height: Float) -> Float:
    points = np.column_stack((points_xy, height))
    return np.asarray((points - to_world[:3, 3]) @ to_world[:3, :3])


if __name__ == "__main__":
    main()
