"""Stripe extraction beside other methods: on synthetic stripes whose centre is known, and on frames of scans."""

from __future__ import annotations

from typing import Any

from benchmarks.contenders import REFERENCE, USER, extractors, over, touch
from benchmarks.rounds import alternate, number
from benchmarks.section import Effort, Section
from testbed.scenes import ScanInMemory
from testbed.synthetic_stripes import CASES, stripe_errors, stripes

FLOOR = "floor: band read once"


def synthetic(effort: Effort) -> Section:
    """One row per contender and kind of light."""
    rows: list[tuple[Any, ...]] = []
    for case in CASES:
        frames = list(stripes(case, count=effort.synthetic_stripes))
        pairs = [(on, off) for on, off, _ in frames]
        timings = alternate(
            {name: over(extract, pairs) for name, extract in extractors().items()} | {FLOOR: over(touch, pairs)},
            effort.rounds,
        )
        for name, extract in extractors().items():
            error = stripe_errors([extract(on, off) for on, off in pairs], [centre for _, _, centre in frames])
            ratios = timings.ratio(name, REFERENCE), number(timings.ratio(name, FLOOR).median)
            rows.append((case.name, name, *ratios, *(error[key] for key in ("mean", "p95", "missed", "false"))))
    return Section(
        "extraction_synthetic",
        "Stripe extraction, synthetic stripes",
        "Bands of 1280 x 160 pixels with a Gaussian stripe whose centre is known. CPU time over that of a plain cv2 "
        "and numpy reference in the same round, and over reading the band's bytes once; errors in pixels, missed "
        "and false columns in per cent. Saturated stripes, clipped over several rows, are in doubt for `precise`: they "
        "are followed as in any light, which costs many times as much.",
        "light:<9 | contender:<28 | x reference:<18 | x floor:>7 | mean px:.3f | p95 px:.3f | missed %:.2f"
        " | false %:.2f",
        rows,
    )


def frames_of_scans(all_scans: list[ScanInMemory], effort: Effort) -> Section:
    """Time on the frames of scans: those who know the band get the band, the others the whole frame."""
    rows: list[tuple[Any, ...]] = []
    for scan in all_scans:
        bands, whole = [(on, off) for on, off, _ in scan.bands()], [(on, off) for _, on, off in scan.frames]
        contenders = {name: over(extract, whole if name == USER else bands) for name, extract in extractors().items()}
        timings = alternate(contenders | {FLOOR: over(touch, bands)}, effort.rounds)
        for name in timings.seconds:
            ratios = timings.ratio(name, REFERENCE), number(timings.ratio(name, FLOOR).median)
            rows.append((scan.name, name, timings.milliseconds(name, len(bands)), *ratios))
    return Section(
        "extraction_scans",
        "Stripe extraction, frames of scans",
        "The same on the frames of scans. The reference and this project look at the row band in which the stripe can "
        "appear, the others at the whole frame; the resulting errors of the heights are in the table of whole scans.",
        "scan:<38 | contender:<28 | ms per frame:.2f | x reference:<18 | x floor:>7",
        rows,
    )
