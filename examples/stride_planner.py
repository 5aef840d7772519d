"""A planner that fits its strides to the ground: a small search over the next steps, so that feet land on stones.

`guara demo --course stones` walks with it; its source, `guara_perception/simulation/strides.py`, is there to be copied.

python examples/stride_planner.py map.npz lf
"""

import guara_perception as gp
from guara_perception.simulation.strides import StridePlanner
from kinematics import load_robot


def main(grid: str, leg: str) -> None:
    """Plan one step on a saved map."""
    terrain = gp.load_terrain(grid)
    stride = StridePlanner(load_robot(terrain.metadata["robot"])).next_stride(terrain, leg)
    print(f"the body advances by {round(1e3 * stride.advance):+d} mm")
    if stride.swing is None:
        print(f"{leg} stays where it is")
    else:
        x, y, z = stride.swing.points[-1]
        print(f"{leg} goes to x {x:+.3f}, y {y:+.3f}, z {z:+.3f} m")


if __name__ == "__main__":
    from arguments import call

    call(main)
