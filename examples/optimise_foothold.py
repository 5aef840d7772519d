"""A quadratic program chooses footholds within convex steppable regions, as an optimising planner does.

python examples/optimise_foothold.py terrain.npz
"""

import numpy as np
from scipy.optimize import minimize

import guara_perception as gp

WISH = np.array([0.80, 0.10])
LAST = np.array([0.70, 0.10])
# Weight of the distance from the usual landing point, where that of the distance from the wish is 1.
USUAL_WEIGHT = 0.3
SWING_M = 0.14


def main(grid: str) -> None:
    """Solve min |p - wish|^2 + w |p - last - swing|^2 with A p <= b, in each region near the wish."""
    terrain = gp.load_terrain(grid)
    usual = LAST + (SWING_M, 0.0)
    best: tuple[float, np.ndarray] | None = None
    for region in terrain.steppable_regions():
        normals, offsets = region.halfspaces[:, :2], region.halfspaces[:, 2]
        solved = minimize(
            lambda p: np.sum((p - WISH) ** 2) + USUAL_WEIGHT * np.sum((p - usual) ** 2),
            region.centre,
            jac=lambda p: 2 * (p - WISH) + 2 * USUAL_WEIGHT * (p - usual),
            constraints={
                "type": "ineq",
                "fun": lambda p, a=normals, b=offsets: b - a @ p,
                "jac": lambda p, a=normals: -a,
            },
            method="SLSQP",
        )
        # Solvers meet their limits only within a tolerance, so the grid is asked about the place that they found.
        if solved.success and terrain.check_foothold(*solved.x) and (best is None or solved.fun < best[0]):
            best = solved.fun, solved.x
    if best is None:
        print("no safe place: the foot stays")
        return
    x, y = best[1]
    print(f"foothold x {x:.3f} y {y:.3f} z {1e3 * terrain.height_at(x, y):.1f} mm, cost {1e4 * best[0]:.1f} cm2")
    print(f"the wish itself: {terrain.check_foothold(*WISH)}")


if __name__ == "__main__":
    from arguments import call

    call(main)
