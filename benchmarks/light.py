"""What each effect of real light does to a scan: stripes found, wrong and made up, and the error of the heights.

`python -m benchmarks light effects [--strengths 0.5 1] [--effects NAME ...] [--json]`: a scene of boxes, a
pit and a dark patch, rendered with each effect alone and with all together (at a third of each). A strength of 1 is
what photographs of laser lines show (`guara_perception.simulation.real_light`); with and without laser-off pictures.
It takes 75 s of processor time. `python -m benchmarks light mosaics` takes no arguments.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache

import cv2
import numpy as np

import guara_perception as gp
from benchmarks import mosaics
from benchmarks.parts import run_part
from benchmarks.photographs import RIGHT_PX
from guara_perception.arrays import Float
from guara_perception.simulation import EFFECTS, Light, real_light
from testbed.grid_truth import figures, made_up
from testbed.scenes import ScanInMemory, simulated

SIZE, STRIPES = (640, 512), 35
ALL, ALL_STRENGTH = "all together", 1 / 3
# The true row of a stripe is the one in a dark room without noise. A stripe can be seen where ordinary laser light has
# SEEN_LEVEL or more [grey levels of 255]; there is none to find where the light of the laser used is below GAP_LEVEL.
CLEAN = Light(ambient=(0.0, 0.0, 0.0), speckle=0.0, bounce=0.0, shot_noise=0.0, read_noise=0.0)
SEEN_LEVEL, GAP_LEVEL = 25, 5
# Columns this near to the end of a stripe count neither as stripe nor as gap.
BESIDE_END = 3


@dataclass(frozen=True, slots=True)
class Effect:
    """What one effect of light did to a scan.

    Attributes:
        effect, strength: name and strength of the effect; 1 is what photographs show.
        with_off: whether there were laser-off pictures.
        coverage: share of the stripes' columns in which they were found within RIGHT_PX.
        gross: share of the positions returned that are further off than RIGHT_PX.
        filled: share of the columns without a stripe in which a position was returned.
        known: share of the interior cells that the grid knows.
        mean_mm, p95_mm: mean and 95th percentile of the errors of their heights [mm].
        unsafe: cells called traversable that are dark or that nobody could see.
        made_up: cells called traversable whose height is further than 5 mm from all the true heights within them.
        health: the scan's last reason, empty when it has none.
    """

    effect: str
    strength: float
    with_off: bool
    coverage: float
    gross: float
    filled: float
    known: float
    mean_mm: float
    p95_mm: float
    unsafe: int
    made_up: int
    health: str


@cache
def true_rows(stripe_sigma: float, laser: float) -> dict[int, tuple[Float, Float]]:
    """Index of a stripe -> rows (columns,) of its centre, NaN where it cannot be seen, and its brightness (columns,).

    Rows are found in pictures with the ordinary laser, so that nothing is clipped; brightness is scaled to `laser`.

    Args:
        stripe_sigma: width of the stripe [m].
        laser: brightness of the laser used, as in `Light`.
    """
    found = {}
    for index, on, _ in simulated(SIZE, STRIPES, replace(CLEAN, stripe_sigma=stripe_sigma)).frames:
        light = on[:, :, 2].astype(np.float64)
        level = light.max(axis=0)
        near = np.abs(np.arange(len(light))[:, None] - light.argmax(axis=0)) <= RIGHT_PX
        weight = light * near
        rows = (np.arange(len(light))[:, None] * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)
        found[index] = np.where(level >= SEEN_LEVEL, rows, np.nan), level * laser / CLEAN.laser
    return found


def judge(scan: ScanInMemory, light: Light, *, with_off: bool) -> tuple[tuple[float, float, float], gp.TerrainGrid]:
    """Coverage, gross and filled (see `Effect`) of a scan that was rendered in this light, and its grid."""
    processor, truth = scan.processor(), true_rows(light.stripe_sigma, light.laser)
    right = wrong = seen = gaps = filled = 0
    for index, on, off in scan.frames:
        position = processor.add(index, on, off if with_off else None).position_px
        rows, level = truth[index]
        first, end = processor.band(index)
        inside = np.isfinite(rows) & (rows >= first) & (rows < end)
        error = np.abs(position - rows)[inside]
        seen += error.size
        right += int((error <= RIGHT_PX).sum())
        wrong += int((error > RIGHT_PX).sum())
        empty = cv2.erode((level < GAP_LEVEL).astype(np.uint8)[None], np.ones((1, 2 * BESIDE_END + 1))).ravel() > 0
        gaps += int(empty.sum())
        filled += int(np.isfinite(position[empty]).sum())
    return (right / max(seen, 1), wrong / max(right + wrong, 1), filled / max(gaps, 1)), processor.finish()


def lights(strengths: Sequence[float], names: Sequence[str]) -> Iterator[tuple[str, float, Light]]:
    """Name of the effect, strength and light of every case."""
    yield "none", 0.0, Light()
    for name in names:
        for strength in strengths:
            if name == ALL:
                yield name, strength, real_light(dict.fromkeys(EFFECTS, strength * ALL_STRENGTH))
            else:
                yield name, strength, real_light({name: strength})


def measure(strengths: Sequence[float], names: Sequence[str]) -> Iterator[Effect]:
    """The figures of every case, with and without laser-off pictures."""
    for name, strength, light in lights(strengths, names):
        scan = simulated(SIZE, STRIPES, light)
        assert scan.truth is not None
        for with_off in (True, False):
            (coverage, gross, filled), terrain = judge(scan, light, with_off=with_off)
            found = figures(terrain, scan.truth)
            reasons = terrain.metadata["health"]["reasons"]
            yield Effect(
                name,
                strength,
                with_off,
                round(coverage, 4),
                round(gross, 4),
                round(filled, 4),
                known=round(found.known / 100, 4),
                mean_mm=round(found.mean, 3),
                p95_mm=round(found.p95, 3),
                unsafe=found.unsafe,
                made_up=made_up(terrain, scan.truth),
                health=reasons[-1] if reasons else "",
            )


def effects() -> None:
    """Each effect of real light on a scan: stripes found, wrong and made up [--strengths, --effects, --json]."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--strengths", type=float, nargs="+", default=[0.5, 1.0])
    names = [*EFFECTS, ALL]
    parser.add_argument("--effects", nargs="+", default=names, choices=names, metavar="NAME", help=", ".join(names))
    parser.add_argument("--json", action="store_true", help="one object per line")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if not arguments.json:
        head = f"{'found':>6s} {'gross':>6s} {'filled':>6s} {'known':>6s} {'mm':>6s} {'p95':>6s} {'unsafe':>6s}"
        print(f"{'effect':12s} {'strength':>8s} off {head} {'made up':>7s} health")
    for effect in measure(arguments.strengths, arguments.effects):
        if arguments.json:
            print(json.dumps(asdict(effect)), flush=True)
            continue
        shares = f"{effect.coverage:6.3f} {effect.gross:6.3f} {effect.filled:6.3f} {effect.known:6.3f}"
        errors = f"{effect.mean_mm:6.3f} {effect.p95_mm:6.3f} {effect.unsafe:6d} {effect.made_up:7d}"
        with_off = "yes" if effect.with_off else "no"
        print(f"{effect.effect:12s} {effect.strength:8.2f} {with_off:3s} {shares} {errors} {effect.health}", flush=True)


def main() -> None:
    """Command line."""
    run_part("light", {"effects": effects, "mosaics": mosaics.main})


if __name__ == "__main__":
    main()
