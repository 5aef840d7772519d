"""Images: reading of untrusted files with limits on their size, writing, reduction for a display, and tracking."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from guara_perception.arrays import Float, Grey, Image
from guara_perception.exceptions import FileFormatError

# Largest image file [byte], and largest number of pixels of an image: the largest suitable cameras have 12 Mpx.
LARGEST_PICTURE = 128 * 1024 * 1024
MOST_PIXELS = 16_000_000
# Allowed image formats, by their names in Pillow; PPM includes PGM.
PICTURE_FORMATS = "PNG", "JPEG", "BMP", "TIFF", "PPM"
TIFF_BEGINNINGS = b"II*\0", b"MM\0*"
# Keep the bit depth, keep grey images grey, and ignore the rotation that an EXIF tag requests.
AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION


def decode_picture(content: bytes, source: str) -> Image:
    """Decode an image file to BGR or grey levels, keeping 8 or 16 bits per channel and dropping an alpha channel.

    Raises:
        FileFormatError: the format is not allowed, the data are damaged, the image has no or too many pixels or is not
            8 or 16 bit unsigned, or an EXIF tag rotates or mirrors it.
    """
    picture = _decode(content, AS_STORED) if _is_bounded(content, source) else None
    if picture is None:
        raise FileFormatError(
            f"{source}: not a readable picture ({len(content)} bytes); it must be PNG, JPEG, BMP, TIFF or PGM"
        )
    if picture.dtype not in (np.uint8, np.uint16):
        raise FileFormatError(f"{source}: pixel type is {picture.dtype}; allowed: uint8 or uint16")
    if b"Exif\0\0" in content or b"eXIf" in content or content[:4] in TIFF_BEGINNINGS:
        shown = _decode(content, AS_STORED & ~cv2.IMREAD_IGNORE_ORIENTATION)
        if shown is not None and (shown.shape != picture.shape or not np.array_equal(shown, picture)):
            raise FileFormatError(
                f"{source}: the EXIF orientation tag rotates or mirrors the image. Remove the tag; the pixels must "
                "have the same orientation as the calibration images"
            )
    return picture


def _is_bounded(content: bytes, source: str) -> bool:
    """Check the size in the header of an image before anything is decoded; False without a header of a known format.

    Raises:
        FileFormatError: the image has no pixels or too many.
    """
    # Imported here: few programs read pictures.
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content), formats=PICTURE_FORMATS) as header:
            width, height = header.size
    except Image.DecompressionBombError as error:
        raise FileFormatError(f"{source}: {str(error).rstrip('.')}; allowed: up to {MOST_PIXELS} px") from None
    except Exception:  # the readers of the formats raise errors of many types
        return False
    if not 0 < width * height <= MOST_PIXELS:
        raise FileFormatError(
            f"{source}: the picture has {width} x {height} px; allowed: 1 ... {MOST_PIXELS} px in total"
        )
    return True


def _decode(content: bytes, flags: int) -> Image | None:
    try:
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None
    return None if picture is None else np.asarray(picture)


def write_picture(path: Path, picture: Image, options: Sequence[int] = ()) -> None:
    """Write an image in the format given by the suffix of the path.

    `cv2.imwrite` would only return False if the file cannot be written.

    Args:
        path: file to write.
        picture: (h, w) or (h, w, 3) BGR image.
        options: options of `cv2.imencode`.

    Raises:
        OSError: the file cannot be written.
    """
    path.write_bytes(cv2.imencode(path.suffix, picture, list(options))[1].tobytes())


def eight_bits(picture: Image) -> Image:
    """Reduce a 16-bit image to its upper eight bits; an 8-bit image is returned unchanged."""
    return (picture >> 8).astype(np.uint8) if picture.dtype == np.uint16 else picture


def to_grey(picture: Image) -> Grey:
    """Convert an image of 8 or 16 bits, grey or BGR, to 8-bit grey (h, w); always a copy."""
    picture = eight_bits(picture)
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 and picture.shape[2] == 3 else picture
    return np.array(grey.reshape(grey.shape[:2]), dtype=np.uint8, order="C")


def to_rgb(picture: Image) -> Image:
    """Convert an image of 8 or 16 bits, grey or BGR, to 8-bit RGB."""
    picture = eight_bits(picture)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB if picture.ndim == 2 else cv2.COLOR_BGR2RGB))


def for_screen(picture: Image, width: int) -> Image:
    """Convert an image to 8 bits, and shrink it to `width` [px] if it is wider."""
    scale = min(1.0, width / picture.shape[1])
    return np.asarray(cv2.resize(eight_bits(picture), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def follow(before: Image, after: Image, points: Float, window: int, levels: int) -> Float:
    """Track points from one greyscale image to another; return their positions (n, 2) [px], NaN for a lost point.

    Args:
        before, after: (h, w) uint8 images.
        points: (n, 2) x and y in `before` [px].
        window: side of the square around a point that is compared [px].
        levels: number of times that the image size is halved, to track motions larger than the window.
    """
    if not len(points):
        return np.empty((0, 2))
    given = points.astype(np.float32).reshape(-1, 1, 2)
    size = (window, window)
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, given, given.copy(), winSize=size, maxLevel=levels)
    return np.where(found == 0, np.nan, np.asarray(there[:, 0], np.float64))
