"""Check of the demo: footholds and grids are compared with the simulated world."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from guara_perception.arrays import Float
from guara_perception.simulation.walk import WalkPause
from guara_perception.simulation.world import World
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.questions.path import PathVerdict
from kinematics.transforms import transform_points

# Required number of hind footholds on scanned ground in a walk of at least WHOLE_WALK_PAUSES pauses. Hind feet reach
# scanned ground after 0.73 m of walking.
HIND_FOOTHOLDS_WANTED = 8
WHOLE_WALK_PAUSES = 41


@dataclass(frozen=True, slots=True)
class CheckedFoothold:
    """Foothold chosen by the planner.

    Attributes:
        step: step of the pause at which the foothold was chosen.
        leg: name of the leg that steps there.
        is_hind: True for a hind leg.
        is_scanned: True if the map contains the cell and at least one scan observed it.
        is_hazard: True if the cell has any flag in the published map or is outside the map.
        is_swing_refused: True if `check_path` rejects the swing to the foothold on the published map.
        height_error: elevation of the map minus the true height [m]; NaN where unknown.
    """

    step: int
    leg: str
    is_hind: bool
    is_scanned: bool
    is_hazard: bool
    is_swing_refused: bool
    height_error: float


@dataclass
class DemoCheck:
    """Footholds, height errors and grid counts of a walk, collected pause by pause.

    Attributes:
        footholds: chosen footholds, except for feet that stay and at the last pause.
        errors: |elevation - truth| of the known cells of each scan, one array per pause [m].
        unknown_called_safe: number of unknown cells marked traversable; must be 0.
        grids_published: number of pauses at which the node published a grid.
        grids_received: number of pauses whose scan grid the planner received.
    """

    footholds: list[CheckedFoothold] = field(default_factory=list)
    errors: list[Float] = field(default_factory=list)
    unknown_called_safe: int = 0
    grids_published: int = 0
    grids_received: int = 0

    def add_grids(self, world: World, pause: WalkPause, *grids: TerrainGrid) -> float:
        """Add the grids of a pause; return the median |height error| of the first [m], NaN if no cell is known."""
        for grid in grids:
            unknown = (np.asarray(grid.hazard) & UNKNOWN_MASK) != 0
            self.unknown_called_safe += int(np.count_nonzero(unknown & (np.asarray(grid.traversability) > 0)))
        terrain = grids[0]
        error = np.abs(np.asarray(terrain.elevation) - true_elevation(world, pause, terrain))
        known = error[np.isfinite(error)].astype(np.float64)
        self.errors.append(known)
        self.grids_published += 1
        return float(np.median(known)) if known.size else float("nan")

    def add_foothold(
        self, world: World, pause: WalkPause, fused: TerrainGrid, leg: str, x: float, y: float, swing: PathVerdict
    ) -> CheckedFoothold:
        """Add the foothold that the planner chose on the fused map of a pause, and the verdict on its swing."""
        iy, ix = fused.geometry.indices(x, y)
        inside = bool(fused.geometry.contains(iy, ix))
        world_x, world_y = pause.to_world(x, y)
        truth = float(world.height(world_x, world_y)) - pause.transform_footprint_to_world[2, 3]
        checked = CheckedFoothold(
            step=pause.step,
            leg=leg,
            is_hind=x < 0,
            is_scanned=inside and bool(np.asarray(fused.looks)[iy, ix] > 0),
            is_hazard=not inside or bool(np.asarray(fused.hazard)[iy, ix] != 0),
            is_swing_refused=not swing.ok,
            height_error=float(fused.height_at(x, y)) - truth,
        )
        self.footholds.append(checked)
        return checked

    def failures(self, pauses_wanted: int) -> list[str]:
        """Failed conditions as text; empty if the check passed."""
        problems = []
        hind = [foot for foot in self.footholds if foot.is_hind and foot.is_scanned]
        on_hazard = [foot for foot in self.footholds if foot.is_hazard]
        if self.grids_published < pauses_wanted:
            problems.append(f"{self.grids_published} of {pauses_wanted} pauses produced a grid")
        if self.grids_received < self.grids_published:
            problems.append(f"the planner received {self.grids_received} of {self.grids_published} grids")
        if pauses_wanted >= WHOLE_WALK_PAUSES and len(hind) < HIND_FOOTHOLDS_WANTED:
            problems.append(f"{len(hind)} hind footholds on scanned ground, at least {HIND_FOOTHOLDS_WANTED} required")
        if on_hazard:
            problems.append(f"footholds on a hazard: {len(on_hazard)}, the first at step {on_hazard[0].step}")
        refused = [foot for foot in self.footholds if foot.is_swing_refused]
        if refused:
            problems.append(f"swings refused by check_path: {len(refused)}, the first at step {refused[0].step}")
        if self.unknown_called_safe:
            problems.append(f"unknown cells called traversable: {self.unknown_called_safe}")
        return problems

    def lines(self) -> list[str]:
        """Results of the walk as lines of text."""
        errors = 1e3 * np.concatenate([np.empty(0), *self.errors])
        under_feet = 1e3 * np.array([foot.height_error for foot in self.footholds if foot.is_scanned])
        declared = sum(not foot.is_scanned for foot in self.footholds)
        front = sum(foot.is_scanned and not foot.is_hind for foot in self.footholds)
        hind = sum(foot.is_scanned and foot.is_hind for foot in self.footholds)
        lines = [
            f"grids: {self.grids_published} published, {self.grids_received} received by the planner",
            f"footholds: {declared} on declared ground, {front} front and {hind} hind on scanned ground, "
            f"{sum(foot.is_hazard for foot in self.footholds)} on a hazard",
            f"swings: {len(self.footholds)} planned, "
            f"{sum(foot.is_swing_refused for foot in self.footholds)} refused by check_path",
            f"unknown cells called traversable: {self.unknown_called_safe}",
        ]
        if errors.size:
            lines.append(
                f"height error of the scans against the world: median {np.median(errors):.2f} mm, "
                f"95 % below {np.percentile(errors, 95):.2f} mm (with joint noise and an IMU error of 0.1 degrees)"
            )
        if under_feet.size:
            lines.append(f"height error of the map under the feet: {np.sqrt(np.nanmean(under_feet**2)):.2f} mm rms")
        return lines


def true_elevation(world: World, pause: WalkPause, grid: TerrainGrid) -> Float:
    """True height (ny, nx) of the ground at every cell centre, in base_footprint of the pause [m]."""
    x, y = np.meshgrid(*grid.geometry.centres())
    points = transform_points(pause.transform_footprint_to_world, np.stack((x, y, np.zeros(grid.shape)), axis=-1))
    # points[..., 2] is the height of the plane z = 0 of base_footprint, which is level in the world up to rounding.
    return np.asarray(world.height(points[..., 0], points[..., 1]) - points[..., 2], dtype=np.float64)
