"""Moments of a walk (grids, measurements and plans of a stance pause), and their timeline."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.record import MapRecord, ScanRecord

# Largest number of moments of a live walk in memory; a map takes 2 MB.
KEPT = 60


def pose_of(terrain: TerrainGrid) -> Float:
    """Pose transform_footprint_to_odom (4, 4) of a grid, the identity if absent."""
    placed = getattr(terrain.record, "transform_footprint_to_odom", None)
    return np.eye(4) if placed is None else placed


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """Data of one stance pause.

    Attributes:
        grids: grids by extent, "footprint" and "map"; at least one, all of one pause.
        stripes: function that returns the measured points (n, 3) of each stripe in base_footprint [m], called each
            time they are drawn; None if there are none.
        footholds: planned footholds by leg, (3,) in base_footprint [m].
        picture: function that returns the camera image of one stripe, (h, w) or (h, w, 3) BGR, or None, called whenever
            the moment is drawn; None without images.
    """

    grids: Mapping[str, TerrainGrid]
    stripes: Callable[[], list[Float]] | None = None
    footholds: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    picture: Callable[[], Image | None] | None = None

    @property
    def any_grid(self) -> TerrainGrid:
        """First entry of `grids`, which provides step, record and walk of the moment."""
        return next(iter(self.grids.values()))

    @property
    def step(self) -> int:
        """Number of the pause."""
        return self.any_grid.step

    @property
    def walk(self) -> str:
        """Identifier of the walk; positions in odom are comparable within one walk only."""
        return self.record.epoch or ""

    @property
    def record(self) -> ScanRecord | MapRecord:
        """Record of `any_grid`."""
        return self.any_grid.record

    @property
    def joint_positions(self) -> Mapping[str, float] | None:
        """Joint positions at the pause, None if absent."""
        return None if self.record.stance is None else self.record.stance.joint_positions

    @property
    def transform_base_to_footprint(self) -> Float:
        """Pose (4, 4) of the body in base_footprint, the identity if absent."""
        placed = self.record.transform_base_to_footprint
        return np.eye(4) if placed is None else placed

    @property
    def transform_footprint_to_odom(self) -> Float:
        """Pose (4, 4) of base_footprint in odom, from the map if there is one; the identity if absent."""
        return pose_of(self.grids.get("map", self.any_grid))


class Timeline:
    """Moments in order, one of which is shown.

    While the newest moment is shown, the display moves on to each new moment.

    Attributes:
        number: index of the moment shown, 0 for the first.
    """

    def __init__(self) -> None:
        self._moments: list[Moment] = []
        self.number = 0

    def __len__(self) -> int:
        return len(self._moments)

    @property
    def shown(self) -> Moment | None:
        """Moment shown, None before the first one."""
        return self._moments[self.number] if self._moments else None

    @property
    def is_newest(self) -> bool:
        """True if the newest moment is shown."""
        return self.number >= len(self._moments) - 1

    def replace(self, moments: Sequence[Moment]) -> None:
        """Replace all moments and show the first."""
        self._moments, self.number = list(moments), 0

    def add(self, moment: Moment) -> None:
        """Append a moment, or replace the last one if it is of the same pause; keep the last KEPT moments."""
        follow = self.is_newest
        last = self._moments[-1] if self._moments else None
        if last is not None and (last.step, last.walk) == (moment.step, moment.walk):
            self._moments[-1] = moment
        else:
            self._moments.append(moment)
        while len(self._moments) > KEPT:
            del self._moments[0]
            self.number = max(self.number - 1, 0)
        if follow:
            self.number = len(self._moments) - 1

    def go_to(self, number: int) -> bool:
        """Show the moment with this number, or the nearest; return True if the moment shown changes."""
        before, self.number = self.number, max(0, min(number, len(self._moments) - 1))
        return self.number != before

    def poses(self) -> list[Float]:
        """Poses (4, 4) of base_footprint in odom along the walk of the moment shown, up to that moment."""
        shown = self.shown
        until = self._moments[: self.number + 1]
        return [item.transform_footprint_to_odom for item in until if shown is not None and item.walk == shown.walk]
