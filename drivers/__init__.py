"""Devices of the rangefinder: USB laser board and cameras, and scans with both.

The package can be used on its own. Real devices, emulated devices (`drivers.emulator`) and cameras that replay frames
have the same interfaces. Importing `drivers` loads no device library; pyusb, OpenCV, linuxpy and Aravis are imported
when they are first needed.
"""

from __future__ import annotations

from drivers.arrays import Image as Image
from drivers.board.board import Board as Board
from drivers.board.board_config import BoardConfig as BoardConfig
from drivers.board.board_records import BoardIdentity as BoardIdentity
from drivers.board.board_records import BoardStatus as BoardStatus
from drivers.board.laser_board import LaserBoard as LaserBoard
from drivers.board.protocol import BoardFault as BoardFault
from drivers.board.protocol import BoardFlag as BoardFlag
from drivers.board.usb_link import UDEV_RULE_FILE as UDEV_RULE_FILE
from drivers.board.usb_link import udev_instructions as udev_instructions
from drivers.board.usb_link import udev_rule as udev_rule
from drivers.cameras.aravis_camera import AravisCamera as AravisCamera
from drivers.cameras.camera import Camera as Camera
from drivers.cameras.camera import CameraSettings as CameraSettings
from drivers.cameras.camera import HeldSettings as HeldSettings
from drivers.cameras.camera import setting_changes as setting_changes
from drivers.cameras.opencv_camera import OpenCvCamera as OpenCvCamera
from drivers.cameras.replay_camera import ReplayCamera as ReplayCamera
from drivers.cameras.v4l2_camera import V4l2Camera as V4l2Camera
from drivers.errors import AcquisitionError as AcquisitionError
from drivers.errors import BoardError as BoardError
from drivers.errors import CameraError as CameraError
from drivers.errors import DriverError as DriverError
from drivers.frame import Frame as Frame
from drivers.sweep.acquisition import StripeStream as StripeStream
from drivers.sweep.acquisition import acquire as acquire
from drivers.sweep.acquisition import prepare as prepare
from drivers.sweep.camera_lag import LagMeasurement as LagMeasurement
from drivers.sweep.camera_lag import measure_lag as measure_lag
from drivers.sweep.capture import ScanReport as ScanReport
from drivers.sweep.capture import StripeCapture as StripeCapture
from drivers.sweep.capture import StripeEvidence as StripeEvidence
from drivers.sweep.capture import StripeVerdict as StripeVerdict
from drivers.sweep.flash_code import draw_code as draw_code
from drivers.sweep.light_check import LightCheck as LightCheck
from drivers.sweep.metering import MeteringResult as MeteringResult
from drivers.sweep.metering import meter_exposure as meter_exposure
from drivers.sweep.options import AcquireOptions as AcquireOptions
from drivers.sweep.options import OffFrames as OffFrames
from drivers.sweep.options import SweepOptions as SweepOptions
from drivers.sweep.proof import ProofLimits as ProofLimits
