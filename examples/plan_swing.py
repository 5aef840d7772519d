"""Swing path of a foot over or around obstacles, and a check of a path of your own.

python examples/plan_swing.py terrain.npz
"""

import numpy as np

import guara_perception as gp


def main(grid: str) -> None:
    """Plan a swing between two safe footholds, then check a straight path 100 mm above them."""
    terrain = gp.load_terrain(grid)
    start = terrain.best_foothold(0.80, 0.00, radius=0.10)
    goal = terrain.best_foothold(0.78, 0.20, radius=0.05)
    if start is None or goal is None:
        print("no safe foothold at the start or at the goal: the foot stays on the ground")
        return
    swing = terrain.swing(start.position, goal.position, clearance=0.03)
    if not swing:
        print(f"no path: {'; '.join(map(str, swing.reasons))}")
        return
    print(f"clearance {1e3 * swing.clearance:.0f} mm over {len(swing.points)} corners:")
    for x, y, z in swing.points:
        print(f"  x {x:+.3f}  y {y:+.3f}  z {1e3 * z:5.1f} mm")
    straight = np.array([start.position, goal.position]) + (0.0, 0.0, 0.1)
    print(f"straight, 100 mm up: {terrain.check_path(straight, clearance=0.03)}")


if __name__ == "__main__":
    from arguments import call

    call(main)
