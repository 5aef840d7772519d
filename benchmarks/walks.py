"""Maps of walks compared with the true ground: drift, heights under the feet; cost of maps; refinement of coarse scans.

`python -m benchmarks walks PART ...`; without a part: a list of them.

The part `drift` walks over mixed analytic ground, over level ground, which shows no sideways motion, and through
simulated frames, each without and with registration of its scans. Drift is measured on ground seen at the near edge of
the area, when the hind feet come to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks import map_cost, moving_ground, pictures, scan_modes, sigmas, soft_ground
from benchmarks.command import options, run_part
from benchmarks.fused_walk import PAUSES_BETWEEN, drift_aside, fused_pauses
from guara_perception.arrays import Float
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from kinematics import RobotModel, load_robot
from testbed.analytic_walk import Ground, seen_height
from testbed.scanned_walk import WalkedPause, analytic_pauses, framed_pauses

# A hind foot reaches ground that was scanned before the walk began only after this number of pauses.
FIRST_HIND_PAUSE = 24
# Pauses after which cells hidden in a scan are counted in the map.
HIDDEN_AFTER = (0, 4, 8, 12)


@dataclass(frozen=True)
class WalkFigures:
    """Figures of a walk.

    Attributes:
        x, y, worst: drift aside: rms by axis, and the largest [mm].
        feet, bias, claimed: height under the hind feet's next footholds: rms, mean, rms of the map's own sigma [mm].
        refused: scans that were not registered.
        hidden: share of a scan's area that is hidden in the map HIDDEN_AFTER pauses after it.
        unknown, dark: cells called traversable that are unknown, and that return no light.
    """

    x: float
    y: float
    worst: float
    feet: float
    bias: float
    claimed: float
    refused: int
    hidden: tuple[float, ...]
    unknown: int
    dark: int

    @property
    def sideways(self) -> float:
        """Mean of x and y."""
        return (self.x + self.y) / 2


def drift() -> None:
    """Drift of the map and heights under the hind feet [--first, --walks, --flat, --frames, --cycles, --kept]."""
    arguments = options(
        __doc__,
        first=(20, "first seed; the settings were chosen on 0 to 9"),
        walks=(10, "over mixed analytic ground"),
        flat=(3, "over level ground"),
        frames=(0, "through simulated frames; slow where no file is kept"),
        cycles=(10, "cycles of each walk"),
        kept=(Path, "folder that keeps the scans of frames from run to run"),
    )
    robot, cycles, kept = load_robot("guara"), arguments.cycles, arguments.kept
    kinds: tuple[tuple[str, int, int, Callable[[int], Iterator[WalkedPause]]], ...] = (
        ("mixed ground", arguments.first, arguments.walks, lambda seed: analytic_pauses(robot, seed, cycles)),
        (
            "level ground",
            arguments.first,
            arguments.flat,
            lambda seed: analytic_pauses(robot, seed, cycles, level=True),
        ),
        ("frames", 0, arguments.frames, lambda seed: framed_pauses(robot, seed, cycles, kept)),
    )
    for name, first, count, pauses_of in kinds:
        if count:
            compare(name, robot, {seed: list(pauses_of(seed)) for seed in range(first, first + count)})


def compare(name: str, robot: RobotModel, walks: dict[int, list[WalkedPause]]) -> None:
    """Print walks without and with registration, each as soon as it is done."""
    pairs = []
    print(f"{name}: sideways drift over {PAUSES_BETWEEN} pauses, x and y rms; height rms under hind feet [mm]")
    for seed, pauses in walks.items():
        off, on = (walk_figures(robot, pauses, registered=registered) for registered in (False, True))
        pairs.append((off, on))
        hidden = " ".join(f"{100 * share:.2f}" for share in on.hidden)
        print(
            f"  walk {seed:3d}  {off.x:5.2f} {off.y:5.2f} -> {on.x:5.2f} {on.y:5.2f}  worst {off.worst:5.1f} ->"
            f" {on.worst:5.1f}  feet {off.feet:5.2f} -> {on.feet:5.2f}, bias {on.bias:+.2f}, claimed {on.claimed:.2f}"
            f"  {on.refused:2d} scans not used  hidden after {HIDDEN_AFTER} pauses {hidden} %"
            f"  unknown free {on.unknown}  dark free {on.dark}",
            flush=True,
        )
    off_all, on_all = ([pair[i] for pair in pairs] for i in (0, 1))
    worse = [max(getattr(on, what) - getattr(off, what) for off, on in pairs) for what in ("sideways", "feet")]
    print(
        f"  all: sideways {_rms_aside(off_all):.2f} -> {_rms_aside(on_all):.2f} mm, feet, mean "
        f"{np.mean([each.feet for each in off_all]):.2f} -> {np.mean([each.feet for each in on_all]):.2f}, median "
        f"{np.median([each.feet for each in on_all]):.2f} mm; the walks that gained least: sideways "
        f"{worse[0]:+.2f} mm, feet {worse[1]:+.2f} mm"
    )


def _rms_aside(walks: list[WalkFigures]) -> float:
    return float(np.mean([np.sqrt(np.mean([getattr(each, axis) ** 2 for each in walks])) for axis in "xy"]))


def walk_figures(robot: RobotModel, pauses: list[WalkedPause], *, registered: bool) -> WalkFigures:
    """Figures of a walk without or with registration."""
    poses: list[Float] = []
    errors: list[Float] = []
    sigmas: list[Float] = []
    hidden: list[tuple[Float, list[float]]] = []
    refused = unknown = dark = 0
    for pause, fused in fused_pauses(gp.TerrainMap(robot), robot, pauses, registered=registered):
        refused += registered and fused.metadata["registration_refused"] is not None
        poses.append(np.array(fused.metadata["transform_footprint_to_odom"]))
        unknown += int((((fused.hazard & UNKNOWN_MASK) != 0) & (fused.traversability > 0)).sum())
        if pause.ground is not None:
            dark += free_in_the_dark(pause.ground, fused, pause.to_world)
        if pause.scan.step >= FIRST_HIND_PAUSE and len(pause.feet):
            x, y, true = pause.feet.T
            error = np.asarray(fused.height_at(x, y), np.float64) - true
            known = np.isfinite(error)
            iy, ix = fused.geometry.indices(x[known], y[known])
            errors.append(error[known])
            sigmas.append(np.sqrt(fused.variance[iy, ix].astype(np.float64)))
        follow_hidden(hidden, pause.scan, fused, poses[-1])
    sideways = drift_aside(pauses, poses)[:, :2]
    heights, claimed = 1e3 * np.concatenate(errors), 1e3 * np.concatenate(sigmas)
    seen = [shares for _, shares in hidden if len(shares) > max(HIDDEN_AFTER)]
    x_rms, y_rms = np.sqrt(np.mean(sideways**2, axis=0)).tolist()
    return WalkFigures(
        x=x_rms,
        y=y_rms,
        worst=float(np.abs(sideways).max()),
        feet=float(np.sqrt(np.mean(heights**2))),
        bias=float(heights.mean()),
        claimed=float(np.sqrt(np.mean(claimed**2))),
        refused=refused,
        hidden=tuple(float(np.mean([shares[after] for shares in seen])) for after in HIDDEN_AFTER),
        unknown=unknown,
        dark=dark,
    )


def free_in_the_dark(ground: Ground, fused: gp.TerrainGrid, to_world: Float) -> int:
    """Number of traversable cells whose ground returns no light, so that it cannot have been seen."""
    x, y = (a.ravel() for a in np.meshgrid(*fused.geometry.centres()))
    free = (fused.traversability > 0).ravel()
    _, world = seen_height(ground, to_world, x[free], y[free])
    return int(ground.is_dark(world[:, 0], world[:, 1]).sum())


def follow_hidden(
    followed: list[tuple[Float, list[float]]], terrain: gp.TerrainGrid, fused: gp.TerrainGrid, pose: Float
) -> None:
    """Follow the cells that each scan found OCCLUDED: which share of its area is still hidden in the map later."""
    iy, ix = np.nonzero((terrain.hazard & np.uint16(Hazard.OCCLUDED)) != 0)
    x, y = terrain.geometry.centres()
    followed.append((np.column_stack((x[ix], y[iy])) @ pose[:2, :2].T + pose[:2, 3], []))
    for points, shares in followed:
        local = (points - pose[:2, 3]) @ pose[:2, :2]
        is_hidden = (np.asarray(fused.hazard_at(local[:, 0], local[:, 1])) & np.uint16(Hazard.OCCLUDED)) != 0
        shares.append(float(is_hidden.sum()) / terrain.geometry.size)


def main() -> None:
    """Command line."""
    run_part(
        "walks",
        {
            "drift": drift,
            "pictures": pictures.main,
            "moving": moving_ground.main,
            "cost": map_cost.main,
            "modes": scan_modes.main,
            "sigmas": sigmas.sigmas,
            "slopes": sigmas.slopes,
            "soft": soft_ground.soft,
        },
    )


if __name__ == "__main__":
    main()
