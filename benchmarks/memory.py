"""Memory that a scan adds to a process."""

from __future__ import annotations

import ctypes
import gc
import multiprocessing

import numpy as np

from benchmarks.rounds import peak_growth, resident_mb
from benchmarks.section import Section
from guara_perception import FramePair, ScanProcessor
from guara_perception.app.node.rangefinder import STRIPES_TOGETHER
from guara_perception.arrays import Image
from guara_perception.simulation.specimen import specimen
from testbed.scenes import ScanInMemory, robot_with, scan_stance, with_covariance

BY_STRIPE = "a scan stripe by stripe, its frame pair included"


def memory(scan: ScanInMemory) -> Section:
    """Peak memory of a process that scans, above what it held before."""
    off, bands = scan.frames[0][2], []
    processor = scan.processor()
    for index, on, _ in scan.frames:
        first_row, end = processor.band(index)
        bands.append((first_row, on[first_row:end].copy()))
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        first, second = pool.apply(growth, (off, bands, 1))
        node, _ = pool.apply(growth, (off, bands, STRIPES_TOGETHER))
    return Section(
        "memory",
        f"Memory of a scan ({scan.name})",
        "Growth of the peak resident memory of a fresh process that has everything loaded and has scanned one stripe. "
        f"A node holds more than one frame: up to {STRIPES_TOGETHER} that it processes at once for a third less "
        "processor time, and one laser-off picture; the target is for what is scanned stripe by stripe.",
        "what:<64 | MB:5.1f",
        [
            (BY_STRIPE, first),
            ("the next scan, above the peak of the first", second),
            ("one pair of frames, for comparison", 2 * off.nbytes / 1e6),
            (f"a scan by {STRIPES_TOGETHER} stripes at once as in a node, their frames included", node),
        ],
    )


def growth(off: Image, bands: list[tuple[int, Image]], together: int) -> tuple[float, float]:
    """Growth of this process in the first of two scans, and of the second above it [MB].

    Args:
        off: laser-off picture.
        bands: first row and laser-on picture of the band of each stripe.
        together: stripes that are processed at once. One: a camera that waits for its reader fills the same two
            buffers again. Several: each comes with a frame of its own, and they share the laser-off picture.
    """
    robot, (height, width) = robot_with(len(bands)), off.shape[:2]
    calibration, stance = with_covariance(specimen(robot, (width, height))), scan_stance(robot)

    def scan(count: int) -> None:
        processor = ScanProcessor(calibration, robot, stance, "standard")
        # The frames count as part of the scan.
        on_buffers, off_buffer = [np.empty_like(off) for _ in range(min(together, count))], off.copy()
        for first in range(0, count, together):
            pairs = []
            for index, on in zip(range(first, min(first + together, count)), on_buffers, strict=False):
                top, band = bands[index]
                np.copyto(on, off)
                on[top : top + len(band)] = band
                pairs.append(FramePair(index, on, off_buffer))
            processor.add_all(pairs)
        processor.finish()

    scan(1)
    gc.collect()
    # Memory freed by the first scan must not count as part of the base size.
    release = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if release is not None:
        release(0)
    _, first = peak_growth(lambda: scan(len(bands)))
    before = resident_mb(field="VmHWM")
    scan(len(bands))
    return first, resident_mb(field="VmHWM") - before
