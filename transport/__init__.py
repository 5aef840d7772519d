"""Terrain grids, scan requests and stance pauses over Zenoh and in recordings; usable alone."""

from transport.codec import decode, encode
from transport.configuration import DEFAULT_ENDPOINT
from transport.exceptions import (
    ConfigurationError,
    ConnectionFailed,
    KeyNameError,
    MessageError,
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
    VersionError,
)
from transport.grids import grid_map_message, occupancy_message
from transport.keys import DEFAULT_ROBOT
from transport.liveliness import AliveToken, AliveWatcher
from transport.outbox import Outbox
from transport.parts import GroundPatch, ObstacleMessage, StanceMessage, TransformMessage
from transport.publisher import Publisher
from transport.receiver import NewestReceiver, Received
from transport.scan_messages import QueryRequest, Refusal, ScanReply, ScanRequest, ScanState
from transport.session import Session, open_client, open_node
from transport.stance_pause import PausePhase, StancePause, decode_stance_pause, encode_stance_pause
from transport.status_message import Status, StatusItem, decode_status, encode_status
from transport.terrain_codec import decode_terrain, encode_terrain
from transport.terrain_message import LAYERS, Health, TerrainMessage

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
    "NewestReceiver",
    "ObstacleMessage",
    "Outbox",
    "PausePhase",
    "Publisher",
    "QueryRequest",
    "ReceiveTimeout",
    "Received",
    "RecordingError",
    "Refusal",
    "ScanBusy",
    "ScanFailed",
    "ScanReply",
    "ScanRequest",
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
    "Status",
    "StatusItem",
    "TerrainMessage",
    "TransformMessage",
    "TransportError",
    "VersionError",
    "decode",
    "decode_stance_pause",
    "decode_status",
    "decode_terrain",
    "encode",
    "encode_stance_pause",
    "encode_status",
    "encode_terrain",
    "grid_map_message",
    "occupancy_message",
    "open_client",
    "open_node",
]
