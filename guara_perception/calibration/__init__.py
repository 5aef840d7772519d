"""Calibration: the model, its file, and how it is made from pictures.

Imports `stripes`; `ranging`, `simulation`, `app` and the scan processor use it. It reads and writes its own file only.
"""

from __future__ import annotations

from guara_perception.calibration.calibration import Calibration as Calibration
from guara_perception.calibration.calibration import CameraModel as CameraModel
from guara_perception.calibration.calibration import StripePlane as StripePlane
from guara_perception.calibration.file import load_calibration as load_calibration
from guara_perception.calibration.file import save_calibration as save_calibration
