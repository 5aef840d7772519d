"""A depth camera beside the laser: its cloud as a grid of the same kind, and both in one map.

    python examples/depth_camera.py terrain.npz

The depth picture is made from the grid here, as if a camera had looked at that ground; yours comes from its driver. The
rest is what any depth camera needs: points in base_footprint, their sigma, where the camera is.
"""

import numpy as np

import guara_perception as gp
from kinematics import PoseInOdom

# Focal length and size of a picture of 212 x 120 pixels [px]; a camera at the nose that looks 50 degrees down.
FOCAL_PX, SIZE_PX = 110.0, (212, 120)
CENTRE_PX = np.array(SIZE_PX) / 2
CAMERA_IN_FOOTPRINT = np.array([0.42, 0.0, 0.45])
DOWN = np.radians(50)
# Columns: the camera's x (right), y (down) and z (ahead) in base_footprint.
ROTATION = np.array([[0, -np.sin(DOWN), np.cos(DOWN)], [-1, 0, 0], [0, -np.cos(DOWN), -np.sin(DOWN)]])
CELL_M = 0.005


def depth_picture(terrain: gp.TerrainGrid) -> np.ndarray:
    """Depths (120, 212) along the optical axis [m], NaN where nothing was measured."""
    seen = (terrain.points() - CAMERA_IN_FOOTPRINT) @ ROTATION
    column, row = np.round(FOCAL_PX * seen[:, :2].T / seen[:, 2] + CENTRE_PX[:, None]).astype(int)
    inside = (column >= 0) & (column < SIZE_PX[0]) & (row >= 0) & (row < SIZE_PX[1])
    depth = np.full(SIZE_PX[::-1], np.inf)
    np.minimum.at(depth, (row[inside], column[inside]), seen[inside, 2])
    return np.where(np.isfinite(depth), depth, np.nan)


def cloud_of(depth: np.ndarray) -> np.ndarray:
    """The picture's points (n, 3) in base_footprint [m]."""
    row, column = np.nonzero(np.isfinite(depth))
    z = depth[row, column]
    x, y = (np.column_stack((column, row)) - CENTRE_PX).T * z / FOCAL_PX
    points: np.ndarray = np.column_stack((x, y, z)) @ ROTATION.T + CAMERA_IN_FOOTPRINT
    return points


def main(grid: str) -> None:
    """A map of the scan alone, and one with the depth camera's grid in it."""
    scan = gp.load_terrain(grid)
    points = cloud_of(depth_picture(scan))
    # Depth cameras err with the square of the depth; `no_returns` would name the directions without a return.
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
    print(f"seen by both: {known.sum()} cells, {np.count_nonzero(both.hazard & gp.Hazard.CONFLICT)} in conflict")
    moved = np.abs(both.elevation - alone.elevation)[known]
    print(f"heights moved by {1e3 * np.median(moved):.2f} mm (median) when the second sensor came in")
    names = sorted(gp.Hazard(flag).name or "" for flag in np.unique(depth.hazard) if flag in list(gp.Hazard))
    print(f"flags of its cells: {', '.join(names)}")


if __name__ == "__main__":
    from arguments import call

    call(main)
