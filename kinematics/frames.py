"""Names of the frames that are the same for every robot.

Axes follow REP-103 (x forward, y left, z up) but for the optical frame, which is OpenCV's (x image right, y
image down, z optical axis). Frames of one robot (soles, hips, camera, laser) are named in its robot.toml.
"""

from __future__ import annotations

# Straight below the body's origin, z = 0 at the mean of the supporting soles; computed, not in the URDF.
BASE_FOOTPRINT = "base_footprint"

# Continuous from pause to pause; equal to `base_footprint` of the first pause; computed by leg odometry.
ODOM = "odom"
