"""Reader of photographs, and three textbook methods of finding a laser line in them.

Unlike the product, these methods are given the colour channel of the laser.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Image

# Steger: width of the line, hysteresis thresholds as quantiles of the ridge strength, shortest linked line.
STEGER_SIGMA_PX = 2.0
STEGER_HIGH, STEGER_LOW_SHARE = 0.998, 0.5
STEGER_SHORTEST_PX = 20
ARGMAX_LEAST, GRAVITY_REACH_PX = 20.0, 4


def read(folder: Path, name: str | None, colour: str) -> Image | None:
    """One photograph, that of a mono camera ("m") with one channel."""
    if name is None:
        return None
    picture = cv2.imread(str(folder / name))
    if picture is None:
        raise SystemExit(f"{folder / name}: no picture")
    return np.ascontiguousarray(picture[:, :, 1]) if colour == "m" else picture


def excess(on: Image, off: Image | None, along: str, channel: int) -> npt.NDArray[np.float32]:
    """One channel minus half of the others (a mono picture as it is), the line across the columns."""
    picture = on.astype(np.float32).reshape(*on.shape[:2], -1)
    if off is not None:
        picture = picture - off.astype(np.float32).reshape(picture.shape)
    if picture.shape[2] == 3:
        picture = (1.5 * picture[:, :, channel] - 0.5 * picture.sum(axis=2))[:, :, None]
    light = picture[:, :, 0]
    return np.ascontiguousarray(light.T if along == "rows" else light)


def argmax(on: Image, off: Image | None, along: str, channel: int) -> Float:
    """Highest value of each column, centre of gravity about it."""
    light = cv2.GaussianBlur(excess(on, off, along, channel), (0, 0), 1.0)
    columns = np.arange(light.shape[1])
    top = light.argmax(axis=0)
    rows = np.clip(top + np.arange(-GRAVITY_REACH_PX, GRAVITY_REACH_PX + 1)[:, None], 0, len(light) - 1)
    weight = np.maximum(light[rows, columns], 0)
    centre = (weight * rows).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-6)
    least = max(ARGMAX_LEAST, 0.2 * float(np.percentile(light[top, columns], 90)))
    return np.where(light[top, columns] > least, centre, np.nan)


def steger(on: Image, off: Image | None, along: str, channel: int) -> Float:
    """Steger's line points (Hessian ridges), hysteresis, linking; of each column the strongest long line."""
    light = cv2.GaussianBlur(excess(on, off, along, channel), (0, 0), STEGER_SIGMA_PX)
    second = -cv2.Sobel(light, cv2.CV_32F, 0, 2, ksize=3)
    first = cv2.Sobel(light, cv2.CV_32F, 0, 1, ksize=3) / 8
    shift = np.where(second > 1e-3, first / np.maximum(second / 4, 1e-3), 9)
    is_point = np.abs(shift) <= 0.6
    high = float(np.quantile(second, STEGER_HIGH))
    weak = (is_point & (second > STEGER_LOW_SHARE * high)).astype(np.uint8)
    linked = cv2.dilate(weak, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(linked, connectivity=8)
    is_line = stats[:, cv2.CC_STAT_WIDTH] >= STEGER_SHORTEST_PX
    has_strong = np.zeros(count, dtype=bool)
    has_strong[np.unique(labels[(weak > 0) & (second > high)])] = True
    is_line &= has_strong
    is_line[0] = False
    strength = np.where(is_line[labels] & (weak > 0), second * np.sqrt(stats[labels, cv2.CC_STAT_WIDTH]), 0)
    top = strength.argmax(axis=0)
    columns = np.arange(light.shape[1])
    return np.where(strength[top, columns] > 0, top + np.clip(shift[top, columns], -0.6, 0.6), np.nan)


def tutorial(on: Image, off: Image | None, along: str, channel: int) -> Float:
    """As OpenCV tutorials do: blur, Otsu's threshold, mean row of the white pixels of each column."""
    light = np.clip(cv2.GaussianBlur(excess(on, off, along, channel), (5, 5), 0), 0, 255).astype(np.uint8)
    _, mask = cv2.threshold(light, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    weight = np.where(mask > 0, light, 0).astype(np.float64)
    total = weight.sum(axis=0)
    rows = np.arange(len(light))[:, None]
    return np.where(total > 0, (weight * rows).sum(axis=0) / np.maximum(total, 1), np.nan)


PEERS: dict[str, Callable[[Image, Image | None, str, int], Float]] = {
    "argmax": argmax,
    "Steger": steger,
    "tutorial": tutorial,
}
