"""Terrain grids, scan requests and stance pauses over Zenoh and in recordings; usable alone."""

from __future__ import annotations

from transport.client import PerceptionClient
from transport.configuration import DEFAULT_ENDPOINT
from transport.exceptions import (
    ConfigurationError,
    ConnectionFailed,
    KeyNameError,
    MessageError,
    NameTaken,
    ReceiveTimeout,
    RecordingError,
    ScanBusy,
    ScanFailed,
    ScannerGone,
    ScannerUnavailable,
    ScanTimeout,
    SecurityError,
    SessionClosed,
    StaleTerrain,
    TransportError,
    UnknownPhase,
    VersionError,
)
from transport.keys import DEFAULT_ROBOT
from transport.links.liveliness import AliveToken, AliveWatcher
from transport.links.outbox import Outbox
from transport.links.publisher import Publisher
from transport.links.received import Received
from transport.links.receiver import NewestReceiver
from transport.links.ros2 import Ros2Mirror
from transport.links.session import Session, open_client, open_node
from transport.messages.camera_info import camera_info_message
from transport.messages.codec import decode, encode
from transport.messages.frames import frames_message
from transport.messages.grids import grid_map_message, occupancy_message
from transport.messages.markers import markers_message
from transport.messages.point_cloud import point_cloud_message
from transport.messages.scan_messages import QueryRequest, Refusal, ScanReply, ScanRequest, ScanState
from transport.messages.stance_pause import PausePhase, StancePause, decode_stance_pause, encode_stance_pause
from transport.messages.status_message import Status, StatusItem, decode_status, encode_status
from transport.messages.submessages import GroundPatch, ObstacleMessage, StanceMessage, TransformMessage
from transport.messages.terrain_codec import decode_terrain, encode_terrain
from transport.messages.terrain_message import LAYERS, Health, TerrainMessage
from transport.messages.text import text_message
from transport.queries.query import QueryServer, query_terrain
from transport.queries.scan_client import request_scan
from transport.queries.scan_server import ScanJob, ScanServer
from transport.queries.status_reporter import StatusReporter
from transport.security.folder import init_security
from transport.security_check import Permission, check_security, format_matrix
from transport.server import PerceptionServer
from transport.stance_link import StancePublisher, StanceReceiver

__all__ = [
    "DEFAULT_ENDPOINT",
    "DEFAULT_ROBOT",
    "LAYERS",
    "AliveToken",
    "AliveWatcher",
    "ConfigurationError",
    "ConnectionFailed",
    "GroundPatch",
    "Health",
    "KeyNameError",
    "MessageError",
    "NameTaken",
    "NewestReceiver",
    "ObstacleMessage",
    "Outbox",
    "PausePhase",
    "PerceptionClient",
    "PerceptionServer",
    "Permission",
    "Publisher",
    "QueryRequest",
    "QueryServer",
    "ReceiveTimeout",
    "Received",
    "RecordingError",
    "Refusal",
    "Ros2Mirror",
    "ScanBusy",
    "ScanFailed",
    "ScanJob",
    "ScanReply",
    "ScanRequest",
    "ScanServer",
    "ScanState",
    "ScanTimeout",
    "ScannerGone",
    "ScannerUnavailable",
    "SecurityError",
    "Session",
    "SessionClosed",
    "StaleTerrain",
    "StanceMessage",
    "StancePause",
    "StancePublisher",
    "StanceReceiver",
    "Status",
    "StatusItem",
    "StatusReporter",
    "TerrainMessage",
    "TransformMessage",
    "TransportError",
    "UnknownPhase",
    "VersionError",
    "camera_info_message",
    "check_security",
    "decode",
    "decode_stance_pause",
    "decode_status",
    "decode_terrain",
    "encode",
    "encode_stance_pause",
    "encode_status",
    "encode_terrain",
    "format_matrix",
    "frames_message",
    "grid_map_message",
    "init_security",
    "markers_message",
    "occupancy_message",
    "open_client",
    "open_node",
    "point_cloud_message",
    "query_terrain",
    "request_scan",
    "text_message",
]
