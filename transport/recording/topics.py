"""Topics of a recording, and the type of each."""

from __future__ import annotations

from dataclasses import dataclass

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

SCAN_START = "guara_msgs/msg/ScanStart"
STRIPE = "guara_msgs/msg/Stripe"
SCAN_END = "guara_msgs/msg/ScanEnd"

# Type of each topic by its short name: what follows `/<robot>/`.
TYPES = {
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

# Name of the attachment that holds the calibration.
CALIBRATION_NAME = "calibration.json"


@dataclass(frozen=True, slots=True)
class Topics:
    """Topics of one robot."""

    robot: str

    def __post_init__(self) -> None:
        """Check the name."""
        check_name(self.robot)

    def name(self, short: str) -> str:
        """Full name of a topic, as `/guara/scan/start`; KeyError for one that is not in `TYPES`."""
        if short not in TYPES:
            raise KeyError(short)
        return f"/{self.robot}/{short}"


def short_name(topic: str) -> str:
    """A topic's name without the robot's, empty when nothing follows."""
    return topic.lstrip("/").partition("/")[2]
