"""Planner that fits strides to the ground by a search over the next steps, for instance on stepping stones.

It chooses the leg, its foothold, and a position of the body in which the robot is balanced. It also plans the walks of
`guara demo --course stones` and `python -m benchmarks crossing`. You may copy its source,
`guara_perception/simulation/strides.py`.

python examples/stride_planner.py map.npz
"""

import guara_perception as gp
from guara_perception.simulation.strides import StridePlanner
from kinematics import load_robot


def main(grid: str) -> None:
    """Plan one step on a saved map."""
    terrain = gp.load_terrain(grid)
    stride = StridePlanner(load_robot(terrain.metadata["robot"])).next_stride(terrain)
    if stride is None:
        print("no leg finds a foothold on the way ahead")
        return
    x, y, z = stride.target
    print(f"the body moves by {1e3 * stride.body[0, 3]:+.0f} mm along x, {1e3 * stride.body[1, 3]:+.0f} mm along y")
    print(f"{stride.leg} goes to x {x:+.3f}, y {y:+.3f}, z {z:+.3f} m")


if __name__ == "__main__":
    from arguments import call

    call(main)
