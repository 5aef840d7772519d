"""Reduction of camera images to 8 bits and to the size of a display."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Image


def eight_bits(picture: Image) -> Image:
    """Reduce a 16-bit image to its upper eight bits; an 8-bit image is returned unchanged."""
    return (picture >> 8).astype(np.uint8) if picture.dtype == np.uint16 else picture


def for_screen(picture: Image, width: int) -> Image:
    """Convert an image to 8 bits, and shrink it to `width` [px] if it is wider."""
    scale = min(1.0, width / picture.shape[1])
    return np.asarray(cv2.resize(eight_bits(picture), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
