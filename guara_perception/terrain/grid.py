"""`TerrainGrid`: one immutable grid of all layers, and the questions planners ask it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.terrain.drawing.plot import describe, describe_as_html, plot
from guara_perception.terrain.layers.ceiling import Ceiling
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.best_foothold import Foothold, best_foothold
from guara_perception.terrain.questions.coarser import coarser
from guara_perception.terrain.questions.distance_field import DistanceField, distance_field
from guara_perception.terrain.questions.explain import explain
from guara_perception.terrain.questions.foothold import FootholdVerdict, FootholdVerdicts, check_foothold
from guara_perception.terrain.questions.height_scan import HeightScan, height_scan
from guara_perception.terrain.questions.normal import normal_at
from guara_perception.terrain.questions.obstacles import Obstacle, obstacles
from guara_perception.terrain.questions.path import PathVerdict, check_path, check_polygon
from guara_perception.terrain.questions.points import points, to_xarray
from guara_perception.terrain.questions.save import save_terrain
from guara_perception.terrain.questions.stairs import Stairs, stairs
from guara_perception.terrain.questions.steppable import SteppableRegion, steppable_region, steppable_regions
from guara_perception.terrain.questions.swing import Swing, swing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from guara_perception.robot_model import RobotLike


# No `slots=True`: dataclasses would then put its own pickling in place of the one inherited.
@dataclass(frozen=True, eq=False, repr=False)
class TerrainGrid(LayeredGrid):
    """Terrain under and before the robot at one stance pause (docs/terrain.md).

    A `LayeredGrid` (see there for attributes and look-ups) that answers questions: each is a module of its own,
    written on the layers, and reached from here.
    """

    __slots__ = ()

    def __repr__(self) -> str:
        """What the grid holds, in three lines of text."""
        return describe(self)

    def _repr_html_(self) -> str:
        """The same with small pictures of heights and hazards, for notebooks."""
        return describe_as_html(self)

    def height_scan(self, points: npt.ArrayLike, frame: str = "base_footprint") -> HeightScan:
        """Heights of the ground under points, as locomotion policies take them, with a mask of what is known.

        Unknown heights are NaN and are never filled: the policy decides what to use instead.

        Args:
            points: (n, 2) or (n, 3) in `frame` [m]; points without z lie in its plane z = 0.
            frame: "base_footprint", or "base_link" by the pose of the pause.

        Raises:
            InvalidInput: points of another shape, an unknown frame, or base_link without the pose in the metadata.
        """
        return height_scan(self, points, frame)

    def distance_field(self, low: float, high: float) -> DistanceField:
        """Signed distance from the ground in voxels of the cells' size, from height `low` to `high` over the grid [m].

        Ground is its highest samples plus confidence; what is unknown, STALE or beside the grid is solid at every
        height. No distance is larger than the true one from that. Computed when asked for, and not kept.

        Raises:
            InvalidInput: heights that are not finite or in the wrong order, over ten million voxels.
        """
        return distance_field(self, low, high)

    def normal_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float:
        """Unit normals (..., 3) of the plane fitted around the cell under each point; NaN where no slope is known."""
        return normal_at(self, x, y)

    @overload
    def check_foothold(
        self, x: float, y: float, leg: str | None = None, robot: RobotLike | None = None
    ) -> FootholdVerdict: ...

    @overload
    def check_foothold(
        self, x: npt.ArrayLike, y: npt.ArrayLike, leg: str | None = None, robot: RobotLike | None = None
    ) -> FootholdVerdicts: ...

    def check_foothold(
        self, x: npt.ArrayLike, y: npt.ArrayLike, leg: str | None = None, robot: RobotLike | None = None
    ) -> FootholdVerdict | FootholdVerdicts:
        """Whether a sole, aligned with x, may be set down centred on each point, and if not, why.

        Args:
            x, y: positions in base_footprint [m].
            leg: also ask whether this leg reaches the place with the body where it stood at the scan.
            robot: model for `leg`; None = the one of the grid's robot name.

        Returns:
            For numbers a FootholdVerdict; for arrays FootholdVerdicts with `ok` and `score` as arrays and each
            place's verdict by index.

        Raises:
            InvalidInput: x and y do not fit together, or the grid's metadata lacks limits, or stance where a leg is
                given.
            kinematics.KinematicsError: no such leg or robot.
        """
        return check_foothold(self, x, y, leg, robot)

    def best_foothold(
        self,
        x: float,
        y: float,
        radius: float,
        leg: str | None = None,
        previous: Foothold | tuple[float, float] | None = None,
        robot: RobotLike | None = None,
    ) -> Foothold | None:
        """The best place for a sole near a wish; None where there is none.

        Every candidate passes `check_foothold`. The value is score times nearness to the wish times clearance; ties go
        to the nearer place, then the smaller x, then the smaller y.

        Args:
            x, y: the wish in base_footprint [m].
            radius: radius of the search [m].
            leg, robot: as in `check_foothold`.
            previous: the last choice, in base_footprint of this grid: kept while it is allowed, within the radius,
                and no other place scores a third more.

        Raises:
            InvalidInput: a value that is not finite, a radius above 1 m; as `check_foothold`.
        """
        return best_foothold(self, x, y, radius, leg, previous, robot)

    def check_path(self, points: npt.ArrayLike, clearance: float, *, ceiling: Ceiling | None = None) -> PathVerdict:
        """Whether a foot may swing, or a part of the body pass, along a path over this terrain.

        Every cell within `clearance` of the path, seen from above, must be known and not STALE. Points with z: the
        path must stay `clearance` away from the ground (highest samples plus confidence; where looks disagree, the
        highest of all looks). Near its ends, where a foot stands, less is required: at a distance d from the nearer end
        at most d - 5 mm - confidence, the clearance that a vertical lift has there. A path that begins at a sole
        that carried the body when the grid was made may begin on unknown ground: what lies wholly under that sole is
        no higher than it. Points without z: a track on the ground, where no cell may be hazardous.

        Args:
            points: (n, 3) or (n, 2) corners of the path in base_footprint [m].
            clearance: distance to keep from the ground [m].
            ceiling: how high unknown ground can be at most (`LinesOfSight`); None refuses a path over unknown ground.
                Not used for tracks on the ground.

        Raises:
            InvalidInput: points of another shape, not finite or over more than 20 m; a clearance outside 0 ... 1 m; a
                ceiling of another grid.
        """
        return check_path(self, points, clearance, ceiling)

    def swing(
        self,
        start: npt.ArrayLike,
        end: npt.ArrayLike,
        clearance: float,
        leg: str | None = None,
        robot: RobotLike | None = None,
        *,
        ceiling: Ceiling | None = None,
    ) -> Swing:
        """A path for a foot from one place to another that `check_path` accepts, or why there is none.

        It leads straight up, over the upper hull of the ground between start and end (highest samples plus confidence
        plus clearance), and straight down; where that is refused, horizontally over the highest point of that
        hull, or some millimetres higher. Where the straight path is barred, by unknown ground for instance, it leads
        around a corner beside it, up to 0.12 m aside.

        Args:
            start, end: (3,) places of the sole's centre on the ground, in base_footprint [m].
            clearance: distance to keep from the ground between the ends [m].
            leg: also ask whether this leg reaches all of the path with the body where it stood at the scan.
            robot: model for `leg`; None = the one of the grid's robot name.
            ceiling: as in `check_path`.

        Raises:
            InvalidInput: as `check_path` and, where a leg is given, as `check_foothold`.
            kinematics.KinematicsError: no such leg or robot.
        """
        return swing(self, start, end, clearance, leg, robot, ceiling)

    def steppable_region(
        self,
        x: float,
        y: float,
        radius: float,
        leg: str | None = None,
        previous: SteppableRegion | None = None,
        robot: RobotLike | None = None,
    ) -> SteppableRegion | None:
        """A convex area of places for a sole around a wish, for planners that optimise; None where there is none.

        It grows from the safe cell nearest to the wish, over ground that lies on one plane to 6 mm. Every point inside
        passes `check_foothold`.

        Args:
            x, y: the wish in base_footprint [m].
            radius: largest distance of the region from the wish along x and y each [m].
            leg, robot: as in `check_foothold`: the leg reaches every point.
            previous: the last choice, in base_footprint of this grid: the region around its centre is kept while that
                is safe and within the radius, and the other one is not a third larger.

        Raises:
            InvalidInput: a value that is not finite, a radius above 1 m; as `check_foothold`.
        """
        return steppable_region(self, x, y, radius, leg, previous, robot)

    def steppable_regions(self, leg: str | None = None, robot: RobotLike | None = None) -> list[SteppableRegion]:
        """Convex areas of places for a sole over the whole grid, the largest first; they may overlap.

        Each is as `steppable_region` gives it, of 4 cm^2 or more; smaller pieces of safe ground are left out.

        Raises:
            InvalidInput: as `check_foothold`, where a leg is given.
        """
        return steppable_regions(self, leg, robot)

    def check_polygon(self, corners: npt.ArrayLike) -> PathVerdict:
        """Whether every cell that a polygon (n, 2) [m] touches is known and free of hazards (EDGE does not count).

        Raises:
            InvalidInput: fewer than three corners, values that are not finite, or an area beyond 20 m.
        """
        return check_polygon(self, corners)

    def explain(self, x: float, y: float) -> str:
        """One sentence: what is known about the ground at a point, and why a foot may or may not go there."""
        return explain(self, x, y)

    def coarser(self, factor: int) -> TerrainGrid:
        """The same terrain in cells `factor` times as long; each holds the worst value of its fine cells.

        One unknown fine cell makes a coarse one unknown; flags are joined, slope, step, roughness, variance and age
        are the largest, score, clearance and looks the smallest.

        Raises:
            InvalidInput: a factor that does not divide the grid; the message lists those that do.
        """
        return coarser(self, factor)

    def obstacles(self) -> list[Obstacle]:
        """Each connected thing that stands 6 mm or more above the floor, or lies as far below, sorted by x, then y.

        The floor is the plane that most of the known heights agree with; unknown ground is no obstacle, but is never
        traversable either.
        """
        return obstacles(self)

    def stairs(self) -> Stairs | None:
        """Stairs of two risers or more, as treads (planes) and risers (edges); None where there are none.

        Treads are level regions of known ground whose heights rise evenly, by 12 mm to 0.3 m each; between each two
        there must be a straight edge, and all edges must be parallel. An edge is where the ground was seen to change,
        to half the gap between what was seen of both treads; where that is over 30 mm wide, it is the upper tread's.
        `check_foothold` decides whether a foot may be set on a tread.
        """
        return stairs(self)

    def save(self, path: str | Path) -> None:
        """Write the grid to an .npz file; `load_terrain` reads it back.

        Raises:
            InvalidInput: the name does not end in .npz.
            MissingFile: the folder does not exist.
        """
        save_terrain(self, path)

    def plot(
        self,
        layer: str = "elevation",
        *,
        hazards: bool = True,
        footholds: Iterable[Any] = (),
        regions: Iterable[Any] = (),
        axes: Axes | None = None,
    ) -> Axes:
        """Draw one layer: x up, y to the left, metres, unknown cells in pale grey.

        Args:
            layer: any layer; "hazard" is drawn in one colour per flag with a legend.
            hazards: veil the cells that are not traversable.
            footholds: places to mark, each a `Foothold` or a pair (x, y) [m].
            regions: areas to outline, each a `SteppableRegion`.
            axes: matplotlib axes to draw on; None makes a figure that a notebook or `plt.show()` shows.

        Raises:
            InvalidInput: no such layer, a foothold without x and y, or a region without vertices.
        """
        return plot(self, layer, hazards=hazards, footholds=footholds, regions=regions, axes=axes)

    def points(self) -> Float:
        """Centres of the known cells with their heights, (n, 3) in base_footprint [m]; unknown cells give none.

        A cell that is known may still be a hazard: `hazard_at(x, y)` says so.
        """
        return points(self)

    def to_xarray(self) -> Any:
        """The layers as an `xarray.Dataset` with coordinates x and y [m].

        Raises:
            MissingExtra: xarray is not installed.
        """
        return to_xarray(self)
