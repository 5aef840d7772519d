"""Whole scans by this project and by others: frames in memory -> heights and layers on cells of 5 mm."""

from __future__ import annotations

import cv2
import numpy as np

import guara_perception as gp
from benchmarks import paper_chain as paper
from benchmarks.contenders import Extract, literal, opencv_user
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from testbed.scenes import ScanInMemory

CELL_M = 0.005


def process(scan: ScanInMemory, method: str) -> gp.TerrainGrid:
    """The grid of a scan as this project computes it."""
    processor = scan.processor(method)
    scan.add_to(processor)
    return processor.finish()


def paper_literally(scan: ScanInMemory, extract: Extract) -> Float:
    """The paper with common libraries: griddata fills the perspective picture, its eqs. 20 and 21 rectify it."""
    points, optical_centre = scan_points(scan, extract)
    x, y = area(scan)
    height = paper.range_image(points, optical_centre, x, y)
    elevation = paper.cells(paper.orthorectified(height, optical_centre, x, y), x, y, CELL_M)
    paper.layers(elevation, CELL_M)
    return elevation


def paper_point_by_point(scan: ScanInMemory) -> Float:
    """The paper with loops over points and pixels; the layers are computed on its rectified picture."""
    points, optical_centre = scan_points(scan, literal, one_by_one=True)
    x, y = area(scan)
    height = paper.range_image(points, optical_centre, x, y)
    ortho = paper.orthorectified_in_loops(height, optical_centre, x, y)
    paper.layers(np.where(np.isfinite(ortho), ortho, np.nan), (x[1] - x[0]) / paper.ROWS)
    return paper.cells(ortho, x, y, CELL_M)


def by_opencv_user(scan: ScanInMemory) -> Float:
    """Whole frames, centre of gravity, griddata straight onto the cells, layers by cv2."""
    from scipy.interpolate import griddata

    points, _ = scan_points(scan, opencv_user)
    x, y = area(scan)
    cx, cy = (np.arange(low + CELL_M / 2, high, CELL_M) for low, high in (x, y))
    elevation = griddata(points[:, :2], points[:, 2], tuple(np.meshgrid(cx, cy)), method="linear")
    filled = np.nan_to_num(elevation).astype(np.float32)
    window = np.ones((paper.window_cells(CELL_M), paper.window_cells(CELL_M)), np.uint8)
    cv2.magnitude(cv2.Sobel(filled, cv2.CV_32F, 1, 0), cv2.Sobel(filled, cv2.CV_32F, 0, 1))
    cv2.subtract(cv2.dilate(filled, window), cv2.erode(filled, window))
    return np.asarray(elevation)


def scan_points(scan: ScanInMemory, extract: Extract, one_by_one: bool = False) -> tuple[Float, Float]:
    """Points (n, 3) of all stripes and the camera's optical centre (3,), in base_footprint [m].

    Args:
        scan: frames of one scan.
        extract: gives the row of the stripe in each column.
        one_by_one: intersect ray by ray with the laser plane, as the paper's program does, not all at once.
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
        if one_by_one:
            points = np.array([ray * (-plane[3] / (ray @ plane[:3])) for ray in rays])
        else:
            points = rays * (-plane[3] / (rays @ plane[:3]))[:, None]
        clouds.append(points @ transform[:3, :3].T + transform[:3, 3])
    cloud = np.concatenate(clouds)
    return cloud[(cloud[:, 2] > settings.minimum_height) & (cloud[:, 2] < settings.maximum_height)], transform[:3, 3]


def area(scan: ScanInMemory) -> tuple[tuple[float, float], tuple[float, float]]:
    """Range of x and range of y of the grid in base_footprint [m]."""
    settings = Settings.of(scan.robot)
    return settings.footprint_x, settings.footprint_y
