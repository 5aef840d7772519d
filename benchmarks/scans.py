"""Whole scans: time and errors of contenders, stages of the product's scan, and latency from the last frame."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from benchmarks.contenders import OURS, USER, Extract, opencv_user, over, reference
from benchmarks.rounds import Clock, Timings, alternate, number
from benchmarks.section import Effort, Section
from guara_perception.app.node.live_scan import STRIPES_AFTER
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from testbed.grid_truth import Truth
from testbed.scenes import ScanInMemory

REFERENCE = "reference extraction of the same frames"
CELL_M = 0.005
# Window of slope and step height, as the grids of this project have it: 30 mm.
WINDOW_CELLS = 7
OVERALL, LATENCY, FRAME = "whole scan", "last frame to grid", "reference extraction of one frame"
STAGES = ("prepare", "extract", "triangulate", "raster", "finish")


def process(scan: ScanInMemory, method: str) -> gp.TerrainGrid:
    """The grid of a scan as this project computes it."""
    processor = scan.processor(method)
    scan.add_to(processor)
    return processor.finish()


def by_opencv_user(scan: ScanInMemory) -> Float:
    """Whole frames, centre of gravity, griddata straight onto the cells, layers by cv2."""
    from scipy.interpolate import griddata

    points, _ = scan_points(scan, opencv_user)
    settings = Settings.of(scan.robot)
    cx, cy = (np.arange(low + CELL_M / 2, high, CELL_M) for low, high in (settings.footprint_x, settings.footprint_y))
    elevation = griddata(points[:, :2], points[:, 2], tuple(np.meshgrid(cx, cy)), method="linear")
    filled = np.nan_to_num(elevation).astype(np.float32)
    window = np.ones((WINDOW_CELLS, WINDOW_CELLS), np.uint8)
    cv2.magnitude(cv2.Sobel(filled, cv2.CV_32F, 1, 0), cv2.Sobel(filled, cv2.CV_32F, 0, 1))
    cv2.subtract(cv2.dilate(filled, window), cv2.erode(filled, window))
    return np.asarray(elevation)


def scan_points(scan: ScanInMemory, extract: Extract) -> tuple[Float, Float]:
    """Points (n, 3) of all stripes and the camera's optical centre (3,), in base_footprint [m].

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
    return cloud[(cloud[:, 2] > settings.minimum_height) & (cloud[:, 2] < settings.maximum_height)], transform[:3, 3]


def contenders(scan: ScanInMemory) -> dict[str, Callable[[], Any]]:
    """Whole scans by name; the reference extracts only."""
    bands = scan.bands()
    found: dict[str, Callable[[], Any]] = {REFERENCE: over(reference, bands)}
    for name, method in OURS.items():
        found[name] = lambda method=method: process(scan, method).elevation  # type: ignore[misc]
    found[USER] = lambda: by_opencv_user(scan)
    return found


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
                error = grid_errors(timings.results[name], scan.truth)
            rows.append((scan.name, name, timings.milliseconds(name), *ratios, *error))
    return Section(
        "whole_scans",
        "Whole scans",
        "Frames in memory to heights and traversability on cells of 5 mm, preparation included, decoding not. CPU "
        "time, and its ratio to the reference extraction of the same frames in the same round. Errors in mm on "
        "interior cells; missed: interior cells left unknown; false: cells that camera or laser cannot see but that "
        "were filled.",
        "scan: | contender: | ms CPU:.0f | x reference: | x ours: | mean mm:.3f | p95 mm:.2f | missed %:.2f"
        " | false %:.2f",
        rows,
    )


def grid_errors(elevation: npt.NDArray[Any], truth: Truth) -> tuple[float, float, float, float]:
    """Mean and 95 % error [mm], missed interior and false unseen cells [%]."""
    known = np.isfinite(elevation)
    error = np.abs(np.asarray(elevation, np.float64) - truth.mean)[known & truth.interior] * 1e3
    error = error if error.size else np.array([np.nan])
    missed = 100 * float((truth.interior & ~known).sum()) / max(int(truth.interior.sum()), 1)
    false = 100 * float((truth.unseen & known).sum()) / max(int(truth.unseen.sum()), 1)
    return float(error.mean()), float(np.percentile(error, 95)), missed, false


def stages(scan: ScanInMemory, effort: Effort) -> Section:
    """Wall time of each stage of a scan, and from the last frame to the grid."""
    bands, taken = scan.bands(), list[dict[str, float]]()
    runs = {REFERENCE: over(reference, bands), OVERALL: lambda: taken.append(one_scan(scan))}
    whole = alternate(runs, effort.rounds, clock=time.perf_counter).seconds[REFERENCE]
    # The first one warmed up.
    seconds = {name: {n: each[name] for n, each in enumerate(taken[1:])} for name in (*STAGES, LATENCY)}
    seconds |= {OVERALL: {n: sum(each[stage] for stage in STAGES) for n, each in enumerate(taken[1:])}}
    timings = Timings({**seconds, REFERENCE: whole, FRAME: {n: each / len(bands) for n, each in whole.items()}})
    rows: list[tuple[Any, ...]] = [
        (stage, timings.milliseconds(stage), timings.ratio(stage, REFERENCE), timings.ratio(stage, OVERALL).median)
        for stage in STAGES
    ]
    rows.append((LATENCY, timings.milliseconds(LATENCY), timings.ratio(LATENCY, FRAME), None))
    return Section(
        "stages",
        f"Stages of a scan ({scan.name})",
        "Wall time of one scan as this project reports it, and its ratio to the reference extraction of the same "
        "frames in the same round; latency from handing over the last frame to the finished grid, against the "
        "reference extraction of one frame.",
        "stage: | ms:.1f | x reference: | share:.0%",
        rows,
    )


def one_scan(scan: ScanInMemory, clock: Clock = time.perf_counter) -> dict[str, float]:
    """Seconds of each of STAGES of a scan, and by `clock` from its last frame to the grid (LATENCY)."""
    start = time.perf_counter()
    processor = scan.processor()
    prepared = time.perf_counter() - start
    # As the node does: what is there is judged while the last stripes are still to come.
    scan.add_to(processor, but_last=STRIPES_AFTER)
    processor.work_ahead()
    for frames in scan.frames[-STRIPES_AFTER:-1]:
        processor.add(*frames)
    start = clock()
    processor.add(*scan.frames[-1])
    terrain = processor.finish()
    latency = clock() - start
    return {"prepare": prepared, **terrain.metadata["seconds"], LATENCY: latency}
