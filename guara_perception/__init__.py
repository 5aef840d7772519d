"""Terrain perception for walking robots from one camera and a swept laser stripe.

Public names are loaded when first used, so that importing the package costs little.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from guara_perception.app.calibrate import calibrate
    from guara_perception.app.client import TerrainClient
    from guara_perception.app.files.open_scan import open_scan
    from guara_perception.calibration.calibration import Calibration, StripePlane
    from guara_perception.calibration.camera import CameraModel
    from guara_perception.calibration.drift import Drift, check_drift
    from guara_perception.calibration.file import load_calibration, save_calibration
    from guara_perception.calibration.pattern import interpolate_pattern
    from guara_perception.exceptions import (
        CalibrationMismatch,
        CalibrationRefused,
        FileFormatError,
        InvalidInput,
        MissingFile,
        PerceptionError,
        UnsafeGrid,
    )
    from guara_perception.process import process_scan
    from guara_perception.scan import Scan, ScanStripe
    from guara_perception.scan_processor import ScanProcessor
    from guara_perception.settings import TraversabilityLimits
    from guara_perception.stripes.extract import extract_stripe
    from guara_perception.stripes.profile import StripeProfile, StripeStatus
    from guara_perception.terrain.file import load_terrain
    from guara_perception.terrain.grid import TerrainGrid
    from guara_perception.terrain.layers.hazard import Hazard
    from guara_perception.terrain.layers.reason import Reason
    from guara_perception.terrain.map.known_ground import KnownGround
    from guara_perception.terrain.map.terrain_map import TerrainMap
    from guara_perception.terrain.questions.best_foothold import Foothold
    from guara_perception.terrain.questions.foothold import FootholdVerdict, FootholdVerdicts
    from guara_perception.terrain.questions.obstacles import Obstacle
    from guara_perception.terrain.questions.path import PathVerdict
    from guara_perception.terrain.scan.assess_terrain import assess_terrain
    from guara_perception.terrain.scan.policy import ScanDecision, ScanPolicy
    from guara_perception.terrain.scan.refined import refined
    from transport.exceptions import (
        ScanBusy,
        ScanFailed,
        ScannerGone,
        ScannerUnavailable,
        ScanTimeout,
        StaleTerrain,
    )

_HOME = {
    "Calibration": "calibration.calibration",
    "CalibrationMismatch": "exceptions",
    "CalibrationRefused": "exceptions",
    "CameraModel": "calibration.camera",
    "Drift": "calibration.drift",
    "FileFormatError": "exceptions",
    "Foothold": "terrain.questions.best_foothold",
    "FootholdVerdict": "terrain.questions.foothold",
    "FootholdVerdicts": "terrain.questions.foothold",
    "Hazard": "terrain.layers.hazard",
    "InvalidInput": "exceptions",
    "KnownGround": "terrain.map.known_ground",
    "MissingFile": "exceptions",
    "Obstacle": "terrain.questions.obstacles",
    "PathVerdict": "terrain.questions.path",
    "PerceptionError": "exceptions",
    "Reason": "terrain.layers.reason",
    "Scan": "scan",
    "ScanDecision": "terrain.scan.policy",
    "ScanPolicy": "terrain.scan.policy",
    "ScanProcessor": "scan_processor",
    "ScanStripe": "scan",
    "StripePlane": "calibration.calibration",
    "StripeProfile": "stripes.profile",
    "StripeStatus": "stripes.profile",
    "TerrainClient": "app.client",
    "TerrainGrid": "terrain.grid",
    "TerrainMap": "terrain.map.terrain_map",
    "TraversabilityLimits": "settings",
    "UnsafeGrid": "exceptions",
    "assess_terrain": "terrain.scan.assess_terrain",
    "calibrate": "app.calibrate",
    "check_drift": "calibration.drift",
    "extract_stripe": "stripes.extract",
    "interpolate_pattern": "calibration.pattern",
    "load_calibration": "calibration.file",
    "load_terrain": "terrain.file",
    "open_scan": "app.files.open_scan",
    "process_scan": "process",
    "refined": "terrain.scan.refined",
    "save_calibration": "calibration.file",
}

_TRANSPORT_ERRORS = (
    "ScanBusy",
    "ScanFailed",
    "ScanTimeout",
    "ScannerGone",
    "ScannerUnavailable",
    "StaleTerrain",
)
_MODULES = {name: f"guara_perception.{home}" for name, home in _HOME.items()}
_MODULES.update(dict.fromkeys(_TRANSPORT_ERRORS, "transport.exceptions"))

__all__ = sorted(_MODULES)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _MODULES:
        raise AttributeError(f"guara_perception has no name {name!r}; it has {', '.join(sorted(_MODULES))}")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names for completion."""
    return sorted([*globals(), *_MODULES])
