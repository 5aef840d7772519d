"""The process whose memory is measured: it scans twice from frames that it makes one by one, or group by group."""

from __future__ import annotations

import ctypes
import gc
from pathlib import Path

import numpy as np

from benchmarks.rounds import resident_mb
from guara_perception import FramePair, ScanProcessor
from guara_perception.arrays import Image
from guara_perception.simulation.specimen import specimen
from testbed.scenes import robot_with, scan_stance, with_covariance


def main(folder: str, stripes: int, together: int = 1) -> None:
    """Print growth of the first scan, of the second above it, and the size of one pair of frames [MB].

    Args:
        folder: with one laser-off picture and the bands of the others.
        stripes: number of stripes of the scan.
        together: stripes that are processed at once. One: a camera that waits for its reader fills the same two
            buffers again. Several: each comes with a frame of its own, and they share the laser-off picture.
    """
    robot = robot_with(stripes)
    width, height, _ = (int(word) for word in (Path(folder) / "scan.txt").read_text().split())
    calibration = with_covariance(specimen(robot, (width, height)))
    stance = scan_stance(robot)
    off = np.load(Path(folder) / "off.npy")
    pair = 2 * off.nbytes / 1e6

    def fill(on: Image, index: int, rows: tuple[int, int]) -> None:
        np.copyto(on, off)
        with (Path(folder) / f"{index}.band").open("rb") as band:
            band.readinto(on[slice(*rows)].data.cast("B"))

    def scan(count: int) -> None:
        processor = ScanProcessor(calibration, robot, stance, "standard")
        # The frames count as part of the scan.
        on_buffers, off_buffer = [np.empty_like(off) for _ in range(min(together, count))], off.copy()
        for first in range(0, count, together):
            indices = range(first, min(first + together, count))
            for index, on in zip(indices, on_buffers, strict=False):
                fill(on, index, processor.band(index))
            pairs = [FramePair(index, on, off_buffer) for index, on in zip(indices, on_buffers, strict=False)]
            processor.add_all(pairs)
        processor.finish()

    scan(1)
    gc.collect()
    # What the first scan has freed must not pass for the program's own size.
    release = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if release is not None:
        release(0)
    before = resident_mb()
    scan(stripes)
    first = resident_mb(field="VmHWM")
    scan(stripes)
    print(max(first - before, 0.0), resident_mb(field="VmHWM") - first, pair)
