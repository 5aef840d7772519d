"""Stereo and optical flow by OpenCV compared with the laser stripe, on the same simulated scene.

`python -m benchmarks passive [--small]`. The stereo pair is exactly rectified, the flow is between pictures
of two pauses 35 mm apart, with the true poses: what a real pair or odometry adds is left out. Error is that of 5 mm
cells away from edges; known counts these cells. Memory is what the process grew by at its peak.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.rounds import peak_growth, timed
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from testbed.gravel_scene import SIZES, Scene, rays, truth

# Distance of the two cameras, and of two pauses of the gait [m].
BASELINE_M, STEP_M = 0.060, 0.035
BLOCK = 5
DISPARITIES = 96


def stereo(scene: Scene) -> Callable[[], Float]:
    """Semi-global matching of two cameras side by side."""
    left, right = (scene.picture(side * scene.camera[:3, 0] * BASELINE_M) for side in (0, 1))
    focal = float(scene.calibration.camera.matrix[0, 0])
    scale = left.shape[1] // 640

    def compute() -> Float:
        matcher = cv2.StereoSGBM.create(
            minDisparity=16 * scale,
            numDisparities=DISPARITIES * scale,
            blockSize=BLOCK,
            P1=8 * BLOCK**2,
            P2=32 * BLOCK**2,
            disp12MaxDiff=1,
            uniquenessRatio=10,
            speckleWindowSize=100,
            speckleRange=2,
        )
        disparity = matcher.compute(left, right).astype(np.float64) / 16
        rows, columns = np.nonzero(disparity > 16 * scale)
        return scene.heights(rays(scene, columns, rows) * (focal * BASELINE_M / disparity[rows, columns])[:, None])

    return compute


def flow(scene: Scene) -> Callable[[], Float]:
    """Dense inverse search between the pictures of two pauses, triangulated with the true motion."""
    offset = np.array([STEP_M, 0.0, 0.0])
    first, second = scene.picture(np.zeros(3)), scene.picture(offset)
    motion = scene.camera[:3, :3].T @ offset

    def compute() -> Float:
        moved, back = (
            cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(
                *pair, np.zeros((*first.shape, 2), np.float32)
            )
            for pair in ((first, second), (second, first))
        )
        rows, columns = (each.ravel() for each in np.indices(first.shape))
        to = np.column_stack((columns, rows)) + moved.reshape(-1, 2)
        target = to.reshape(*first.shape, 2).astype(np.float32)
        returned = cv2.remap(back, target, np.empty(0, np.float32), cv2.INTER_LINEAR)
        agrees = np.abs(moved.reshape(-1, 2) + returned.reshape(-1, 2)).max(axis=1) < 1.0
        a, b = rays(scene, columns, rows)[agrees], rays(scene, to[:, 0], to[:, 1])[agrees]
        # The point a s of the first ray that is nearest to the second, motion + b t.
        aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
        depth = (bb * (a @ motion) - ab * (b @ motion)) / np.maximum(aa * bb - ab**2, 1e-12)
        return scene.heights(a * depth[:, None])

    return compute


def laser(scene: Scene, method: str) -> Callable[[], Float]:
    """The scan of this project."""
    frames = scene.frames(np.zeros(3), Settings.of(scene.robot).pattern(scene.mode))

    def compute() -> Float:
        processor = gp.ScanProcessor(scene.calibration, scene.robot, scene.stance, scene.mode, method=method)
        for index, on, off in frames:
            processor.add(index, on, off)
        return np.asarray(processor.finish().elevation, np.float64)

    return compute


WAYS: dict[str, Callable[[Scene], Callable[[], Float]]] = {
    "precise": partial(laser, method="precise"),
    "paper": partial(laser, method="paper"),
    "paper-literal-ortho": partial(laser, method="paper-literal-ortho"),
    "stereo, SGBM, 60 mm": stereo,
    "flow, DIS, 35 mm": flow,
}


def measured(way: str, size: tuple[int, int]) -> tuple[Float, float, float]:
    """Heights, processor time [ms] and memory [MB] of one way."""
    cv2.setNumThreads(1)
    compute = WAYS[way](Scene(size))
    (heights, seconds), megabytes = peak_growth(partial(timed, compute))
    return heights, 1e3 * seconds, megabytes


def main() -> None:
    """Command line."""
    asked = options(__doc__, small=(False, "only pictures of 640 x 512"))
    head = "picture: | way: | mean mm:.2f | 95 % mm:.1f | known %:.1f | processor ms:.0f | memory MB:.0f"
    table = Table(head, markdown=True)
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        for size in list(SIZES)[: 1 if asked.small else None]:
            true, flat = truth(Scene(size))
            for way in WAYS:
                heights, milliseconds, megabytes = pool.apply(measured, (way, size))
                known = flat & np.isfinite(heights)
                error = 1e3 * np.abs(heights - true.elevation)[known]
                errors = error.mean(), np.percentile(error, 95), 100 * known.sum() / flat.sum()
                table.row(f"{size[0]} x {size[1]}", way, *errors, milliseconds, megabytes)


if __name__ == "__main__":
    main()
