"""Calibration of a rangefinder: model, file, and computation from images.

This package imports `stripes`; `ranging`, `simulation`, `app` and the scan processor use it. The only file that it
reads and writes is the calibration.
"""

from __future__ import annotations

from guara_perception.calibration.calibration import Calibration as Calibration
from guara_perception.calibration.calibration import CameraModel as CameraModel
from guara_perception.calibration.calibration import StripePlane as StripePlane
from guara_perception.calibration.file import load_calibration as load_calibration
from guara_perception.calibration.file import save_calibration as save_calibration
