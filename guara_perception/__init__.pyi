"""The public names and where each is: the list from which `__init__.py` loads them, and what type checkers read."""

from guara_perception.all_errors import Errors as Errors
from guara_perception.app.calibrate_folder import calibrate as calibrate
from guara_perception.app.client import TerrainClient as TerrainClient
from guara_perception.app.files.open_scan import open_scan as open_scan
from guara_perception.app.files.recording import Recording as Recording
from guara_perception.app.files.recording import open_recording as open_recording
from guara_perception.app.map_summary import MapRegions as MapRegions
from guara_perception.app.map_summary import TerrainSummary as TerrainSummary
from guara_perception.app.process import process_scan as process_scan
from guara_perception.app.publisher import publish_terrain as publish_terrain
from guara_perception.calibration.calibration import (
    Calibration as Calibration,
)
from guara_perception.calibration.calibration import (
    CameraModel as CameraModel,
)
from guara_perception.calibration.calibration import (
    StripePlane as StripePlane,
)
from guara_perception.calibration.drift import Drift as Drift
from guara_perception.calibration.drift import check_drift as check_drift
from guara_perception.calibration.file import load_calibration as load_calibration
from guara_perception.calibration.file import save_calibration as save_calibration
from guara_perception.calibration.pattern import interpolate_pattern as interpolate_pattern
from guara_perception.exceptions import (
    CalibrationMismatch as CalibrationMismatch,
)
from guara_perception.exceptions import (
    CalibrationRefused as CalibrationRefused,
)
from guara_perception.exceptions import (
    FileFormatError as FileFormatError,
)
from guara_perception.exceptions import (
    InvalidInput as InvalidInput,
)
from guara_perception.exceptions import (
    MissingFile as MissingFile,
)
from guara_perception.exceptions import (
    PerceptionError as PerceptionError,
)
from guara_perception.exceptions import (
    UnsafeGrid as UnsafeGrid,
)
from guara_perception.scan import Scan as Scan
from guara_perception.scan import ScanStripe as ScanStripe
from guara_perception.scanning.scan_processor import ScanProcessor as ScanProcessor
from guara_perception.settings import TraversabilityLimits as TraversabilityLimits
from guara_perception.stripes.band import FramePair as FramePair
from guara_perception.stripes.band import StripeProfile as StripeProfile
from guara_perception.stripes.band import StripeStatus as StripeStatus
from guara_perception.stripes.extract import extract_stripe as extract_stripe
from guara_perception.terrain.compare import GridComparison as GridComparison
from guara_perception.terrain.compare import compare as compare
from guara_perception.terrain.file import load_terrain as load_terrain
from guara_perception.terrain.grid import TerrainGrid as TerrainGrid
from guara_perception.terrain.layers.hazard import Hazard as Hazard
from guara_perception.terrain.layers.record import (
    MapRecord as MapRecord,
)
from guara_perception.terrain.layers.record import (
    ScanRecord as ScanRecord,
)
from guara_perception.terrain.map.known_ground import KnownGround as KnownGround
from guara_perception.terrain.map.terrain_map import TerrainMap as TerrainMap
from guara_perception.terrain.questions.best_foothold import Foothold as Foothold
from guara_perception.terrain.questions.best_foothold import RefusedFoothold as RefusedFoothold
from guara_perception.terrain.questions.distance_field import DistanceField as DistanceField
from guara_perception.terrain.questions.foothold import (
    FootholdVerdict as FootholdVerdict,
)
from guara_perception.terrain.questions.foothold import (
    FootholdVerdicts as FootholdVerdicts,
)
from guara_perception.terrain.questions.obstacles import Obstacle as Obstacle
from guara_perception.terrain.questions.path import PathVerdict as PathVerdict
from guara_perception.terrain.questions.points import HeightScan as HeightScan
from guara_perception.terrain.questions.reason import Reason as Reason
from guara_perception.terrain.questions.stairs import Riser as Riser
from guara_perception.terrain.questions.stairs import Stairs as Stairs
from guara_perception.terrain.questions.stairs import Tread as Tread
from guara_perception.terrain.questions.steppable import SteppableRegion as SteppableRegion
from guara_perception.terrain.questions.swing import Swing as Swing
from guara_perception.terrain.scan.assess_terrain import assess_terrain as assess_terrain
from guara_perception.terrain.scan.from_mujoco import terrain_from_mujoco as terrain_from_mujoco
from guara_perception.terrain.scan.from_points import terrain_from_points as terrain_from_points
from guara_perception.terrain.scan.from_range_image import terrain_from_range_image as terrain_from_range_image
from guara_perception.terrain.scan.policy import ScanDecision as ScanDecision
from guara_perception.terrain.scan.policy import ScanPolicy as ScanPolicy
from guara_perception.terrain.scan.policy import refined as refined
from kinematics import (
    KinematicsError as KinematicsError,
)
from kinematics import (
    RobotModel as RobotModel,
)
from kinematics import (
    Stance as Stance,
)
from kinematics import (
    load_robot as load_robot,
)
from transport.exceptions import (
    ConnectionFailed as ConnectionFailed,
)
from transport.exceptions import (
    ReceiveTimeout as ReceiveTimeout,
)
from transport.exceptions import (
    ScanBusy as ScanBusy,
)
from transport.exceptions import (
    ScanFailed as ScanFailed,
)
from transport.exceptions import (
    ScannerGone as ScannerGone,
)
from transport.exceptions import (
    ScannerUnavailable as ScannerUnavailable,
)
from transport.exceptions import (
    ScanTimeout as ScanTimeout,
)
from transport.exceptions import (
    StaleTerrain as StaleTerrain,
)
from transport.exceptions import (
    TransportError as TransportError,
)
