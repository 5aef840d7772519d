"""Point clouds of other robots in cells of 20 to 30 mm: stairs, free ground, contradicting points (`--maps`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pypcd4 import PointCloud
from scipy.spatial import cKDTree

import guara_perception as gp
from benchmarks.command import Table
from guara_perception.arrays import Array, Float, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.questions.obstacles import fit_plane

CELLS_M = (0.020, 0.025, 0.030)
# Offset of the cells from the points, many of which are on a grid of their own.
ASIDE_M = 0.007
# Neighbours whose plane gives the noise of a cloud, and the places where it is measured.
NEAR_M, PLACES, LEAST_POINTS = 0.05, 2000, 8
UPRIGHT = 0.9
# A region counts as on a tread if its middle is this close to the tread's plane.
ON_TREAD_M = 0.03


def judge_maps(folder: Path) -> None:
    """Print a line for each cloud, size of cells and way to make heights of points.

    A free cell is contradicted if a point under its sole is off the plane of all these points by more than the robot's
    largest rise or fall. "highest" are heights alone, without noise; "all" also says the lowest point of each cell;
    "noise" also how noisy the cloud is.
    """
    table = Table(
        "cloud:<22 | noise mm:8.1f | cell mm:7.1f | heights:<8 | known:>6d | free %:6.1f | contradicted:12d"
        " | steps:<20 | treads with regions:19d"
    )
    for path in sorted(folder.glob("*.pcd")):
        points = PointCloud.from_path(path).numpy(("x", "y", "z")).astype(np.float64)
        points = points[np.isfinite(points).all(axis=1)]
        noise = noise_of(points)
        for cell in CELLS_M:
            for name, terrain in grids(points, noise, cell).items():
                known = int(np.isfinite(terrain.elevation).sum())
                free = terrain.hazard == 0
                contradicted = contradictions(terrain, free, points)
                flight = terrain.stairs()
                steps = " ".join(f"{1e3 * riser.height:.0f}" for riser in flight.risers) if flight else "none"
                stepped = with_regions(terrain, flight) if flight else 0
                share = 100 * int(free.sum()) / known
                table.row(path.stem, 1e3 * noise, 1e3 * cell, name, known, share, contradicted, steps, stepped)


def noise_of(points: Float) -> float:
    """Standard deviation of a cloud about the planes of small level parts of it, the median [m]."""
    tree, found = cKDTree(points), []
    for place in np.random.default_rng(0).choice(len(points), PLACES, replace=False):
        near = points[tree.query_ball_point(points[place], NEAR_M)]
        if len(near) >= LEAST_POINTS:
            _, size, axes = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)
            if abs(axes[2, 2]) > UPRIGHT:
                found.append(size[2] / np.sqrt(len(near) - 3))
    return float(np.median(found))


def grids(points: Float, noise: float, cell: float) -> dict[str, gp.TerrainGrid]:
    """Grids of a cloud by the ways of `judge_maps`."""
    corner = points[:, :2].min(axis=0) - ASIDE_M
    ix, iy = ((points[:, :2] - corner) / cell).astype(int).T
    highest, lowest = (np.full((iy.max() + 1, ix.max() + 1), value) for value in (-np.inf, np.inf))
    np.maximum.at(highest, (iy, ix), points[:, 2])
    np.minimum.at(lowest, (iy, ix), points[:, 2])
    highest[np.isinf(highest)] = np.nan
    origin = (float(corner[0]), float(corner[1]))
    variance = np.full(highest.shape, noise**2)
    return {
        "highest": gp.assess_terrain(highest, cell, origin),
        "all": gp.assess_terrain(highest, cell, origin, lowest=lowest),
        "noise": gp.assess_terrain(highest, cell, origin, variance, lowest=lowest),
    }


def contradictions(terrain: gp.TerrainGrid, free: Mask, points: Float) -> int:
    """Number of the free cells that points under their soles contradict."""
    limits = terrain.record.required_limits
    x, y = terrain.geometry.centres()
    iy, ix = np.nonzero(free)
    centres = np.column_stack((x[ix], y[iy]))
    near = cKDTree(points[:, :2]).query_ball_point(centres, np.hypot(limits.sole_length, limits.sole_width) / 2)
    return sum(_contradicts(points[found] - [*at, 0], limits) for at, found in zip(centres, near, strict=True))


def _contradicts(points: Float, limits: TraversabilityLimits) -> bool:
    """Test whether points about the centre of a sole are too far from one plane."""
    under = (np.abs(points[:, 0]) <= limits.sole_length / 2) & (np.abs(points[:, 1]) <= limits.sole_width / 2)
    x, y, z = points[under].T
    plane = fit_plane(x, y, z)
    if plane is None:
        return bool(z.size and np.ptp(z) > limits.drop)
    off: Array = z - plane[0] * x - plane[1] * y - plane[2]
    return bool(off.max() > limits.step or off.min() < -limits.drop)


def with_regions(terrain: gp.TerrainGrid, flight: gp.Stairs) -> int:
    """Number of the treads on which a steppable region lies."""
    places = [(*region.centre, region.vertices[:, 2].mean()) for region in terrain.steppable_regions()]
    return sum(
        any(
            # No farther from the tread's middle than its cells may be.
            abs(tread.plane @ (x, y, 1.0) - z) < ON_TREAD_M
            and np.hypot(*(tread.centre[:2] - (x, y))) < np.sqrt(tread.area)
            for x, y, z in places
        )
        for tread in flight.treads
    )
