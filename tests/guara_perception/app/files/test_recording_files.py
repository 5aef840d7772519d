"""Files of a continued recording: their names after restarts, and which of them are removed to make room."""

import errno
from pathlib import Path

import pytest

from guara_perception.app.files import recording_files as module
from guara_perception.app.files.recording_files import MAGIC, RecordingFiles, read_limit
from guara_perception.exceptions import InvalidInput
from transport.exceptions import RecordingError
from transport.recording.topic_file import GrowingFile

MB = 10**6


def _write(path: Path, size: int) -> Path:
    """Write a finished sparse file of a given length."""
    with path.open("wb") as file:
        file.truncate(size - len(MAGIC))
        file.seek(0, 2)
        file.write(MAGIC)
    return path


def test_a_file_is_followed_by_numbered_ones(tmp_path: Path) -> None:
    """w.mcap, w-2.mcap ...: the next number after the highest; w.mcap itself if unused. Other files do not count."""
    files = RecordingFiles(tmp_path / "w.mcap", "guara")
    assert files.file_size is None and files.next() == tmp_path / "w.mcap"
    _write(tmp_path / "w.mcap", 100)
    assert files.next() == tmp_path / "w-2.mcap"
    for name in ("w-2.mcap", "w-9.mcap", "w-x.mcap", "ww-30.mcap", "w-40.mcap.part", "v-50.mcap"):
        _write(tmp_path / name, 100)
    assert files.next() == tmp_path / "w-10.mcap"
    (tmp_path / "w.mcap").unlink()
    assert files.next() == tmp_path / "w.mcap"


def test_a_folder_is_made_and_its_files_are_numbered_by_robot(tmp_path: Path) -> None:
    """Two robots may share a folder, even if one name is a prefix of the other."""
    folder = tmp_path / "deep" / "recordings"
    files = RecordingFiles(folder, "guara")
    assert files.next() == folder / "guara-000001.mcap" and files.file_size == module.FILE_SIZE
    _write(folder / "guara-000041.mcap", 100)
    _write(folder / "guara-2-000077.mcap", 100)
    assert files.next() == folder / "guara-000042.mcap"
    assert RecordingFiles(folder, "guara-2").next() == folder / "guara-2-000078.mcap"


def test_the_oldest_make_room_and_nothing_else_does(tmp_path: Path) -> None:
    """Old files go until the limit has room for a full file and a pause; other files, links and folders stay."""
    limit = 1000 * MB
    files = RecordingFiles(tmp_path, "guara", limit)
    assert files.file_size == 200 * MB
    made = [_write(tmp_path / f"guara-{number:06d}.mcap", 200 * MB) for number in range(1, 8)]
    foreign = [
        _write(tmp_path / name, 300 * MB)
        for name in (
            "guara.mcap",
            "guara-2.mcap",
            "lobo-000001.mcap",
            "guara-000001.mcap.gz",
            "guara-000001-whole.mcap",
        )
    ]
    kept = _write(tmp_path / "elsewhere", 100)
    (tmp_path / "guara-000000.mcap").symlink_to(kept)
    (tmp_path / "guara-0000000.mcap").mkdir()
    files.make_room()
    assert [path.exists() for path in made] == [False] * 4 + [True] * 3
    assert kept.exists() and all(path.exists() for path in foreign)
    assert (tmp_path / "guara-000000.mcap").is_symlink() and (tmp_path / "guara-0000000.mcap").is_dir()
    files.make_room()
    assert sum(path.exists() for path in made) == 3
    RecordingFiles(tmp_path, "guara").make_room()
    assert sum(path.exists() for path in made) == 3


def test_a_file_that_is_written_is_never_removed(tmp_path: Path) -> None:
    """The oldest file stays if this or another process is writing it."""
    running = GrowingFile(tmp_path / "guara-000001.mcap")
    running.write(bytes(MB))
    running.append()
    made = [_write(tmp_path / f"guara-{number:06d}.mcap", 300 * MB) for number in (2, 3, 4)]
    RecordingFiles(tmp_path, "guara", 1000 * MB).make_room()
    assert (tmp_path / "guara-000001.mcap").exists() and [path.exists() for path in made] == [False, False, True]
    running.close()
    _write(tmp_path / "guara-000009.mcap", 300 * MB)
    RecordingFiles(tmp_path, "guara", 1000 * MB).make_room()
    assert not (tmp_path / "guara-000001.mcap").exists()


def test_a_file_that_cannot_be_removed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit is then exceeded, and the error names the file."""
    for number in range(1, 5):
        _write(tmp_path / f"guara-{number:06d}.mcap", 300 * MB)

    def refuse(path: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(RecordingError, match=r"guara-000001\.mcap: Permission denied"):
        RecordingFiles(tmp_path, "guara", 1000 * MB).make_room()


def test_places_that_cannot_be_recorded_to_are_named(tmp_path: Path) -> None:
    """A file in place of the folder, and a missing folder."""
    taken = _write(tmp_path / "notes.txt", 100)
    with pytest.raises(RecordingError, match="a file has this name"):
        RecordingFiles(taken, "guara")
    with pytest.raises(RecordingError, match="cannot create the folder"):
        RecordingFiles(taken / "deeper", "guara")
    with pytest.raises(RecordingError, match="No such file or directory"):
        RecordingFiles(tmp_path / "none" / "w.mcap", "guara").next()


def test_cut_files_are_told(tmp_path: Path) -> None:
    """Files without the end of an MCAP file, oldest first."""
    for number, content in ((1, MAGIC + b"..." + MAGIC), (2, MAGIC + b"..."), (10, b""), (3, b"..")):
        (tmp_path / f"guara-{number:06d}.mcap").write_bytes(content)
    assert [path.name[6:12] for path in RecordingFiles(tmp_path, "guara").cut()] == ["000002", "000003", "000010"]


@pytest.mark.parametrize(
    ("text", "size"), [("50GB", 50_000 * MB), ("200 mb", 200 * MB), (" 1.5TB", 1_500_000 * MB), ("0.2GB", 200 * MB)]
)
def test_sizes_are_read(tmp_path: Path, text: str, size: int) -> None:
    """Numbers with decimal units."""
    assert read_limit(text, tmp_path) == size


@pytest.mark.parametrize(
    "text",
    ["", "50", "GB", "50G", "-5GB", "1e9GB", "nan GB", "infGB", "50 GiB", "0GB", "199.9MB", "9" * 400 + "GB", "5,5GB"],
)
def test_what_is_no_size_is_refused(tmp_path: Path, text: str) -> None:
    """A limit too small for any file is refused too, with what is allowed."""
    with pytest.raises(InvalidInput, match=r"allowed: 200MB or more, such as 50GB"):
        read_limit(text, tmp_path)


@pytest.mark.parametrize("path", [None, Path("w.mcap")])
def test_a_limit_needs_a_folder(path: Path | None) -> None:
    """A file that the user named is never removed."""
    with pytest.raises(InvalidInput, match="needs --record with a folder"):
        read_limit("50GB", path)
