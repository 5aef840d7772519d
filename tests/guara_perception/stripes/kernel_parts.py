"""Functions within the kernel that the product calls only together."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.stripes.band import pictures_of
from guara_perception.stripes.kernel.library import PICTURE, address, addresses, kernel

N, P, D, F = ctypes.c_int64, ctypes.c_void_p, ctypes.c_double, ctypes.c_float
# Function -> types of its arguments and of its result.
PARTS: dict[str, tuple[list[Any], Any]] = {
    "centres": ([P, N, P, P], None),
    "clipped_columns": ([PICTURE, P, D, N, N, P, P], None),
    "follow_candidates": ([P, P, N, N, P, P, P], None),
    "pair_relief": ([P, P, P, P, N, P, P], None),
    "responses": ([P, N, N, N, P, P, N, P], None),
    "select_value": ([P, N, N], F),
    "smooth_line": ([P, P, N, P, P], None),
    "stripe_sigma": ([P, N, N, N, P, P, P, N, D, P], D),
}


def part(name: str) -> Callable[..., Any]:
    """A function of PARTS."""
    function = getattr(kernel(), name)
    function.argtypes, function.restype = PARTS[name]
    return function


@dataclass(frozen=True)
class Judgement:
    """Assessment of a frame pair by some of its columns.

    Attributes:
        channel: number of the channel in which the stripe stands out most from the noise; 0 for mono.
        is_swapped: True if the stripe is a dip of `on - off` instead of a peak, as if the images were swapped.
        change: median of `on - off` in that channel [grey levels]; near 0 for a valid pair.
        is_uneven: True if the brightness beside the stripe differs between `on` and `off` in any channel.
        is_core_clipped: True if the core is clipped in that channel in more than a fifth of the columns in which the
            stripe stands out.
    """

    channel: int
    is_swapped: bool
    change: float
    is_uneven: bool
    is_core_clipped: bool


def judge(on: np.ndarray, off: np.ndarray | None) -> Judgement:
    """Assess a frame pair; without `off`, the median of each column is subtracted instead."""
    first, second = pictures_of(on, off)
    found, work = np.empty(5), np.empty(kernel().judge_size(*first.shape), np.float32)
    kernel().judge(first, second, *addresses(work, found))
    return Judgement(int(found[0]), bool(found[1]), float(found[2]), bool(found[3]), bool(found[4]))


class Path(ctypes.Structure):
    """A path as any_light.h has it: rows, and whether there is a stripe."""

    _fields_ = (("row", P), ("is_stripe", P))


def follow(evidence: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Row of the best path in each column of evidence (rows, columns), whether there is a stripe, and its value."""
    rows, columns = evidence.shape
    by_column = np.ascontiguousarray(evidence.T, np.float32)
    carve, best = kernel().carve_any, kernel().follow_columns
    carve.argtypes, carve.restype = [P, P, N, N, N], N
    best.argtypes, best.restype = [P, N, N, P, P], D
    parts = np.zeros(4096, np.uint8)
    memory = np.zeros(carve(address(parts), None, 1, rows, columns), np.uint8)
    carve(address(parts), address(memory), 1, rows, columns)
    row, is_stripe = np.empty(columns, np.int32), np.empty(columns, np.bool_)
    value = best(address(by_column), columns, rows, address(parts), ctypes.byref(Path(*addresses(row, is_stripe))))
    return row, is_stripe, value


def strong_pieces(height: np.ndarray, row: np.ndarray, is_stripe: np.ndarray, least: float) -> np.ndarray:
    """Mask (columns,) of the pieces of a path that are long and strong enough, none clipped."""
    n = row.size
    height, row = np.ascontiguousarray(height, np.float32), np.ascontiguousarray(row, np.int32)
    good, is_core, work = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.empty(n, np.float32)
    function = kernel().strong_pieces
    function.argtypes, function.restype = [P, P, P, N, N, D, P, P], None
    path = Path(*addresses(row, is_stripe))
    function(address(height), ctypes.byref(path), address(is_core), n, 1, least, *addresses(good, work))
    return good


def of_laser_speckle(light: np.ndarray, row: np.ndarray, is_stripe: np.ndarray, sigma: float) -> np.ndarray:
    """Mask (columns,) of the pieces of a path in light (rows, columns) that are as grainy as laser light."""
    rows, n = light.shape
    row, sigmas = np.ascontiguousarray(row, np.int32), np.full(n, sigma, np.float32)
    good, is_core, work = is_stripe.copy(), np.zeros(n, np.bool_), np.empty(3 * n, np.float32)
    kept = Path(*addresses(kept_row := np.empty(n, np.int32), is_kept := np.empty(n, np.bool_)))
    function = kernel().of_laser_speckle
    function.argtypes, function.restype = [P, N, N, P, P, P, P, P, P], None
    path = ctypes.byref(Path(*addresses(row, is_stripe)))
    function(address(light), rows, n, path, *addresses(is_core, sigmas, good), ctypes.byref(kept), address(work))
    assert kept_row.size == is_kept.size
    return good


def strongest_ridge(light: np.ndarray, row: int, column: int, noises: np.ndarray, taps: np.ndarray) -> float:
    """Height of the strongest ridge at a pixel of light (rows, columns); taps: (3, 32) weights of each width."""
    sigma, of_all = F(), np.concatenate([noises, np.zeros(128)])
    function = kernel().ridge_at
    function.argtypes, function.restype = [P, N, N, N, N, P, P, P], F
    return float(function(address(light), *light.shape, row, column, *addresses(of_all, taps), ctypes.byref(sigma)))


def pair_relief(points: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Variance (w,) of the ground halfway between two stripes, of points (3, 2, w) and variances (2, w) [m^2]."""
    x, y, z = (np.ascontiguousarray(axis, np.float32) for axis in points)
    variance = np.ascontiguousarray(variance, np.float32)
    n = variance.shape[1]
    relief, work = np.empty(n), np.empty(3 * (n + 1))
    part("pair_relief")(*addresses(x, y, z, variance), n, *addresses(work, relief))
    return relief
