"""Devices of the rangefinder: the USB laser board, cameras, and scans taken with both.

Usable alone. Real devices, an emulated board at the USB level (`drivers.emulator`) and replayed frames have the
same interface. pyusb and OpenCV are imported when a device is opened.
"""

from __future__ import annotations

from drivers.acquisition import StripeStream, acquire, prepare
from drivers.aravis_camera import AravisCamera
from drivers.arrays import Image
from drivers.board import LaserBoard
from drivers.board_config import BoardConfig
from drivers.camera import Camera, CameraSettings, HeldSettings
from drivers.camera_lag import LagMeasurement, measure_lag
from drivers.capture import ScanReport, StripeCapture, StripeEvidence, StripeVerdict
from drivers.errors import AcquisitionError, BoardError, CameraError, DriverError
from drivers.frame import Frame
from drivers.light_check import LightCheck
from drivers.metering import MeteringResult, meter_exposure
from drivers.opencv_camera import OpenCvCamera
from drivers.options import AcquireOptions, OffFrames
from drivers.proof import ProofLimits
from drivers.protocol import BoardFault, BoardFlag
from drivers.records import BoardIdentity, BoardStatus
from drivers.replay_camera import ReplayCamera
from drivers.setting_changes import setting_changes
from drivers.sweep_options import SweepOptions
from drivers.udev import UDEV_RULE_FILE, udev_instructions, udev_rule
from drivers.v4l2_camera import V4l2Camera

__all__ = [
    "UDEV_RULE_FILE",
    "AcquireOptions",
    "AcquisitionError",
    "AravisCamera",
    "BoardConfig",
    "BoardError",
    "BoardFault",
    "BoardFlag",
    "BoardIdentity",
    "BoardStatus",
    "Camera",
    "CameraError",
    "CameraSettings",
    "DriverError",
    "Frame",
    "HeldSettings",
    "Image",
    "LagMeasurement",
    "LaserBoard",
    "LightCheck",
    "MeteringResult",
    "OffFrames",
    "OpenCvCamera",
    "ProofLimits",
    "ReplayCamera",
    "ScanReport",
    "StripeCapture",
    "StripeEvidence",
    "StripeStream",
    "StripeVerdict",
    "SweepOptions",
    "V4l2Camera",
    "acquire",
    "measure_lag",
    "meter_exposure",
    "prepare",
    "setting_changes",
    "udev_instructions",
    "udev_rule",
]
