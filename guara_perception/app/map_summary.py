"""Summary of the fused map for slow links, its steppable regions for planners, and conversion to and from messages."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Flags, Float32
from guara_perception.exceptions import UnsafeGrid, errors_as
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard, check_safe, with_neighbours
from guara_perception.terrain.layers.layered_grid import Gridded
from guara_perception.terrain.questions.steppable import SteppableRegion
from kinematics.arrays import read_only
from transport import TerrainMessage
from transport.messages.map_messages import (
    UNKNOWN_HEIGHT,
    RegionMessage,
    RegionsMessage,
    SummaryMessage,
    encode_summary,
    origin_of,
)

# [mm] Largest height above or below zero that the summary can represent.
TALLEST = 32767
# [byte] Largest payload of a summary on any ground: 0.04 Mbit/s with a pause every 3 s. On a simulated walk, summaries
# without merged cells have 8 to 13 kB.
MAXIMUM_BYTES = 16_000
# Fields that a steppable region and its message have in common.
OF_REGION = ("halfspaces", "vertices", "plane", "sigma", "area")
# Integer that stands for traversability 1 in the message.
FULL_SCORE = 255


@dataclass(frozen=True, slots=True, kw_only=True)
class FromMap:
    """Common fields of data derived from the fused map; see `TerrainSummary`."""

    robot: str
    stamp: int = 0
    step: int = 0
    sequence: int = 0
    epoch: str = ""
    is_provisional: bool = False
    stale_because: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TerrainSummary(FromMap, Gridded):
    """Heights rounded to 1 mm, flags and traversability of the fused map, as returned by `TerrainClient.summary`.

    The summary serves display and path planning. Choose footholds on the map itself, which has the sigma of every
    height. The constructor raises UnsafeGrid if the layers violate the safety invariant. Arrays are read-only and of
    shape (ny, nx), a[iy, ix].

    Attributes:
        robot: instance name.
        elevation: height rounded to 1 mm [m], NaN where unknown.
        hazard: flags of `Hazard`: those of the map, and those added by rounding and merging (see `summary_payload`).
        traversability: from 0 (not traversable) to 1 (ideal), rounded down to a multiple of 1/255.
        geometry: origin, resolution and shape.
        frame: "base_footprint".
        stamp: time of the scan [ns since the Unix epoch].
        step: number of the stance pause.
        sequence: number of the summarised map.
        epoch: identity of the walk.
        is_provisional: True until the pause confirms that the robot stood still.
        stale_because: as in `TerrainGrid`.
    """

    elevation: Float32
    hazard: Flags
    traversability: Float32
    geometry: GridGeometry
    frame: str = "base_footprint"

    def __post_init__(self) -> None:
        check_safe(self.elevation, self.hazard, self.traversability)
        for name in ("elevation", "hazard", "traversability"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def summary_payload(terrain: TerrainMessage, maximum: int = MAXIMUM_BYTES) -> bytearray:
    """Encode a summary of a map's message. A value beyond the range of the summary makes its cell unsafe, never safe.

    Heights are rounded to the nearest millimetre, traversability is rounded down. A cell with a height beyond 32.767 m
    becomes unknown (`OUT_OF_RANGE`) and the cells beside it `EDGE`. A free cell with a traversability below 1/255
    becomes `UNCERTAIN`. If the payload is too large, cells are merged (`merged`); `resolution` of the summary states
    their size.

    Args:
        terrain: message of a map.
        maximum: largest payload [byte]; a summary with a single cell may exceed it.
    """
    summary = _with_all_cells(terrain)
    cells, whole = 1, summary
    while len(payload := encode_summary(summary)) > maximum and summary.shape != (1, 1):
        cells *= 2
        summary = merged(whole, cells)
    return payload


def merged(summary: SummaryMessage, cells: int) -> SummaryMessage:
    """Merge the cells of a summary into larger cells, each no safer than the worst cell in it.

    A merged cell has the flags of all its cells, their lowest traversability and their highest height. It is unknown
    if it contains an unknown cell or extends beyond the map; cells beside an unknown cell are `EDGE`.

    Args:
        summary: summary with the original cells.
        cells: number of original cells along the edge of a merged cell.
    """
    ny, nx = summary.shape
    rows, columns = -(-ny // cells), -(-nx // cells)

    def blocks(layer: npt.NDArray[Any], outside: int) -> npt.NDArray[Any]:
        """(rows, columns, cells^2) values of the original cells in each merged cell."""
        whole = np.full((rows * cells, columns * cells), outside, layer.dtype)
        whole[:ny, :nx] = layer
        return whole.reshape(rows, cells, columns, cells).swapaxes(1, 2).reshape(rows, columns, -1)

    hazard = np.bitwise_or.reduce(blocks(summary.hazard, Hazard.UNSCANNED.value), axis=-1)
    unknown = (hazard & UNKNOWN_MASK) != 0
    hazard[with_neighbours(unknown) & ~unknown] |= np.uint16(Hazard.EDGE)
    score = np.where(hazard != 0, 0, blocks(summary.traversability, 0).min(axis=-1))
    heights = np.where(unknown, UNKNOWN_HEIGHT, blocks(summary.heights, UNKNOWN_HEIGHT).max(axis=-1))
    return dataclasses.replace(
        summary,
        resolution=summary.resolution * cells,
        heights=heights.astype(summary.heights.dtype),
        hazard=hazard,
        traversability=score.astype(summary.traversability.dtype),
    )


def _with_all_cells(terrain: TerrainMessage) -> SummaryMessage:
    """Convert a map's message to a summary without merging cells."""
    elevation, score = terrain.layers["elevation"], terrain.layers["traversability"]
    hazard = np.array(terrain.layers["hazard"])
    millimetres = np.rint(elevation.astype(np.float64) * 1e3)
    beyond = np.abs(millimetres) > TALLEST
    if beyond.any():
        hazard[with_neighbours(beyond)] |= np.uint16(Hazard.EDGE)
        hazard[beyond] = np.uint16(Hazard.OUT_OF_RANGE)
    whole_score = np.floor(score.astype(np.float64) * FULL_SCORE).astype(np.uint8)
    hazard[(whole_score == 0) & (hazard == 0)] = np.uint16(Hazard.UNCERTAIN)
    unknown = (hazard & UNKNOWN_MASK) != 0
    whole_score[hazard != 0] = 0
    return SummaryMessage(
        **origin_of(terrain),
        resolution=terrain.resolution,
        origin=terrain.origin,
        heights=np.where(unknown, UNKNOWN_HEIGHT, millimetres).astype("<i2"),
        hazard=hazard.astype("<u2"),
        traversability=whole_score,
    )


