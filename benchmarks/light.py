"""Effects of real light on scans: stripes found, wrong and made up, and errors of the heights.

`python -m benchmarks light effects [--strengths 0.5 1] [--effects NAME ...]`: a scene of boxes, a
pit and a dark patch, rendered with each effect alone and with all together (at a third of each). A strength of 1 is
what photographs of laser lines show (`guara_perception.simulation.light`); with and without laser-off pictures.
It takes 75 s of processor time. `light cost` times extraction beside a plain OpenCV loop, `light scans` whole scans, by
their parts; `light twins` and `light mosaics` take no arguments.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache, partial, wraps
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

import guara_perception as gp
from benchmarks import mosaics
from benchmarks.command import Table, options, run_part
from benchmarks.contenders import REFERENCE, over, reference
from benchmarks.photographs import RIGHT_PX, Counts
from benchmarks.rounds import alternate
from benchmarks.scans import delay, process
from guara_perception.arrays import Float
from guara_perception.ranging.scan_geometry import StripeRanger
from guara_perception.scanning import scan_processor
from guara_perception.scanning.background import BackgroundWitness
from guara_perception.scanning.flash_proof import FlashProof
from guara_perception.scanning.light_diagnosis import FrameSamples
from guara_perception.scanning.scan_surface import ScanSurface
from guara_perception.scanning.stripe_finder import StripeFinder
from guara_perception.simulation import EFFECTS, Light, real_light
from guara_perception.stripes.band import Band
from guara_perception.stripes.precise import extract_precise
from testbed.grid_truth import figures, made_up
from testbed.scenes import ScanInMemory, simulated

SIZE, STRIPES = (640, 512), 35
# Effects that hide a stripe from its highest peaks, and stripes of a scan of which every second is timed.
HARD, COST_STRIPES = ("width", "halo", "ambient", "noise", "drift", "ghosts"), 14
# Two lines in one picture: widths [px], distances [px], brightness of the second as a share of the first's; least
# distance of each row of the table [sigmas]; distance from both from which a position belongs to neither [px].
TWIN_WIDTHS, TWIN_DISTANCES, TWIN_RATIOS = (1.0, 1.7, 3.0), (3, 4, 5, 6, 7, 8, 10, 14, 20, 40), (1.0, 0.8, 0.5, 0.35)
TWIN_SIGMAS, TWIN_WRONG_PX = (0.0, 1.5, 2.0, 2.7, 3.5, 5.0), 1.0
# Parts of a scan whose processor time is printed: owner and name of the function.
PARTS: dict[str, tuple[Any, str]] = {
    "preparation": (scan_processor.ScanProcessor, "__init__"),
    "finding stripes": (StripeFinder, "find"),
    "second lines": (scan_processor, "second_line"),
    "dark frames": (FlashProof, "add"),
    "light of samples": (FrameSamples, "add"),
    "motion of the background": (BackgroundWitness, "look"),
    "ranging": (StripeRanger, "points"),
    "surface and raster": (ScanSurface, "add"),
    "causes and layers": (ScanSurface, "layers"),
    "record and grid": (scan_processor.ScanProcessor, "finish"),
}
ALL, ALL_STRENGTH = "all together", 1 / 3
# The true row of a stripe is the one in a dark room without noise. A stripe can be seen where ordinary laser light has
# SEEN_LEVEL or more [grey levels of 255]; there is none to find where the light of the laser used is below GAP_LEVEL.
CLEAN = Light(ambient=(0.0, 0.0, 0.0), speckle=0.0, bounce=0.0, shot_noise=0.0, read_noise=0.0)
SEEN_LEVEL, GAP_LEVEL = 25, 5
# Columns this near to the end of a stripe count neither as stripe nor as gap.
BESIDE_END = 3


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


def judge(scan: ScanInMemory, light: Light, *, with_off: bool) -> tuple[Counts, gp.TerrainGrid]:
    """Counts of the stripes of a scan that was rendered in this light, and its grid."""
    processor, truth, counts = scan.processor(), true_rows(light.stripe_sigma, light.laser), Counts()
    for index, on, off in scan.frames:
        position = processor.add(index, on, off if with_off else None).position_px
        rows, level = truth[index]
        first, end = processor.band(index)
        seen = np.where((rows >= first) & (rows < end), rows, np.nan)
        empty = cv2.erode((level < GAP_LEVEL).astype(np.uint8)[None], np.ones((1, 2 * BESIDE_END + 1))).ravel() > 0
        counts.add(np.asarray(position, np.float64), must=seen, may=seen, gap=empty)
    return counts, processor.finish()


def effects() -> None:
    """Each effect of real light on a scan: stripes found, wrong and made up [--strengths, --effects].

    Found and gross are shares of the stripes' columns, filled of the columns without one, known of the interior cells.
    Unsafe cells are traversable although they are dark or out of view; made-up cells are traversable and more than 5 mm
    outside their true heights.
    """
    names = [*EFFECTS, ALL]
    asked = options(
        __doc__, strengths=([0.5, 1.0], "strengths of each"), effects=(names, ", ".join(names), {"choices": names})
    )
    cv2.setNumThreads(1)
    table = Table(
        "effect:<12 | strength:.2f | off:<5 | found:6.3f | gross:6.3f | filled:6.3f | known:6.3f | mm:6.3f | "
        "p95:6.3f | unsafe:6d | made up:7d | health:<"
    )
    for name, strength in [("none", 0.0), *itertools.product(asked.effects, asked.strengths)]:
        of_each = dict.fromkeys(EFFECTS, strength * ALL_STRENGTH) if name == ALL else {name: strength}
        light = Light() if name == "none" else real_light(of_each)
        scan = simulated(SIZE, STRIPES, light)
        assert scan.truth is not None
        for with_off in (True, False):
            counts, terrain = judge(scan, light, with_off=with_off)
            errors, reasons = figures(terrain, scan.truth), terrain.metadata["health"]["reasons"]
            numbers = *counts.shares, errors.known / 100, errors.mean, errors.p95, errors.unsafe
            table.row(name, strength, str(with_off), *numbers, made_up(terrain, scan.truth), (["", *reasons])[-1])


def cost() -> None:
    """Processor time of extraction beside the reference on the same frames, in clean and hard light [--rounds]."""
    asked = options(cost.__doc__, rounds=(5, "interleaved rounds; of their ratios: median, smallest and largest"))
    cv2.setNumThreads(1)
    table = Table("effect:<8 | columns:7d | rows:4d | ours / reference:<18")
    for name, size in itertools.product(("clean", *HARD), ((1280, 1024), SIZE)):
        scan = simulated(size, COST_STRIPES, real_light({} if name == "clean" else {name: 1.0}))
        pairs = scan.bands()[::2]
        ours, theirs = over(lambda on, off: extract_precise(Band(on, off)), pairs), over(reference, pairs)
        timings = alternate({"ours": ours, REFERENCE: theirs}, asked.rounds)
        table.row(name, *size, timings.ratio("ours", REFERENCE))


@contextmanager
def noting_parts() -> Iterator[dict[str, float]]:
    """Processor seconds spent in each of PARTS while the block lasts, without those of parts that they call."""
    seconds, running = dict.fromkeys(PARTS, 0.0), list[str]()
    since = time.process_time()

    def switch() -> None:
        nonlocal since
        now = time.process_time()
        if running:
            seconds[running[-1]] += now - since
        since = now

    def clocked(part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*args: Any, **keywords: Any) -> Any:
            switch()
            running.append(part)
            try:
                return function(*args, **keywords)
            finally:
                switch()
                running.pop()

        return call

    with ExitStack() as stack:
        for part, (owner, name) in PARTS.items():
            stack.enter_context(patch.object(owner, name, clocked(part, getattr(owner, name))))
        yield seconds


def scans() -> None:
    """Processor time of whole scans beside the reference on their bands, and where it goes [--rounds]."""
    asked = options(scans.__doc__, rounds=(5, "interleaved rounds; of their ratios: median, smallest and largest"))
    cv2.setNumThreads(1)
    table = Table(
        "scan:<8 | columns:7d | rows:4d | scan / reference:<19 | last frame to grid / reference of a frame:<19"
    )
    shares: dict[str, dict[str, float]] = {}
    for name, size in itertools.product(("clean", "ambient"), ((1280, 1024), SIZE)):
        scan = simulated(size, 70, real_light({} if name == "clean" else {name: 1.0}))
        runs: dict[str, Callable[[], object]] = {
            "scan": partial(process, scan, "precise"),
            REFERENCE: over(reference, scan.bands()),
        }
        timings = alternate(runs, asked.rounds)
        frame_ms = timings.milliseconds(REFERENCE, per=len(scan.frames))
        table.row(name, *size, timings.ratio("scan", REFERENCE), delay(scan, frame_ms, asked.rounds))
        with noting_parts() as seconds:
            timings = alternate(runs, asked.rounds)
        reference_s = sum(timings.seconds[REFERENCE].values())
        # The first scan, which warms up, is noted too.
        per_scan = asked.rounds / (asked.rounds + 1) / reference_s
        parts = {part: spent * per_scan for part, spent in seconds.items()}
        parts["the rest"] = timings.ratio("scan", REFERENCE).median - sum(parts.values())
        shares[f"{name} {size[0]}"] = parts
    print("parts of a scan / reference:", *(f"{case:>12s}" for case in shares))
    for part in (*PARTS, "the rest"):
        print(f"{part:28s}", *(f"{parts[part]:12.2f}" for parts in shares.values()))


def twins() -> None:
    """Positions between two lines in one picture, which are neither line's, by their distance."""
    options(twins.__doc__)
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    rows, columns = np.arange(120)[:, None], np.arange(320)
    centre, two = 45 + 6 * np.sin(columns / 50), (columns >= 100) & (columns < 220)
    counts = {nearest: np.zeros(2, int) for nearest in TWIN_SIGMAS}
    for sigma, apart, ratio, is_grey in itertools.product(TWIN_WIDTHS, TWIN_DISTANCES, TWIN_RATIOS, (False, True)):
        first, second = (np.exp(-0.5 * ((rows - centre - far) / sigma) ** 2) for far in (0, apart))
        pair = 30 + rng.normal(0, 1.5, (2, 120, 320, 3))
        pair[0] += 120 * (first + ratio * second * two)[:, :, None] * (0.1, 0.2, 1.0)
        on, off = pair.clip(0, 255).astype(np.uint8)
        if is_grey:
            on, off = on[:, :, 2].copy(), off[:, :, 2].copy()
        position = gp.extract_stripe(on, off).position_px[two]
        beyond = np.minimum(np.abs(position - centre[two]), np.abs(position - centre[two] - apart)) > TWIN_WRONG_PX
        nearest = max(limit for limit in TWIN_SIGMAS if apart >= limit * sigma)
        counts[nearest] += np.count_nonzero(beyond), np.count_nonzero(np.isfinite(position))
    table = Table("sigmas apart, at least:22.1f | positions:9d | between the lines:17d")
    for nearest, (between, found) in counts.items():
        table.row(nearest, found, between)


def main() -> None:
    """Command line."""
    run_part("light", {"twins": twins, "effects": effects, "cost": cost, "scans": scans, "mosaics": mosaics.main})


if __name__ == "__main__":
    main()
