"""Fields shared by the messages made of a fused map: its robot, pause, walk and validity."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from transport.exceptions import VersionError
from transport.keys import check_name
from transport.messages.ranges import check_value
from transport.messages.submessages import finite
from transport.messages.terrain_message import TerrainMessage

VERSION_MAJOR, VERSION_MINOR = 1, 0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MapOrigin:
    """The map that a message is made of.

    Attributes:
        type_name: ROS 2 type of the message.
        robot: instance name.
        sequence: sequence number of the map.
        step: number of the stance pause.
        stamp, scan_end: [ns] since the epoch, as in the map.
        valid_for: [s] after `scan_end`; may be infinite.
        valid_pauses: pauses after `step` for which it may be used.
        run, epoch: identity of the node's run and of the walk; empty when the map has none.
        scan_end_clock: end of the scan by a clock of the node that never jumps [s]; None when the map has none.
        provisional, withdrawn: as in the map.
        frame_id: frame of what the message holds.
        version: (major, minor) of the message.
        stale_because: as in `TerrainMessage`.
    """

    type_name: ClassVar[str]

    robot: str
    sequence: int
    step: int
    stamp: int
    scan_end: int
    valid_for: float
    valid_pauses: int
    run: str = ""
    epoch: str = ""
    scan_end_clock: float | None = None
    provisional: bool = False
    withdrawn: bool = False
    frame_id: str = "base_footprint"
    version: tuple[int, int] = (VERSION_MAJOR, VERSION_MINOR)
    stale_because: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check what others rely on."""
        check_name(self.robot)
        for name in ("valid_for", "run", "epoch"):
            check_value(self.type_name, name, getattr(self, name))
        if self.scan_end_clock is not None:
            finite(self.scan_end_clock, "scan_end_clock")


def origin_of(terrain: TerrainMessage) -> dict[str, Any]:
    """The fields of `MapOrigin`, from the map's own message; the version is that of the new message."""
    return {field.name: getattr(terrain, field.name) for field in fields(MapOrigin) if field.name != "version"}


def check_version(message: Any, name: str, major: int = VERSION_MAJOR) -> None:
    """Refuse a message of another major version.

    Raises:
        VersionError: it is one.
    """
    if message.version_major != major:
        raise VersionError(
            f"{name} of version {message.version_major}.{message.version_minor}; this package speaks version "
            f"{major}: install the node's version here, or this one on the node"
        )
