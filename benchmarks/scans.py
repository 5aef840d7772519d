"""Whole scans: time and errors of contenders, and delay from the last frame to the grid."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.contenders import OURS, USER, Extract, opencv_user, over, reference
from benchmarks.rounds import Ratio, alternate, number
from benchmarks.section import Effort, Section
from guara_perception.app.node.live_scan import STRIPES_AFTER
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from testbed.grid_truth import figures
from testbed.scenes import ScanInMemory

REFERENCE = "reference extraction of the same frames"
CELL_M = 0.005
# Window of slope and step height, as the grids of this project have it: 30 mm.
WINDOW_CELLS = 7
LATENCY = "ours: last frame to grid, by one frame"


def process(scan: ScanInMemory, method: str) -> gp.TerrainGrid:
    """The grid of a scan as this project computes it."""
    processor = scan.processor(method)
    scan.add_to(processor)
    return processor.finish()


def by_opencv_user(scan: ScanInMemory) -> Float:
    """Whole frames, centre of gravity, griddata straight onto the cells, layers by cv2."""
    from scipy.interpolate import griddata

    points = scan_points(scan, opencv_user)
    settings = Settings.of(scan.robot)
    cx, cy = (np.arange(low + CELL_M / 2, high, CELL_M) for low, high in (settings.footprint_x, settings.footprint_y))
    elevation = griddata(points[:, :2], points[:, 2], tuple(np.meshgrid(cx, cy)), method="linear")
    filled = np.nan_to_num(elevation).astype(np.float32)
    window = np.ones((WINDOW_CELLS, WINDOW_CELLS), np.uint8)
    cv2.magnitude(cv2.Sobel(filled, cv2.CV_32F, 1, 0), cv2.Sobel(filled, cv2.CV_32F, 0, 1))
    cv2.subtract(cv2.dilate(filled, window), cv2.erode(filled, window))
    return np.asarray(elevation)


def scan_points(scan: ScanInMemory, extract: Extract) -> Float:
    """Points (n, 3) of all stripes in base_footprint [m].

    Args:
        scan: frames of one scan.
        extract: gives the row of the stripe in each column.
    """
    camera = scan.calibration.camera
    pose = scan.robot.stance_pose(scan.stance).transform_base_to_footprint
    transform = pose @ scan.calibration.transform_camera_to_base
    settings = Settings.of(scan.robot)
    clouds = []
    for index, on, off in scan.frames:
        rows = extract(on, off)
        columns = np.flatnonzero(np.isfinite(rows))
        if not columns.size:
            continue
        pixels = np.column_stack((columns, rows[columns])).astype(np.float64)
        flat = cv2.undistortPoints(pixels[:, None], camera.matrix, camera.distortion)[:, 0]
        rays = np.column_stack((flat, np.ones(len(flat))))
        plane = scan.calibration.stripe(index).plane
        points = rays * (-plane[3] / (rays @ plane[:3]))[:, None]
        clouds.append(points @ transform[:3, :3].T + transform[:3, 3])
    cloud = np.concatenate(clouds)
    return np.asarray(cloud[(cloud[:, 2] > settings.minimum_height) & (cloud[:, 2] < settings.maximum_height)])


def contenders(scan: ScanInMemory) -> dict[str, Callable[[], Any]]:
    """Whole scans by name; the reference extracts only."""
    found: dict[str, Callable[[], Any]] = {REFERENCE: over(reference, scan.bands())}
    ours = {name: partial(process, scan, method) for name, method in OURS.items()}
    return found | ours | {USER: partial(by_opencv_user, scan)}


def whole_scans(all_scans: list[ScanInMemory], effort: Effort) -> Section:
    """One row per contender and scan."""
    rows: list[tuple[Any, ...]] = []
    for scan in all_scans:
        runs = contenders(scan)
        timings = alternate(runs, effort.rounds, slow=[USER], slow_rounds=effort.slow_rounds)
        for name in runs:
            ratios = timings.ratio(name, REFERENCE), number(timings.ratio(name, next(iter(OURS))).median)
            error: tuple[float | None, ...] = (None,) * 4
            if name != REFERENCE and scan.truth is not None:
                result = timings.results[name]
                grid = result if isinstance(result, gp.TerrainGrid) else gp.assess_terrain(result, CELL_M)
                found = figures(grid, scan.truth)
                error = found.mean, found.p95, 100 - found.known, found.unseen_known
            rows.append((scan.name, name, timings.milliseconds(name), *ratios, *error))
        frame_ms = timings.milliseconds(REFERENCE, per=len(scan.frames))
        ratio = delay(scan, frame_ms, effort.rounds)
        rows.append((scan.name, LATENCY, frame_ms * ratio.median, ratio, *(None,) * 5))
    return Section(
        "whole_scans",
        "Whole scans",
        "Frames in memory to heights and traversability on cells of 5 mm, preparation included, decoding not. CPU "
        "time, and its ratio to the reference extraction of the same frames in the same round; from the last frame to "
        "the grid, to that of one frame. Errors in mm on interior cells; missed: interior cells left unknown; false: "
        "cells that camera or laser cannot see but that were filled.",
        "scan:<38 | contender:<39 | ms CPU:.0f | x reference:<18 | x ours:>6 | mean mm:.3f | p95 mm:.2f | missed %:.2f"
        " | false %:.2f",
        rows,
    )


def delay(scan: ScanInMemory, frame_ms: float, rounds: int) -> Ratio:
    """Processor time from the last frame to the grid over that of the reference for one frame [ms]."""
    taken = []
    for _ in range(rounds):
        processor = scan.processor()
        # As the node does: what is there is judged while the last stripes are still to come.
        scan.add_to(processor, but_last=STRIPES_AFTER)
        processor.work_ahead()
        for frames in scan.frames[-STRIPES_AFTER:-1]:
            processor.add(*frames)
        start = time.process_time()
        processor.add(*scan.frames[-1])
        processor.finish()
        taken.append(1e3 * (time.process_time() - start) / frame_ms)
    return Ratio(float(np.median(taken)), min(taken), max(taken))
