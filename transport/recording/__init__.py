"""Scans, grids and the calibration in MCAP files: written while the robot walks, read back, mended when cut.

Imported by the programs that write, show and replay them; it imports the messages.
"""

from __future__ import annotations

from transport.recording.reader import Recording, open_recording
from transport.recording.records import CAMERA_FRAME, FrameRecord, FrameReference, ScanRecord, StripeRecord
from transport.recording.recover import Recovery, recover_recording
from transport.recording.writer import RecordingWriter

__all__ = [
    "CAMERA_FRAME",
    "FrameRecord",
    "FrameReference",
    "Recording",
    "RecordingWriter",
    "Recovery",
    "ScanRecord",
    "StripeRecord",
    "open_recording",
    "recover_recording",
]
