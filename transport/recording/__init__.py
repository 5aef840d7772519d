"""Recordings of scans, grids and calibration in MCAP files: writing, reading, and recovery of damaged files.

Of the rest of the package, imports only messages, exceptions, keys and array types; used by the programs that write,
show and replay recordings.
"""

from __future__ import annotations

from transport.recording.reader import Recording as Recording
from transport.recording.reader import open_recording as open_recording
from transport.recording.records import CAMERA_FRAME as CAMERA_FRAME
from transport.recording.records import FlashRecord as FlashRecord
from transport.recording.records import FrameRecord as FrameRecord
from transport.recording.records import FrameReference as FrameReference
from transport.recording.records import ScanRecord as ScanRecord
from transport.recording.records import StripeRecord as StripeRecord
from transport.recording.recover import Recovery as Recovery
from transport.recording.recover import recover_recording as recover_recording
from transport.recording.writer import RecordingWriter as RecordingWriter
