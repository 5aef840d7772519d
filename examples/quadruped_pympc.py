"""Footholds for Quadruped-PyMPC, in place of its visual foothold adaptation.

    python examples/quadruped_pympc.py terrain.npz

In a controller whose config has "visual_foothold_adaptation": "height" and "use_foothold_optimization": False
(otherwise the solver moves the given footholds):

    controller.wb_interface.vfa = SafeFootholds(ground, feet_pos)
"""

from collections.abc import Callable
from typing import Any

import numpy as np

import guara_perception as gp

LEGS = ("FL", "FR", "RL", "RR")
# Largest distance of a foothold from its reference.
RADIUS_M = 0.08
# The newest grid, and the transform (4, 4) from the controller's world to the grid's base_footprint.
Ground = Callable[[], tuple[gp.TerrainGrid, np.ndarray]]


class SafeFootholds:
    """Implementation of PyMPC's `VisualFootholdAdaptation` on a terrain grid.

    If there is no safe foothold near the reference of a leg, its foot returns to its last foothold. `refused` names
    such legs: stop walking while it is not empty.
    """

    def __init__(self, ground: Ground, standing: Any) -> None:
        """Start from the positions of the standing feet in the world [m], by leg, to which each foot may return."""
        self.ground = ground
        self.footholds = {leg: np.array(standing[leg], dtype=float) for leg in LEGS}
        self.refused: tuple[str, ...] = ()
        self.initialized = False

    def reset(self) -> None:
        """Prepare for the next swing."""
        self.initialized = False

    def compute_adaptation(self, legs_order: tuple[str, ...], reference_footholds: Any, *_: Any) -> bool:
        """Choose a foothold near each reference (3,) in the world; PyMPC calls this in the middle of a swing."""
        try:
            terrain, transform_world_to_footprint = self.ground()
            found = {
                leg: nearest(terrain, transform_world_to_footprint, reference_footholds[leg]) for leg in legs_order
            }
        except gp.Errors:
            # Without a valid grid, no ground is known to be safe.
            found = dict.fromkeys(legs_order)
        self.refused = tuple(leg for leg in legs_order if found[leg] is None)
        self.footholds |= {leg: place for leg, place in found.items() if place is not None}
        self.initialized = True
        return not self.refused

    def get_footholds_adapted(self, reference_footholds: Any) -> tuple[Any, Any]:
        """Return the footholds, once they are chosen, and no constraints."""
        if self.initialized:
            for leg in LEGS:
                reference_footholds[leg] = self.footholds[leg].copy()
        return reference_footholds, type(reference_footholds)(**dict.fromkeys(LEGS))


def nearest(terrain: gp.TerrainGrid, transform_world_to_footprint: np.ndarray, reference: np.ndarray) -> Any:
    """Best foothold (3,) near a reference, both in the world [m]; None if there is none."""
    rotation, shift = transform_world_to_footprint[:3, :3], transform_world_to_footprint[:3, 3]
    x, y, _ = rotation @ reference + shift
    foothold = terrain.best_foothold(x, y, RADIUS_M)
    return None if foothold is None else rotation.T @ (foothold.position - shift)


def main(grid: str) -> None:
    """Print the footholds for four references."""
    terrain = gp.load_terrain(grid)
    references = {"FL": (0.70, 0.10), "FR": (0.75, -0.10), "RL": (0.80, 0.10), "RR": (0.0, -0.2)}
    asked = {leg: np.array([x, y, 0.0]) for leg, (x, y) in references.items()}
    adaptation = SafeFootholds(lambda: (terrain, np.eye(4)), asked)
    adaptation.compute_adaptation(LEGS, asked)
    footholds, _ = adaptation.get_footholds_adapted(dict(asked))
    for leg in LEGS:
        x, y, z = footholds[leg]
        result = "returns, no safe foothold" if leg in adaptation.refused else f"z {1e3 * z:.1f} mm"
        print(f"{leg}: reference {references[leg]} -> ({x:.3f}, {y:.3f}), {result}")


if __name__ == "__main__":
    from arguments import call

    call(main)
