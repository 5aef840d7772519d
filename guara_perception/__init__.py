"""Terrain perception for walking robots from one camera and a swept laser stripe.

Public names are loaded when first used, so that importing the package costs little.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from guara_perception.app.calibrate import calibrate
    from guara_perception.app.client import TerrainClient
    from guara_perception.app.files.open_scan import open_scan
    from guara_perception.app.files.recording import Recording, open_recording
    from guara_perception.app.map_regions import MapRegions
    from guara_perception.app.map_summary import TerrainSummary
    from guara_perception.calibration.calibration import Calibration, CameraModel, StripePlane
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
    from guara_perception.stripes.band import FramePair
    from guara_perception.stripes.extract import extract_stripe
    from guara_perception.stripes.profile import StripeProfile, StripeStatus
    from guara_perception.terrain.compare import GridComparison, compare
    from guara_perception.terrain.file import load_terrain
    from guara_perception.terrain.grid import TerrainGrid
    from guara_perception.terrain.layers.ceiling import Ceiling
    from guara_perception.terrain.layers.hazard import Hazard
    from guara_perception.terrain.layers.reason import Reason
    from guara_perception.terrain.map.known_ground import KnownGround
    from guara_perception.terrain.map.lines_of_sight import LinesOfSight
    from guara_perception.terrain.map.terrain_map import TerrainMap
    from guara_perception.terrain.questions.best_foothold import Foothold
    from guara_perception.terrain.questions.distance_field import DistanceField
    from guara_perception.terrain.questions.foothold import FootholdVerdict, FootholdVerdicts
    from guara_perception.terrain.questions.height_scan import HeightScan
    from guara_perception.terrain.questions.obstacles import Obstacle
    from guara_perception.terrain.questions.path import PathVerdict
    from guara_perception.terrain.questions.stairs import Riser, Stairs, Tread
    from guara_perception.terrain.questions.steppable import SteppableRegion
    from guara_perception.terrain.questions.swing import Swing
    from guara_perception.terrain.scan.assess_terrain import assess_terrain
    from guara_perception.terrain.scan.from_points import terrain_from_points
    from guara_perception.terrain.scan.policy import ScanDecision, ScanPolicy
    from guara_perception.terrain.scan.refined import refined
    from kinematics import KinematicsError, RobotModel, Stance, load_robot
    from transport.exceptions import (
        ConnectionFailed,
        ReceiveTimeout,
        ScanBusy,
        ScanFailed,
        ScannerGone,
        ScannerUnavailable,
        ScanTimeout,
        StaleTerrain,
        TransportError,
    )

# The names stand here in full, and not computed, so that type checkers and editors see them.
__all__ = [
    "Calibration",
    "CalibrationMismatch",
    "CalibrationRefused",
    "CameraModel",
    "Ceiling",
    "ConnectionFailed",
    "DistanceField",
    "Drift",
    "FileFormatError",
    "Foothold",
    "FootholdVerdict",
    "FootholdVerdicts",
    "FramePair",
    "GridComparison",
    "Hazard",
    "HeightScan",
    "InvalidInput",
    "KinematicsError",
    "KnownGround",
    "LinesOfSight",
    "MapRegions",
    "MissingFile",
    "Obstacle",
    "PathVerdict",
    "PerceptionError",
    "Reason",
    "ReceiveTimeout",
    "Recording",
    "Riser",
    "RobotModel",
    "Scan",
    "ScanBusy",
    "ScanDecision",
    "ScanFailed",
    "ScanPolicy",
    "ScanProcessor",
    "ScanStripe",
    "ScanTimeout",
    "ScannerGone",
    "ScannerUnavailable",
    "Stairs",
    "StaleTerrain",
    "Stance",
    "SteppableRegion",
    "StripePlane",
    "StripeProfile",
    "StripeStatus",
    "Swing",
    "TerrainClient",
    "TerrainGrid",
    "TerrainMap",
    "TerrainSummary",
    "TransportError",
    "TraversabilityLimits",
    "Tread",
    "UnsafeGrid",
    "assess_terrain",
    "calibrate",
    "check_drift",
    "compare",
    "extract_stripe",
    "interpolate_pattern",
    "load_calibration",
    "load_robot",
    "load_terrain",
    "open_recording",
    "open_scan",
    "process_scan",
    "refined",
    "save_calibration",
    "terrain_from_points",
]

_MODULES = {
    "Calibration": "guara_perception.calibration.calibration",
    "CalibrationMismatch": "guara_perception.exceptions",
    "CalibrationRefused": "guara_perception.exceptions",
    "CameraModel": "guara_perception.calibration.calibration",
    "Ceiling": "guara_perception.terrain.layers.ceiling",
    "ConnectionFailed": "transport.exceptions",
    "Drift": "guara_perception.calibration.drift",
    "FileFormatError": "guara_perception.exceptions",
    "Foothold": "guara_perception.terrain.questions.best_foothold",
    "FootholdVerdict": "guara_perception.terrain.questions.foothold",
    "FootholdVerdicts": "guara_perception.terrain.questions.foothold",
    "FramePair": "guara_perception.stripes.band",
    "GridComparison": "guara_perception.terrain.compare",
    "Hazard": "guara_perception.terrain.layers.hazard",
    "DistanceField": "guara_perception.terrain.questions.distance_field",
    "HeightScan": "guara_perception.terrain.questions.height_scan",
    "InvalidInput": "guara_perception.exceptions",
    "KinematicsError": "kinematics",
    "KnownGround": "guara_perception.terrain.map.known_ground",
    "LinesOfSight": "guara_perception.terrain.map.lines_of_sight",
    "MapRegions": "guara_perception.app.map_regions",
    "MissingFile": "guara_perception.exceptions",
    "Obstacle": "guara_perception.terrain.questions.obstacles",
    "PathVerdict": "guara_perception.terrain.questions.path",
    "PerceptionError": "guara_perception.exceptions",
    "Reason": "guara_perception.terrain.layers.reason",
    "ReceiveTimeout": "transport.exceptions",
    "Recording": "guara_perception.app.files.recording",
    "Riser": "guara_perception.terrain.questions.stairs",
    "RobotModel": "kinematics",
    "Scan": "guara_perception.scan",
    "ScanBusy": "transport.exceptions",
    "ScanDecision": "guara_perception.terrain.scan.policy",
    "ScanFailed": "transport.exceptions",
    "ScanPolicy": "guara_perception.terrain.scan.policy",
    "ScanProcessor": "guara_perception.scan_processor",
    "ScanStripe": "guara_perception.scan",
    "ScanTimeout": "transport.exceptions",
    "ScannerGone": "transport.exceptions",
    "ScannerUnavailable": "transport.exceptions",
    "Stairs": "guara_perception.terrain.questions.stairs",
    "StaleTerrain": "transport.exceptions",
    "Stance": "kinematics",
    "SteppableRegion": "guara_perception.terrain.questions.steppable",
    "StripePlane": "guara_perception.calibration.calibration",
    "StripeProfile": "guara_perception.stripes.profile",
    "StripeStatus": "guara_perception.stripes.profile",
    "Swing": "guara_perception.terrain.questions.swing",
    "TerrainClient": "guara_perception.app.client",
    "TerrainGrid": "guara_perception.terrain.grid",
    "TerrainMap": "guara_perception.terrain.map.terrain_map",
    "TerrainSummary": "guara_perception.app.map_summary",
    "TransportError": "transport.exceptions",
    "TraversabilityLimits": "guara_perception.settings",
    "Tread": "guara_perception.terrain.questions.stairs",
    "UnsafeGrid": "guara_perception.exceptions",
    "assess_terrain": "guara_perception.terrain.scan.assess_terrain",
    "calibrate": "guara_perception.app.calibrate",
    "check_drift": "guara_perception.calibration.drift",
    "compare": "guara_perception.terrain.compare",
    "extract_stripe": "guara_perception.stripes.extract",
    "interpolate_pattern": "guara_perception.calibration.pattern",
    "load_calibration": "guara_perception.calibration.file",
    "load_robot": "kinematics",
    "load_terrain": "guara_perception.terrain.file",
    "open_recording": "guara_perception.app.files.recording",
    "open_scan": "guara_perception.app.files.open_scan",
    "process_scan": "guara_perception.process",
    "refined": "guara_perception.terrain.scan.refined",
    "save_calibration": "guara_perception.calibration.file",
    "terrain_from_points": "guara_perception.terrain.scan.from_points",
}


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _MODULES:
        raise AttributeError(f"guara_perception has no name {name!r}; it has {', '.join(sorted(_MODULES))}")
    _refuse_hidden_packages()
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names for completion."""
    return sorted([*globals(), *_MODULES])


@functools.cache
def _refuse_hidden_packages() -> None:
    """Raise an error that names the file where a user's file hides a package that this one needs."""
    home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    for package in ("kinematics", "transport"):
        loaded = sys.modules.get(package)
        spec = importlib.util.find_spec(package) if loaded is None else loaded.__spec__
        file = getattr(loaded, "__file__", None) or (None if spec is None else spec.origin)
        if file is not None and not os.path.abspath(file).startswith(os.path.join(home, package) + os.sep):
            raise ImportError(f"{file} is in the way of guara_perception's own package `{package}`: rename that file")
