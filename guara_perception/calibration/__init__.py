"""Calibration: the model, its file, and how it is made from pictures.

Imports `stripes`; `ranging`, `simulation`, `app` and the scan processor use it. It reads and writes its own file only.
"""

from __future__ import annotations

from guara_perception.calibration.calibration import Calibration, CameraModel, StripePlane
from guara_perception.calibration.file import load_calibration, save_calibration

__all__ = ["Calibration", "CameraModel", "StripePlane", "load_calibration", "save_calibration"]
