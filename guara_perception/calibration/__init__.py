"""Calibration of a rangefinder: model, file, and computation from images.

Of the other packages of `guara_perception`, this one imports only `stripes`. `ranging`, `scanning`, `simulation`, `app`
and `ground_picture` import it. It reads and writes only calibration files; images come from the caller.
"""

from __future__ import annotations

from guara_perception.calibration.calibration import Calibration as Calibration
from guara_perception.calibration.calibration import CameraModel as CameraModel
from guara_perception.calibration.calibration import StripePlane as StripePlane
from guara_perception.calibration.file import load_calibration as load_calibration
from guara_perception.calibration.file import save_calibration as save_calibration
