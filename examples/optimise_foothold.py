"""Choice of a foothold in convex steppable regions by a quadratic program, as in an optimising planner.

python examples/optimise_foothold.py terrain.npz
"""

import numpy as np
from scipy.optimize import minimize

import guara_perception as gp

DESIRED = np.array([0.80, 0.10])
LAST = np.array([0.70, 0.10])
# Weight of the distance from the usual landing point, relative to that of the distance from the desired position.
USUAL_WEIGHT = 0.3
SWING_M = 0.14


def main(grid: str) -> None:
    """Minimise |p - desired|^2 + w |p - last - swing|^2 subject to A p <= b in each region."""
    terrain = gp.load_terrain(grid)
    usual = LAST + (SWING_M, 0.0)
    best: tuple[float, np.ndarray] | None = None
    for region in terrain.steppable_regions():
        normals, offsets = region.halfspaces[:, :2], region.halfspaces[:, 2]
        solved = minimize(
            lambda p: np.sum((p - DESIRED) ** 2) + USUAL_WEIGHT * np.sum((p - usual) ** 2),
            region.centre,
            jac=lambda p: 2 * (p - DESIRED) + 2 * USUAL_WEIGHT * (p - usual),
            constraints={
                "type": "ineq",
                "fun": lambda p, a=normals, b=offsets: b - a @ p,
                "jac": lambda p, a=normals: -a,
            },
            method="SLSQP",
        )
        # A solver satisfies constraints only within a tolerance, so its solution is checked on the grid.
        if solved.success and terrain.check_foothold(*solved.x) and (best is None or solved.fun < best[0]):
            best = solved.fun, solved.x
    if best is None:
        print("no safe foothold: the foot stays on the ground")
        return
    x, y = best[1]
    print(f"foothold x {x:.3f} y {y:.3f} z {1e3 * terrain.height_at(x, y):.1f} mm, cost {1e4 * best[0]:.1f} cm2")
    print(f"desired position: {terrain.check_foothold(*DESIRED)}")


if __name__ == "__main__":
    from arguments import call

    call(main)
