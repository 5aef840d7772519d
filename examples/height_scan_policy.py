"""Observation of a learned locomotion policy: heights at fixed points ahead of the robot, and a mask of known points.

    python examples/height_scan_policy.py terrain.npz
    python examples/height_scan_policy.py scene.xml      # MuJoCo scene, with the robot in its first keyframe

Unknown heights are never filled in silently: the second channel of the observation is the mask with which the policy
was trained.
"""

import numpy as np

import guara_perception as gp


def observation(terrain: gp.TerrainGrid) -> np.ndarray:
    """Observation (2, 9, 11) float32: heights in base_footprint [m], 0 where unknown; and the mask, 1 where known."""
    x, y = np.meshgrid(np.linspace(0.5, 0.9, 9), np.linspace(-0.25, 0.25, 11), indexing="ij")
    scan = terrain.height_scan(np.column_stack((x.ravel(), y.ravel())))
    heights = np.where(scan.known, scan.heights, 0.0)
    return np.stack((heights, scan.known)).astype(np.float32).reshape(2, 9, 11)


def scene(path: str) -> gp.TerrainGrid:
    """Grid of the ground of a MuJoCo scene, for training with the same observations as on the robot."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return gp.terrain_from_mujoco(model, data)


def main(source: str) -> None:
    """Print the observation of a policy."""
    heights, known = observation(scene(source) if source.endswith(".xml") else gp.load_terrain(source))
    print(f"known: {known.mean():.0%}")
    for row, mask in zip(heights[::-1], known[::-1], strict=True):
        print(" ".join(f"{1e3 * h:4.0f}" if k else "   ?" for h, k in zip(row, mask, strict=True)))


if __name__ == "__main__":
    from arguments import call

    call(main)
