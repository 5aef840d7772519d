"""A recording on a disk that fills up: no acknowledged scan is lost, and the file ends with a whole record."""

import os
import resource
from pathlib import Path

import pytest

from transport.recording import open_recording, recover_recording
from transport.recording.topic_file import GrowingFile


def test_what_was_acknowledged_around_a_full_disk_survives_a_kill(start, tmp_path: Path) -> None:
    """Disk full for four scans, freed, kill -9: every acknowledged scan comes back, and so do the four that waited."""
    path = tmp_path / "walk.mcap"
    process = start("record_full", str(path))
    process.expect("waiting")
    process.kill()
    said = [line.split() for line in process.lines]
    acknowledged = {int(fields[1]) for fields in said if fields[0] == "acknowledged"}
    refused = {int(fields[1]) for fields in said if fields[0] == "refused"}
    assert refused == {4, 5, 6, 7} and acknowledged == set(range(12)) - refused
    result = recover_recording(path, tmp_path / "whole.mcap")
    assert result.damaged_chunks == 0 and result.bytes_lost == 0
    with open_recording(tmp_path / "whole.mcap") as recording:
        whole = {scan.step for scan in recording.scans if scan.is_whole}
        assert whole == set(range(12))
        assert {terrain.sequence - 1 for terrain in recording.terrains()} >= acknowledged


def test_a_torn_piece_is_cut_off_and_written_again(tmp_path: Path) -> None:
    """A write that fails half way leaves the file as it was; a later one writes all that is missing."""
    file = GrowingFile(tmp_path / "grown")
    file.write(b"first")
    file.append()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8, before[1]))
    try:
        file.write(b"second")
        assert file.tell() == 11
        with pytest.raises(OSError):
            file.append()
        assert (tmp_path / "grown").read_bytes() == b"first"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    file.write(b"third")
    file.append()
    file.close()
    assert (tmp_path / "grown").read_bytes() == b"firstsecondthird"
    assert os.path.getsize(tmp_path / "grown") == file.tell()
