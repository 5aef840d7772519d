"""A view of the rolling map in base_footprint: nearest cell for values, union of the flags of all cells touched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.settings import Settings
from guara_perception.terrain.assess import assess_layers
from guara_perception.terrain.fuse_heights import Drift, drift_variance
from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.hazard import Hazard
from guara_perception.terrain.look import tilt_variance
from guara_perception.terrain.odom_cells import Index, OdomCells
from guara_perception.terrain.touched import touched_places

Float = npt.NDArray[np.float64]

NEVER_SEEN_AGE = 255


@dataclass(frozen=True, slots=True)
class Moment:
    """The pause at which the map is looked at.

    Attributes:
        pause: its number.
        stamp: [ns since the epoch].
        drift: of the odometry.
        transform_footprint_to_odom: (4, 4).
    """

    pause: int
    stamp: int
    drift: Drift
    transform_footprint_to_odom: Float


def snapshot_layers(
    cells: OdomCells, geometry: GridGeometry, terrain: TerrainGrid, now: Moment, settings: Settings
) -> dict[str, npt.NDArray[Any]]:
    """All layers of the `map` extent.

    A cell whose square touches an unknown cell of the map is unknown, with the causes of all of them; lowest and
    highest samples are those of all cells touched, so that no narrow bump slips between the nearest ones.
    """
    x, y = geometry.centres()
    x, y = np.tile(x, y.size), np.repeat(y, x.size)
    transform = now.transform_footprint_to_odom
    row = transform[2]
    drop = row[0] * x + row[1] * y + row[3]
    memory = cells.memory
    in_odom = np.column_stack((x, y)) @ transform[:2, :2].T + transform[:2, 3]
    if np.any(transform[:2, 2]):
        # Where the two verticals differ a cell's height moves it sideways.
        place = cells.places(*cells.cells_of(in_odom[:, 0], in_odom[:, 1]))
        height = np.nan_to_num(np.where(place >= 0, memory["height"][place] - drop, 0.0) / row[2])
        in_odom = in_odom + height[:, None] * transform[:2, 2]
    stale = is_stale(cells, now, settings)
    bottom, top = memory["height"] - memory["below"], memory["height"] + memory["above"]

    flags = np.zeros(x.size, dtype=np.uint16)
    low, high = np.full(x.size, np.inf), np.full(x.size, -np.inf)
    half = 0.5 * geometry.resolution * (abs(transform[0, 0]) + abs(transform[1, 0]))
    for cy, cx in touched_places(_Window(cells), in_odom[:, 0], in_odom[:, 1], half):
        place = cells.places(cy, cx)
        outside = place < 0
        flags |= np.where(outside, np.uint16(Hazard.UNSCANNED), memory["cause"][place])
        flags |= np.where(memory["conflict"][place] & ~outside, np.uint16(Hazard.CONFLICT), 0).astype(np.uint16)
        flags |= np.where(stale[place] & ~outside, np.uint16(Hazard.STALE), 0).astype(np.uint16)
        low, high = np.fmin(low, bottom[place]), np.fmax(high, top[place])

    place = cells.places(*cells.cells_of(in_odom[:, 0], in_odom[:, 1]))
    known = (flags & 0xFF) == 0
    pauses = np.clip(now.pause - memory["pause"][place], 0, NEVER_SEEN_AGE - 1)
    variance = memory["variance"][place] + drift_variance(cells, place, now.drift, np.hypot(x, y))
    # What was seen at this very pause shares its tilt; older heights do not.
    variance += np.where(pauses > 0, tilt_variance(terrain, x, y), 0.0)

    def shaped(values: Float) -> Float:
        return np.where(known, values, np.nan).reshape(geometry.shape)

    layers = assess_layers(
        shaped((memory["height"][place] - drop) / row[2]),
        shaped(variance),
        shaped((low - drop) / row[2]),
        shaped((high - drop) / row[2]),
        flags.reshape(geometry.shape),
        geometry.resolution,
        settings.limits,
    )
    layers["age"] = np.where(known, pauses, NEVER_SEEN_AGE).astype(np.uint8).reshape(geometry.shape)
    layers["looks"] = np.where(known, memory["looks"][place], 0).astype(np.uint8).reshape(geometry.shape)
    return layers


def is_stale(cells: OdomCells, now: Moment, settings: Settings) -> npt.NDArray[np.bool_]:
    """Whether the last look at each cell of the memory is older than its validity, in pauses or in seconds."""
    memory = cells.memory
    seen = np.isfinite(memory["height"])
    old = now.pause - memory["pause"] > settings.validity_pauses
    old |= now.stamp - memory["stamp"] > settings.validity_seconds * 1e9
    return np.asarray(seen & old)


@dataclass(frozen=True, slots=True)
class _Window:
    """The cells of the memory as a grid to ask indices of."""

    cells: OdomCells

    def indices(self, x: Float, y: Float) -> tuple[Index, Index]:
        return self.cells.cells_of(x, y)
