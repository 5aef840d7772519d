"""`MapRegions`: the convex steppable regions of the fused map as a node sends them, and their message."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.questions.steppable import SteppableRegion
from transport import TerrainMessage
from transport.messages.map_origin import origin_of
from transport.messages.regions_message import RegionMessage, RegionsMessage


@dataclass(frozen=True, slots=True)
class MapRegions:
    """What `TerrainClient.regions` gives: for a planner that optimises, without the map itself.

    Attributes:
        robot: instance name.
        regions: `steppable_regions` of the map, largest first, without a leg's reach; in base_footprint of the pause.
        stamp: time of the scan [ns since the epoch].
        step: number of the stance pause.
        sequence: number of the map that the regions were made from.
        epoch: identity of the walk.
        is_provisional: whether the pause has yet to confirm that the robot stood still.
        stale_because: as in `TerrainGrid`.
    """

    robot: str
    regions: tuple[SteppableRegion, ...]
    stamp: int = 0
    step: int = 0
    sequence: int = 0
    epoch: str = ""
    is_provisional: bool = False
    stale_because: tuple[str, ...] = ()


def regions_message(terrain: TerrainGrid, message: TerrainMessage) -> RegionsMessage:
    """The message of the regions of a map.

    Args:
        terrain: the map.
        message: message of the same map.
    """
    regions = () if message.withdrawn else terrain.steppable_regions()
    return RegionsMessage(
        **origin_of(message),
        regions=tuple(
            RegionMessage(
                halfspaces=region.halfspaces,
                vertices=region.vertices,
                plane=region.plane,
                sigma=region.sigma,
                area=region.area,
            )
            for region in regions
        ),
    )


def message_to_regions(message: RegionsMessage) -> MapRegions:
    """What a message of regions says."""
    return MapRegions(
        robot=message.robot,
        # Nodes of earlier versions send them in the order in which they were found.
        regions=tuple(
            SteppableRegion(r.halfspaces, r.vertices, r.plane, r.sigma, r.area, None)
            for r in sorted(message.regions, key=lambda region: -region.area)
        ),
        stamp=message.stamp,
        step=message.step,
        sequence=message.sequence,
        epoch=message.epoch,
        is_provisional=message.provisional,
        stale_because=message.stale_because,
    )
