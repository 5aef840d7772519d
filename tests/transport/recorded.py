"""A recording of scans and grids for the tests that read and mend it."""

from pathlib import Path

import numpy as np

from transport.recording import (
    FrameRecord,
    RecordingWriter,
    ScanRecord,
)

CALIBRATION = b'{"format": "guara-calibration/1"}'


def scan_record(peer, step: int = 3) -> ScanRecord:
    return ScanRecord(
        robot="guara",
        mode="coarse",
        stamp=peer.STAMP + step * 10**9,
        step=step,
        stance=peer.make_stance(),
        calibration_hash="abc",
    )


def make_pictures() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (48, 64, 3)).astype(np.uint8) for _ in range(6)]


def write_recording(path: Path, peer, scans: int = 2, **options: object) -> list[np.ndarray]:
    pictures = make_pictures()
    with RecordingWriter(path, calibration=CALIBRATION, **options) as writer:
        for step in range(scans):
            writer.begin_scan(scan_record(peer, step))
            off = writer.add_frame(FrameRecord(pixels=pictures[0]), laser_on=False)
            for i in range(5):
                on = None if i == 3 else FrameRecord(pixels=pictures[i + 1])
                writer.add_stripe(2 * i, 0.1 * i, on, None if i == 4 else off)
            writer.end_scan(stance_end=peer.make_stance())
            writer.add_terrain(peer.make_terrain(step + 1))
            writer.add_terrain(peer.make_terrain(step + 1, extent="map", shape=(14, 32)))
    return pictures
