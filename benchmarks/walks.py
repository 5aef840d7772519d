"""Maps of walks compared with the true ground: drift, heights under the feet; cost of maps; refinement of coarse scans.

`python -m benchmarks walks PART ...`; without a part: a list of them.

The part `drift` walks over mixed analytic ground, over level ground, which shows no sideways motion, and through
simulated frames, each without and with registration of its scans. Drift is measured on ground seen at the near edge of
the area, when the hind feet come to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import guara_perception as gp
from benchmarks import map_cost, moving_ground, pictures, scan_modes, sigmas, soft_ground
from benchmarks.command import Table, options, run_part
from benchmarks.fused_walk import PAUSES_BETWEEN, drift_aside, fused_pauses, rms
from guara_perception.arrays import Float
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from kinematics import RobotModel, load_robot
from testbed.analytic_walk import Ground, seen_height
from testbed.scanned_walk import WalkedPause, analytic_pauses, framed_pauses

# A hind foot reaches ground that was scanned before the walk began only after this number of pauses.
FIRST_HIND_PAUSE = 24
# Pauses after which cells hidden in a scan are counted in the map.
HIDDEN_AFTER = (0, 4, 8, 12)
Figures = dict[str, float]


def drift() -> None:
    """Drift of the map and heights under the hind feet [--first, --walks, --flat, --frames, --cycles, --kept]."""
    asked = options(
        __doc__,
        first=(20, "first seed; the settings were chosen on 0 to 9"),
        walks=(10, "over mixed analytic ground"),
        flat=(3, "over level ground"),
        frames=(0, "through simulated frames, from seed 0; slow where no file is kept"),
        cycles=(10, "cycles of each walk"),
        kept=(Path, "folder that keeps the scans of frames from run to run"),
    )
    robot, cycles = load_robot("guara"), asked.cycles
    kinds: dict[str, tuple[int, int, Callable[[int], Iterator[WalkedPause]]]] = {
        "mixed ground": (asked.first, asked.walks, lambda seed: analytic_pauses(robot, seed, cycles)),
        "level ground": (asked.first, asked.flat, lambda seed: analytic_pauses(robot, seed, cycles, level=True)),
        "frames": (0, asked.frames, lambda seed: framed_pauses(robot, seed, cycles, asked.kept)),
    }
    print(
        f"without registration -> with it: sideways drift over {PAUSES_BETWEEN} pauses, x and y rms and the worst; "
        f"heights under hind feet, rms; then with it: mean error and rms of the claimed sigma [mm]; scans not used; "
        f"share of a scan's area hidden after {HIDDEN_AFTER} pauses [%]; traversable cells that are unknown, or dark"
    )
    table = Table(
        "ground:<12 | walk:>4 | x:>14 | y:>14 | worst:>14 | feet:>14 | bias:+5.2f | claimed:.2f | not used:.0f | "
        "hidden:<19 | unknown:.0f | dark:.0f"
    )
    for name, (first, count, pauses_of) in kinds.items():
        walks: list[tuple[Figures, ...]] = []
        for seed in range(first, first + count):
            pauses = list(pauses_of(seed))
            walks.append(tuple(walk_figures(robot, pauses, registered=registered) for registered in (False, True)))
            table.row(name, str(seed), *shown(*walks[-1]))
        if walks:
            table.row(name, "all", *shown(*(overall(each) for each in zip(*walks, strict=True))))
            gains = ", ".join(
                f"{key} {max(float(np.mean(on[key]) - np.mean(off[key])) for off, on in walks):+.2f}"
                for key in "x y feet".split()
            )
            feet = np.median([on["feet"] for _, on in walks])
            print(f"  median under the feet {feet:.2f} mm; of the walks that gained least: {gains} mm")


def shown(off: Figures, on: Figures) -> Iterator[Any]:
    """Values of a row: a walk without registration, and with it."""
    yield from (f"{off[key]:.2f} -> {on[key]:.2f}" for key in ("x", "y", "worst", "feet"))
    yield from (on[key] for key in ("bias", "claimed", "refused"))
    yield " ".join(f"{100 * on[f'hidden {after}']:.2f}" for after in HIDDEN_AFTER)
    yield from (on["unknown"], on["dark"])


def overall(walks: Sequence[Figures]) -> Figures:
    """Figures of all walks: sums of counts, root mean squares sideways, the worst, and means."""
    how: dict[str, Callable[[list[float]], Any]] = {"x": rms, "y": rms, "worst": max}
    how |= dict.fromkeys(("refused", "unknown", "dark"), sum)
    return {key: float(how.get(key, np.mean)([walk[key] for walk in walks])) for key in walks[0]}


def walk_figures(robot: RobotModel, pauses: list[WalkedPause], *, registered: bool) -> Figures:
    """Figures of a walk without or with registration, by name: those of the table, lengths in mm, shares of 1."""
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
    heights = 1e3 * np.concatenate(errors)
    seen = [shares for _, shares in hidden if len(shares) > max(HIDDEN_AFTER)]
    return {
        **dict(zip("xy", map(rms, sideways.T), strict=True)),
        "worst": float(np.abs(sideways).max()),
        "feet": rms(heights),
        "bias": float(heights.mean()),
        "claimed": rms(1e3 * np.concatenate(sigmas)),
        "refused": refused,
        "unknown": unknown,
        "dark": dark,
        **{f"hidden {after}": float(np.mean([shares[after] for shares in seen])) for after in HIDDEN_AFTER},
    }


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
