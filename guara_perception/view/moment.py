"""One moment to look at, with grids, measurements and plans of a stance pause; and the moments of a walk in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.record import MapRecord, ScanRecord

# Pauses of a live walk that are kept: a map is 2 MB.
KEPT = 60


def no_stripes() -> list[Float]:
    """No measured points are available."""
    return []


def no_picture() -> Image | None:
    """The camera's picture is not available."""
    return None


def pose_of(terrain: TerrainGrid) -> Float:
    """transform_footprint_to_odom (4, 4) of a grid, the identity where it does not say."""
    placed = getattr(terrain.record, "transform_footprint_to_odom", None)
    return np.eye(4) if placed is None else placed


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One stance pause.

    Attributes:
        grids: grids by extent, "footprint" and "map"; at least one, all of one pause.
        stripes: gives the measured points (n, 3) of each stripe in base_footprint [m]; called when first shown.
        footholds: planned footholds by leg, (3,) in base_footprint [m].
        picture: gives what the camera saw of one stripe, (h, w) or (h, w, 3) BGR; called when first shown.
    """

    grids: Mapping[str, TerrainGrid]
    stripes: Callable[[], list[Float]] = no_stripes
    footholds: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    picture: Callable[[], Image | None] = no_picture

    @property
    def any_grid(self) -> TerrainGrid:
        """The scan where it is there, else the map."""
        return next(iter(self.grids.values()))

    @property
    def step(self) -> int:
        """Number of the pause."""
        return self.any_grid.step

    @property
    def walk(self) -> str:
        """Identity of the walk: only within one walk can positions in odom be compared."""
        return self.record.epoch or ""

    @property
    def record(self) -> ScanRecord | MapRecord:
        """The record of that grid."""
        return self.any_grid.record

    @property
    def joint_positions(self) -> Mapping[str, float] | None:
        """Joints at the pause, None where the grid does not say."""
        return None if self.record.stance is None else self.record.stance.joint_positions

    @property
    def transform_base_to_footprint(self) -> Float:
        """(4, 4), the identity where the grid does not say."""
        placed = self.record.transform_base_to_footprint
        return np.eye(4) if placed is None else placed

    @property
    def transform_footprint_to_odom(self) -> Float:
        """(4, 4) as the map says; the identity where it does not."""
        return pose_of(self.grids.get("map", self.any_grid))


class Timeline:
    """Moments in order and the number of the moment that is shown; while that is the newest, a newer one is shown."""

    def __init__(self) -> None:
        self._moments: list[Moment] = []
        self.number = 0

    def __len__(self) -> int:
        return len(self._moments)

    @property
    def shown(self) -> Moment | None:
        """The moment that is shown, None before the first."""
        return self._moments[self.number] if self._moments else None

    @property
    def is_newest(self) -> bool:
        """Whether the newest is shown."""
        return self.number >= len(self._moments) - 1

    def replace(self, moments: Sequence[Moment]) -> None:
        """Take other moments and begin with the first."""
        self._moments, self.number = list(moments), 0

    def add(self, moment: Moment) -> None:
        """Add the newest moment; it replaces the one before if it is of the same pause."""
        follow = self.is_newest
        last = self._moments[-1] if self._moments else None
        if last is not None and (last.step, last.walk) == (moment.step, moment.walk):
            self._moments[-1] = moment
        else:
            self._moments.append(moment)
        if len(self._moments) > KEPT:
            del self._moments[0]
            self.number = max(self.number - 1, 0)
        if follow:
            self.number = len(self._moments) - 1

    def go_to(self, number: int) -> bool:
        """Show the moment of this number, or the nearest to it; return whether another moment is now shown."""
        before, self.number = self.number, max(0, min(number, len(self._moments) - 1))
        return self.number != before

    def poses(self) -> list[Float]:
        """Poses (4, 4) of base_footprint in odom, of this walk up to the moment that is shown."""
        shown = self.shown
        until = self._moments[: self.number + 1]
        return [item.transform_footprint_to_odom for item in until if shown is not None and item.walk == shown.walk]
