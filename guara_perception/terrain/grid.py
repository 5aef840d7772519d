"""Immutable terrain grid with all layers, and with queries for planners."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.terrain.drawing.plot import describe, describe_as_html
from guara_perception.terrain.drawing.plot import plot as _plot
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.best_foothold import best_foothold as _best_foothold
from guara_perception.terrain.questions.best_foothold import best_refused as _best_refused
from guara_perception.terrain.questions.distance_field import distance_field as _distance_field
from guara_perception.terrain.questions.foothold import check_foothold as _check_foothold
from guara_perception.terrain.questions.foothold import explain as _explain
from guara_perception.terrain.questions.leg_clearance import leg_clearance as _leg_clearance
from guara_perception.terrain.questions.normal import normal_at as _normal_at
from guara_perception.terrain.questions.obstacles import obstacles as _obstacles
from guara_perception.terrain.questions.path import check_path as _check_path
from guara_perception.terrain.questions.path import check_polygon as _check_polygon
from guara_perception.terrain.questions.path import highest_at as _highest_at
from guara_perception.terrain.questions.points import coarser as _coarser
from guara_perception.terrain.questions.points import height_scan as _height_scan
from guara_perception.terrain.questions.points import points as _points
from guara_perception.terrain.questions.points import to_xarray as _to_xarray
from guara_perception.terrain.questions.save import save_terrain as _save_terrain
from guara_perception.terrain.questions.stairs import stairs as _stairs
from guara_perception.terrain.questions.steppable import steppable_region as _steppable_region
from guara_perception.terrain.questions.steppable import steppable_regions as _steppable_regions
from guara_perception.terrain.questions.swing import swing as _swing


# No `slots=True`: the class adds no fields, so an empty `__slots__` suffices.
@dataclass(frozen=True, eq=False, repr=False)
class TerrainGrid(LayeredGrid):
    """Terrain around the robot: the grid of one scan, or a snapshot of the fused map (docs/terrain.md).

    This is a `LayeredGrid`, which documents attributes and look-ups, with queries for planners as methods. The methods
    are documented where they are defined, in `questions` and `drawing`.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        """Summary in two to four lines."""
        return describe(self)

    def _repr_html_(self) -> str:
        """Summary with small pictures of heights and hazards, for notebooks."""
        return describe_as_html(self)

    height_scan = _height_scan
    distance_field = _distance_field
    normal_at = _normal_at
    check_foothold = _check_foothold
    best_foothold = _best_foothold
    best_refused = _best_refused
    leg_clearance = _leg_clearance
    check_path = _check_path
    highest_at = _highest_at
    swing = _swing
    steppable_region = _steppable_region
    steppable_regions = _steppable_regions
    check_polygon = _check_polygon
    explain = _explain
    coarser = _coarser
    obstacles = _obstacles
    stairs = _stairs
    save = _save_terrain
    plot = _plot
    points = _points
    to_xarray = _to_xarray
