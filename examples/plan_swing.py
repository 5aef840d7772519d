"""The way of a foot from one place to another, over or around what lies between; and a way of your own, checked.

python examples/plan_swing.py terrain.npz
"""

import numpy as np

import guara_perception as gp


def main(grid: str) -> None:
    """Plan a swing between two safe places, then check a straight one 100 mm higher."""
    terrain = gp.load_terrain(grid)
    start = terrain.best_foothold(0.80, 0.00, radius=0.10)
    goal = terrain.best_foothold(0.78, 0.20, radius=0.05)
    if start is None or goal is None:
        print("no safe place to start from or to go to: the foot stays")
        return
    swing = terrain.swing(start.position, goal.position, clearance=0.03)
    if not swing:
        print(f"no way: {'; '.join(map(str, swing.reasons))}")
        return
    print(f"clearance {1e3 * swing.clearance:.0f} mm over {len(swing.points)} corners:")
    for x, y, z in swing.points:
        print(f"  x {x:+.3f}  y {y:+.3f}  z {1e3 * z:5.1f} mm")
    straight = np.array([start.position, goal.position]) + (0.0, 0.0, 0.1)
    print(f"straight, 100 mm up: {terrain.check_path(straight, clearance=0.03)}")


if __name__ == "__main__":
    from arguments import call

    call(main)
