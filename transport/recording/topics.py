"""Topics of a recording, and the type of each."""

from dataclasses import dataclass
from typing import Final

from transport.keys import check_name
from transport.typestore import (
    COMPRESSED_IMAGE,
    GRID_MAP,
    IMAGE,
    OCCUPANCY,
    STANCE_PAUSE,
    STATUS,
    TERRAIN,
)

SCAN_START: Final = "guara_msgs/msg/ScanStart"
STRIPE: Final = "guara_msgs/msg/Stripe"
SCAN_END: Final = "guara_msgs/msg/ScanEnd"

TYPES: Final = {
    "scan/start": SCAN_START,
    "scan/stripe": STRIPE,
    "scan/end": SCAN_END,
    "camera/on": IMAGE,
    "camera/off": IMAGE,
    "camera/on/compressed": COMPRESSED_IMAGE,
    "camera/off/compressed": COMPRESSED_IMAGE,
    "terrain": TERRAIN,
    "map": TERRAIN,
    "occupancy": OCCUPANCY,
    "grid_map": GRID_MAP,
    "status": STATUS,
    "stance": STANCE_PAUSE,
}
"""Type of each topic, by the part of its name after `/<robot>/`."""

CALIBRATION_NAME: Final = "calibration.json"
"""Name of the attachment that holds the calibration."""


@dataclass(frozen=True, slots=True)
class Topics:
    """Topics of one robot."""

    robot: str

    def __post_init__(self) -> None:
        """Check the name."""
        check_name(self.robot)

    def name(self, part: str) -> str:
        """Full name of a topic, as `/guara/scan/start`; KeyError for one that is not in `TYPES`."""
        if part not in TYPES:
            raise KeyError(part)
        return f"/{self.robot}/{part}"


def part_of(topic: str) -> str:
    """The part of a topic's name after the robot's, empty when it has none."""
    return topic.lstrip("/").partition("/")[2]
