"""Depth camera in addition to the laser: its point cloud as a grid, and both sensors fused in one map.

    python examples/depth_camera.py terrain.npz

Here the depth image is computed from a grid, as if a camera had viewed that ground; yours comes from its driver. The
other steps are the same for any depth camera, which must provide points in base_footprint, their sigma, and the
position of the camera.
"""

import numpy as np

import guara_perception as gp
from kinematics import PoseInOdom

# Focal length and size of the image [px]; position of the camera [m], which is tilted down by 50 degrees.
FOCAL_PX, SIZE_PX = 110.0, (212, 120)
CENTRE_PX = np.array(SIZE_PX) / 2
CAMERA_IN_FOOTPRINT = np.array([0.42, 0.0, 0.45])
DOWN = np.radians(50)
# Columns: axes of the camera in base_footprint: x (right), y (down) and z (forward).
ROTATION = np.array([[0, -np.sin(DOWN), np.cos(DOWN)], [-1, 0, 0], [0, -np.cos(DOWN), -np.sin(DOWN)]])
CELL_M = 0.005


def depth_image(terrain: gp.TerrainGrid) -> np.ndarray:
    """Depths (120, 212) along the optical axis [m]; NaN without a measurement."""
    seen = (terrain.points() - CAMERA_IN_FOOTPRINT) @ ROTATION
    column, row = np.round(FOCAL_PX * seen[:, :2].T / seen[:, 2] + CENTRE_PX[:, None]).astype(int)
    inside = (column >= 0) & (column < SIZE_PX[0]) & (row >= 0) & (row < SIZE_PX[1])
    depth = np.full(SIZE_PX[::-1], np.inf)
    np.minimum.at(depth, (row[inside], column[inside]), seen[inside, 2])
    return np.where(np.isfinite(depth), depth, np.nan)


def cloud_of(depth: np.ndarray) -> np.ndarray:
    """Points (n, 3) of a depth image in base_footprint [m]."""
    row, column = np.nonzero(np.isfinite(depth))
    z = depth[row, column]
    x, y = (np.column_stack((column, row)) - CENTRE_PX).T * z / FOCAL_PX
    points: np.ndarray = np.column_stack((x, y, z)) @ ROTATION.T + CAMERA_IN_FOOTPRINT
    return points


def main(grid: str) -> None:
    """Fuse a scan and the grid of a depth camera in a map, and print the change."""
    scan = gp.load_terrain(grid)
    points = cloud_of(depth_image(scan))
    # The error of depth cameras grows with the square of the depth. `no_returns` can add rays without a return.
    sigma = 0.002 * np.linalg.norm(points - CAMERA_IN_FOOTPRINT, axis=1) ** 2
    pose = {name: scan.metadata[name] for name in ("stance", "transform_base_to_footprint")}
    depth = gp.terrain_from_points(
        points, sigma, CAMERA_IN_FOOTPRINT, stamp=scan.stamp + 1, step=scan.step + 1, resolution=CELL_M, metadata=pose
    )
    terrain_map = gp.TerrainMap("guara")
    still = PoseInOdom(np.eye(4), 1e-6 * np.eye(6))
    alone = terrain_map.update(scan, still)
    both = terrain_map.update(depth, still)
    print(f"depth camera: {len(points)} points, {np.isfinite(depth.elevation).mean():.0%} of its grid known")
    known = np.isfinite(both.elevation) & (both.looks > 1)
    print(f"observed by both: {known.sum()} cells, {np.count_nonzero(both.hazard & gp.Hazard.CONFLICT)} in conflict")
    moved = np.abs(both.elevation - alone.elevation)[known]
    print(f"median change in height by the second sensor: {1e3 * np.median(moved):.2f} mm")
    names = sorted(gp.Hazard(flag).name or "" for flag in np.unique(depth.hazard) if flag in list(gp.Hazard))
    print(f"flags in the depth camera's grid: {', '.join(names)}")


if __name__ == "__main__":
    from arguments import call

    call(main)
