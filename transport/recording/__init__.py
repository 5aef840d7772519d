"""Scans, grids and the calibration in MCAP files: written while the robot walks, read back, mended when cut."""

from transport.recording.reader import Recording, open_recording
from transport.recording.records import Frame, FrameReference, ScanRecord, StripeRecord
from transport.recording.recover import Recovery, recover_recording
from transport.recording.writer import RecordingWriter

__all__ = [
    "Frame",
    "FrameReference",
    "Recording",
    "RecordingWriter",
    "Recovery",
    "ScanRecord",
    "StripeRecord",
    "open_recording",
    "recover_recording",
]
