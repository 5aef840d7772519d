"""What the fused map says of itself: where it is, how the feet agree with it, coverage, health; plain JSON values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from guara_perception.arrays import Array, Float
from guara_perception.settings import Settings, limits_to_dict
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, cells_by_flag
from guara_perception.terrain.map.height_anchor import HeightAnchor

# Fields of a scan's metadata that also hold for the map of the same pause.
FROM_SCAN = (
    "robot_description",
    "mode",
    "method",
    "calibration_hash",
    "calibration_verdict",
    "stance",
    "attitude_source",
    "support_feet_used",
    "transform_base_to_footprint",
    "transform_camera_to_base",
    "pose_covariance",
)


def map_report(
    *,
    terrain: TerrainGrid,
    robot: str,
    settings: Settings,
    layers: Mapping[str, Array],
    transform_footprint_to_odom: Float,
    covariance: Float,
    scans: int,
    rejected: int,
    anchor: HeightAnchor,
    residuals: Mapping[str, float | None],
    known_ground: Sequence[Mapping[str, Any]],
    reasons: Sequence[str] = (),
) -> dict[str, Any]:
    """Metadata of a grid of extent "map".

    Args:
        terrain: the scan that was fused last.
        robot: name of the robot.
        settings: settings of the robot.
        layers: layers of the map.
        transform_footprint_to_odom, covariance: pose of this pause and its covariance.
        scans: number of scans fused so far.
        rejected: heights of the last scan that disagreed with the map.
        anchor: filter that holds the walk's height to the map.
        residuals: leg -> height of its sole over the map [m], None where the map does not know the ground there.
        known_ground: patches that were declared, with the number of cells that each filled: all of this pause, and the
            earlier ones that filled any and are not older than the validity.
        reasons: faults of the map, besides those of the scan.
    """
    hazard = np.asarray(layers["hazard"], np.uint16)
    unknown = (hazard & UNKNOWN_MASK) != 0
    all_reasons = [str(reason) for reason in terrain.metadata.get("health", {}).get("reasons", ())]
    all_reasons += reasons
    for leg in anchor.rejected:
        all_reasons.append(
            f"the sole of {leg} stands {1e3 * (residuals.get(leg) or 0.0):+.1f} mm off the map: not used"
        )
    return {
        **{name: terrain.metadata[name] for name in FROM_SCAN if name in terrain.metadata},
        "robot": robot,
        "limits": limits_to_dict(settings.limits),
        "validity_pauses": settings.validity_pauses,
        "validity_seconds": settings.validity_seconds,
        "transform_footprint_to_odom": transform_footprint_to_odom.tolist(),
        "odometry_covariance": covariance.tolist(),
        "scans": scans,
        "disagreeing_cells": rejected,
        "support_residuals": dict(residuals),
        "height_correction": anchor.offset,
        "height_correction_sigma": float(np.sqrt(anchor.variance)),
        "known_ground": [dict(patch) for patch in known_ground],
        "coverage": float((~unknown).mean()),
        "known": float((~unknown).mean()),
        "hazard_cells": cells_by_flag(hazard),
        "health": {"level": "ok" if not all_reasons else "degraded", "reasons": all_reasons},
    }