def message_to_summary(message: SummaryMessage) -> TerrainSummary:
    """Convert a summary message to a `TerrainSummary`.

    Raises:
        UnsafeGrid: the layers violate the safety invariant, because of a fault in the sender or corruption in transit.
    """
    heights = message.heights.astype(np.float32) * np.float32(1e-3)
    heights[message.heights == UNKNOWN_HEIGHT] = np.nan
    with errors_as(UnsafeGrid, f"summary received from {message.robot!r}, step {message.step}", UnsafeGrid):
        return TerrainSummary(
            elevation=heights,
            hazard=message.hazard.astype(np.uint16),
            traversability=message.traversability.astype(np.float32) / np.float32(FULL_SCORE),
            geometry=GridGeometry(message.origin, message.resolution, message.shape),
            frame=message.frame_id,
            **_source(message),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MapRegions(FromMap):
    """Convex steppable regions of the fused map, as returned by `TerrainClient.regions`.

    Attributes:
        robot: instance name.
        regions: `steppable_regions` of the map, largest first, for no particular leg; in base_footprint of the pause.
        stamp: time of the scan [ns since the Unix epoch].
        step: number of the stance pause.
        sequence: number of the map.
        epoch: identity of the walk.
        is_provisional: True until the pause confirms that the robot stood still.
        stale_because: as in `TerrainGrid`.
    """

    regions: tuple[SteppableRegion, ...]


def regions_message(terrain: TerrainGrid, message: TerrainMessage) -> RegionsMessage:
    """Compute the steppable regions of a map as a message; none if the map is withdrawn.

    Args:
        terrain: the map.
        message: message of the same map.
    """
    regions = () if message.withdrawn else terrain.steppable_regions()
    return RegionsMessage(
        **origin_of(message),
        regions=tuple(RegionMessage(**{name: getattr(region, name) for name in OF_REGION}) for region in regions),
    )


def message_to_regions(message: RegionsMessage) -> MapRegions:
    """Convert a regions message to `MapRegions`."""
    return MapRegions(
        # Nodes of earlier versions send unsorted regions.
        regions=tuple(
            SteppableRegion(**{name: getattr(region, name) for name in OF_REGION}, leg=None)
            for region in sorted(message.regions, key=lambda region: -region.area)
        ),
        **_source(message),
    )


def _source(message: SummaryMessage | RegionsMessage) -> dict[str, Any]:
    """Fields of `FromMap`."""
    names = ("robot", "stamp", "step", "sequence", "epoch", "stale_because")
    return {"is_provisional": message.provisional, **{name: getattr(message, name) for name in names}}
