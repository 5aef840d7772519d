"""Recordings that were cut, damaged or never finished: what was acknowledged survives, the rest is reported."""

from pathlib import Path

import numpy as np
import pytest

from tests.transport.recorded import CALIBRATION, scan_record, write_recording
from transport import RecordingError
from transport.recording import (
    RecordingWriter,
    open_recording,
    recover_recording,
)


def test_what_was_acknowledged_survives_a_kill(tmp_path: Path, start) -> None:
    """After kill -9 in the middle of writing, every scan and grid that was acknowledged is recovered."""
    for round_number in range(3):
        path, mended = tmp_path / f"{round_number}.mcap", tmp_path / f"{round_number}-mended.mcap"
        process = start("record", str(path))
        process.expect(f"acknowledged {3 + 4 * round_number}")
        process.kill()
        process.wait()
        acknowledged = int(process.lines[-1].split()[1]) if process.lines[-1].count(" ") else -1
        with pytest.raises(RecordingError, match="guara convert"):
            open_recording(path)
        recovery = recover_recording(path, mended)
        assert not recovery.was_whole
        with open_recording(mended) as recording:
            whole = [scan.step for scan in recording.scans if scan.is_whole]
            assert whole[: acknowledged + 1] == list(range(acknowledged + 1)) and acknowledged >= 3
            assert recording.calibration == CALIBRATION
            sequences = [terrain.sequence for terrain in recording.terrains()]
            assert sequences[: acknowledged + 1] == list(range(1, acknowledged + 2))
            last = recording.scans[acknowledged].stripes[3]
            assert recording.frame(last.on).pixels[0, 0] == 3


@pytest.mark.slow
def test_a_cut_file_is_mended_wherever_it_was_cut(tmp_path: Path, peer) -> None:
    """Any cut gives either what came before it, or an error that says that the file is no recording."""
    write_recording(tmp_path / "a.mcap", peer, scans=3)
    data = (tmp_path / "a.mcap").read_bytes()
    counts = []
    for number, length in enumerate(np.linspace(0, len(data) - 1, 40).astype(int)):
        cut, mended = tmp_path / f"{number}.cut", tmp_path / f"{number}.mcap"
        cut.write_bytes(data[:length])
        try:
            counts.append(recover_recording(cut, mended).messages)
        except RecordingError as error:
            assert "is not an MCAP file" in str(error) and length < 100
            assert not mended.exists()
            continue
        with open_recording(mended) as recording:
            assert all(scan.is_whole for scan in recording.scans[:-1])
            for scan in recording.scans:
                for stripe in scan.stripes:
                    assert stripe.on is None or recording.frame(stripe.on).pixels.shape == (48, 64, 3)
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] == 3 * 14


def test_a_damaged_piece_is_left_out_and_reported(tmp_path: Path, peer) -> None:
    """A damaged byte inside a chunk costs that chunk, not the file, and reading the file itself says so."""
    write_recording(tmp_path / "a.mcap", peer, scans=3)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "b.mcap").write_bytes(bytes(data))
    recovery = recover_recording(tmp_path / "b.mcap", tmp_path / "c.mcap")
    assert recovery.damaged_chunks == 1 and not recovery.was_whole and 0 < recovery.messages < 42
    with open_recording(tmp_path / "c.mcap") as recording:
        assert recording.scans
    with pytest.raises(RecordingError, match="guara convert"):
        with open_recording(tmp_path / "b.mcap") as recording:
            for scan in recording.scans:
                for stripe in scan.stripes:
                    if stripe.on is not None:
                        recording.frame(stripe.on)
            list(recording.terrains())


def test_a_whole_file_is_copied_whole(tmp_path: Path, peer) -> None:
    """Recovery of a file that needs none loses nothing and says so."""
    write_recording(tmp_path / "a.mcap", peer)
    recovery = recover_recording(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert recovery.was_whole and recovery.bytes_lost == 0 and recovery.messages == 28
    with open_recording(tmp_path / "b.mcap") as recording:
        assert [scan.is_whole for scan in recording.scans] == [True, True]


def test_an_atomic_file_appears_whole_or_not_at_all(tmp_path: Path, peer) -> None:
    """While it is written it has another name, and after an error there is no file."""
    write_recording(tmp_path / "a.mcap", peer, atomic=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    with pytest.raises(ZeroDivisionError):
        with RecordingWriter(tmp_path / "b.mcap", atomic=True) as writer:
            writer.begin_scan(scan_record(peer))
            assert not (tmp_path / "b.mcap").exists()
            raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
