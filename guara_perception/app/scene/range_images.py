"""Range images of a grid as messages that ROS 2 and viewers read."""

from __future__ import annotations

from typing import Any

import numpy as np

from guara_perception.scanning.pictures import cause_image, sigma_image_mm
from guara_perception.terrain.grid import TerrainGrid
from transport.keys import RANGE_IMAGES
from transport.recording.records import image_message


def range_image_messages(terrain: TerrainGrid) -> dict[str, Any]:
    """Make the sensor_msgs/Image messages of a grid with pictures, by the names of RANGE_IMAGES.

    Heights and standard deviations in m, NaN = unknown; causes as flags of `Hazard`.
    """
    heights = terrain.pictures["ortho_image_mm"] * np.float32(1e-3)
    images = (heights, "32FC1"), (cause_image(terrain), "8UC1"), (sigma_image_mm(terrain) * np.float32(1e-3), "32FC1")
    return {
        name: image_message(pixels, encoding, terrain.frame, terrain.stamp)
        for name, (pixels, encoding) in zip(RANGE_IMAGES, images, strict=True)
    }
