"""Size-limited reading of untrusted files, and atomic writing."""

from __future__ import annotations

import math
import os
import secrets
import shutil
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Array
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile

# Largest text file [byte]: a calibration of 70 stripes with all covariances takes less than 1 MB.
LARGEST_TEXT = 16 * 1024 * 1024
# Largest TOML file [byte]: devices.toml and node.toml have some twenty lines.
LARGEST_TOML = 64 * 1024
# Largest total size of the arrays of a grid file [byte]: all layers of the largest grid take 192 MB.
LARGEST_ARRAYS = 192 * 1024 * 1024
# Largest header of one array [byte].
LARGEST_HEADER = 10_000


def read_bounded(path: Path, largest: int) -> bytes:
    """Read a file of limited size.

    Raises:
        FileFormatError: the file is longer than `largest` bytes or cannot be read.
    """
    try:
        with path.open("rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror}") from None
    if len(content) > largest:
        raise FileFormatError(f"{path}: has more than {largest} bytes, which no such file needs")
    return content


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file of limited size.

    Raises:
        FileFormatError: the file is longer than LARGEST_TOML bytes, cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(read_bounded(path, LARGEST_TOML).decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        hint = "; text needs quotes" if "Invalid value" in str(error) else ""
        raise FileFormatError(f"{path}: not valid TOML: {error}{hint}") from None


def read_arrays(
    path: Path, wanted: Sequence[str], kind: str = "terrain", largest: int = LARGEST_ARRAYS
) -> dict[str, Array]:
    """Read the wanted arrays of an .npz file; other arrays are not decompressed.

    Wanted arrays that the file does not contain are missing from the result.

    Args:
        path: path of the file.
        wanted: names of arrays.
        kind: kind of file, for messages.
        largest: largest total size of the wanted arrays [byte].

    Raises:
        FileFormatError: the file is missing or invalid, an array is shorter than its header states, or the wanted
            arrays exceed `largest`.
    """
    found: dict[str, Array] = {}
    left = largest
    try:
        with zipfile.ZipFile(path) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            for name in wanted:
                if name not in members:
                    continue
                info = members[name]
                left -= info.file_size
                if left < 0:
                    raise FileFormatError(f"{path}: its arrays take more than {largest} bytes")
                with archive.open(info) as file:
                    found[name] = _read_array(file, info.file_size, f"{path}: not a {kind} file ({name}")
    except FileFormatError:
        raise
    except Exception as error:  # archive, decompressor and header raise errors of many types
        raise FileFormatError(f"{path}: not a {kind} file ({error})") from None
    return found


def _read_array(file: Any, size: int, source: str) -> Array:
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, is_fortran, dtype = read_header(file, max_header_size=LARGEST_HEADER)
    count = math.prod(shape)
    length = count * dtype.itemsize
    if dtype.hasobject or length < 0 or length > size:
        raise FileFormatError(
            f"{source}: its header states {dtype} {shape}, {length} bytes, but only {size} are stored)"
        )
    content = file.read(length)
    if len(content) != length:
        raise FileFormatError(f"{source} is truncated)")
    array = np.frombuffer(content, dtype, count)
    return array.reshape(shape[::-1]).T if is_fortran else array.reshape(shape)


def existing_file(path: str | Path, remedy: str = "") -> Path:
    """Check that a file exists, and return its path.

    Raises:
        MissingFile: there is no such file; the message ends in `remedy`.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFile(f"{path}: no such file{remedy}")
    return path


def check_folder(path: Path) -> None:
    """Reject a file given as output folder, before time is spent on the output.

    Raises:
        InvalidInput: `path` is a file.
    """
    if path.exists() and not path.is_dir():
        raise InvalidInput(f"{path} is a file; a folder is needed")


def check_target(path: str | Path, *endings: str) -> Path:
    """Reject an unsuitable output path, before time is spent on the output.

    Args:
        path: file to write.
        endings: allowed endings in lower case, such as ".pdf"; without them, any ending is allowed.

    Raises:
        MissingFile: the folder of `path` does not exist.
        InvalidInput: the ending of `path` is not allowed, or `path` is a folder.
    """
    path = Path(path)
    if endings and path.suffix.lower() not in endings:
        raise InvalidInput(f"{path}: it must end in {', '.join(endings)}")
    if path.is_dir():
        raise InvalidInput(f"{path} is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise MissingFile(f"{path}: the folder {path.parent} does not exist; create it first")
    return path


def write_text(path: str | Path, text: str) -> None:
    """Write a text file atomically, in UTF-8; see `whole_file` for the errors."""
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder beside `folder`; it is moved there on success and removed on any error.

    Raises:
        OSError: the folder cannot be created, or `folder` is a file or not empty.
    """
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield temporary
        temporary.chmod(0o755)
        temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; the file there replaces `path` on success and is removed on any error.

    The temporary name keeps the suffix, because some writers choose the format by it.

    Raises:
        MissingFile: the folder of `path` does not exist.
        InvalidInput: `path` is a folder.
        OSError: the file cannot be written. On a full disk, the error names `path`.
    """
    path = check_target(path)
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    # The file is created here, so that its name is not taken by another process and its permissions are the user's
    # default.
    try:
        temporary.touch(exist_ok=False)
        yield temporary
        # Without fsync, a power cut soon after the rename can leave an empty file under the new name.
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        # The error of a full disk names no file, or the temporary file, which the user does not know.
        if error.filename is None or os.fspath(error.filename) == os.fspath(temporary):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)
