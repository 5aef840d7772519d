"""Devices of the rangefinder: the USB laser board, cameras, and scans taken with both.

Usable alone. Real devices, an emulated board at the USB level (`drivers.emulator`) and replayed frames have the
same interface. pyusb and OpenCV are imported when a device is opened.
"""

from __future__ import annotations

from drivers.arrays import Image
from drivers.board.board import Board
from drivers.board.board_config import BoardConfig
from drivers.board.board_records import BoardIdentity, BoardStatus
from drivers.board.laser_board import LaserBoard
from drivers.board.protocol import BoardFault, BoardFlag
from drivers.board.usb_link import UDEV_RULE_FILE, udev_instructions, udev_rule
from drivers.cameras.aravis_camera import AravisCamera
from drivers.cameras.camera import Camera, CameraSettings, HeldSettings, setting_changes
from drivers.cameras.opencv_camera import OpenCvCamera
from drivers.cameras.replay_camera import ReplayCamera
from drivers.cameras.v4l2_camera import V4l2Camera
from drivers.errors import AcquisitionError, BoardError, CameraError, DriverError
from drivers.frame import Frame
from drivers.sweep.acquisition import StripeStream, acquire, prepare
from drivers.sweep.camera_lag import LagMeasurement, measure_lag
from drivers.sweep.capture import ScanReport, StripeCapture, StripeEvidence, StripeVerdict
from drivers.sweep.light_check import LightCheck
from drivers.sweep.metering import MeteringResult, meter_exposure
from drivers.sweep.options import AcquireOptions, OffFrames, SweepOptions
from drivers.sweep.proof import ProofLimits

__all__ = [
    "UDEV_RULE_FILE",
    "AcquireOptions",
    "AcquisitionError",
    "AravisCamera",
    "Board",
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
