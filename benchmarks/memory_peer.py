"""The process whose memory is measured: it scans twice from frames that it makes one by one."""

from __future__ import annotations

import ctypes
import gc
from pathlib import Path

import numpy as np

from guara_perception import ScanProcessor
from guara_perception.simulation.specimen import specimen
from tests.scenes import robot_with, scan_stance, with_covariance


def resident(field: str) -> float:
    """VmRSS (now) or VmHWM (peak) of this process [MB]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field):
            return float(line.split()[1]) / 1024
    raise RuntimeError(f"/proc/self/status has no {field}")


def main(folder: str, stripes: int) -> None:
    """Print growth of the first scan, of the second above it, and the size of one pair of frames [MB]."""
    robot = robot_with(stripes)
    width, height, _ = (int(word) for word in (Path(folder) / "scan.txt").read_text().split())
    calibration = with_covariance(specimen(robot, (width, height)))
    stance = scan_stance(robot)
    off = np.load(Path(folder) / "off.npy")
    pair = 2 * off.nbytes / 1e6

    def scan(count: int) -> None:
        processor = ScanProcessor(calibration, robot, stance, "standard")
        # One pair of buffers, as a camera that waits for its reader has; they count as part of the scan.
        on_buffer, off_buffer = np.empty_like(off), np.empty_like(off)
        for index in range(count):
            first, end = processor.band(index)
            np.copyto(on_buffer, off)
            np.copyto(off_buffer, off)
            with (Path(folder) / f"{index}.band").open("rb") as band:
                band.readinto(on_buffer[first:end].data.cast("B"))
            processor.add(index, on_buffer, off_buffer)
        processor.finish()

    scan(1)
    gc.collect()
    # What the first scan has freed must not pass for the program's own size.
    release = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if release is not None:
        release(0)
    before = resident("VmRSS")
    scan(stripes)
    first = resident("VmHWM")
    scan(stripes)
    print(max(first - before, 0.0), resident("VmHWM") - first, pair)
