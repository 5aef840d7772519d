"""Compiled kernel as a shared library for this processor, and the images and memory passed to it."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import threading
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Array
from guara_perception.exceptions import DamagedInstallation

FOLDER = Path(__file__).parent
# Processor flags that identify an `x86-64-v3` processor.
V3_FLAGS = {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
N = ctypes.c_int64


class Picture(ctypes.Structure):
    """Image as passed to the kernel; the array must outlive it."""

    _fields_ = tuple((n, N) for n in "data rows columns channels row_step column_step channel_step size".split())

    def __init__(self, array: Array) -> None:
        """Describe an array (rows, columns[, channels]) of uint8 or uint16 with any strides."""
        shape, steps = (*array.shape, 1)[:3], (*array.strides, 0)[:3]
        super().__init__(_start(array), *shape, *steps, array.itemsize)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns and channels."""
        return self.rows, self.columns, self.channels


P, D, PICTURE = ctypes.c_void_p, ctypes.c_double, ctypes.POINTER(Picture)
# Types of the arguments and the result of each function. The global interpreter lock is released during each call.
FUNCTIONS: dict[str, tuple[list[Any], Any]] = {
    "any_light_size": ([N] * 5, N),
    "behind_surface": ([P, N, N, P, N, P, N, D, D, P, D, P], None),
    "cells_of_samples": ([P, N, D, P, N, N, P, P], None),
    "clearance": ([P, N, N, N, D, P, P], None),
    "clean_size": ([N] * 3, N),
    "extract_clean": ([PICTURE, PICTURE, N, D, P, P, P], N),
    "extract_any_light": ([PICTURE, PICTURE] + [N] * 3 + [P] * 6, N),
    "height_variance": ([P, P, N] + [P] * 6 + [D, P], None),
    "judge": ([PICTURE, PICTURE, P, P], None),
    "judge_size": ([N] * 3, N),
    "fit_motion": ([P, P, P, P, N, N, D, N, D, D, P, N, P, P], N),
    "levels_of": ([PICTURE, N, N, D, P, P], None),
    "levels_size": ([PICTURE], N),
    "link_stripes": ([P, P, N, N, P, N, D, D, D, P, P, P], None),
    "locate": ([P, P, N, N, P, N, D, P, P, D, D, P, P], None),
    "look_at_corners": ([PICTURE, N, N, D] + [P] * 4 + [N, N, D, D, N, D, N, D, D, P, N, P, P], N),
    "look_down": ([PICTURE, PICTURE, N, P, N, P, P], D),
    "look_down_size": ([N, N], N),
    "lowest_nearby": ([P, N, N, N, P, P], None),
    "median": ([P, N], D),
    "merge_cells": ([P] * 6 + [N] * 4 + [P] * 3, None),
    "nearest_planes": ([P, N, P, N, P, P], None),
    "parts_of_stripes": ([P, N, P, N, N, N, P, P], None),
    "sample_surface": ([P, P, N, N, P, P, P, P, P, P, D, N, P, P, P], None),
    "second_line": ([PICTURE, PICTURE, P, D, P], D),
    "second_line_size": ([N], N),
    "settle_points": ([P] * 3 + [N, N, D, D, N, N] + [P] * 6, None),
    "shrink": ([PICTURE, N, N, D, P, P, P], None),
    "sources": ([], ctypes.c_char_p),
    "sum_cells": ([P, P, P, N, P, N, N, N, N, P, P, P, P], None),
    "test_discs": ([P, N, N, N, N, P, N, D, D, P, P, P, P], None),
    "unmet_cells": ([P, N, N, P, P, P, D, D, D, P, P, P], None),
}


@cache
def kernel() -> ctypes.CDLL:
    """Load the kernel's library.

    Raises:
        DamagedInstallation: the library is missing, or was built from other sources or for another machine.
    """
    path = FOLDER / f"{processor()}.so"
    try:
        library = ctypes.CDLL(str(path))
        for name, (arguments, result) in FUNCTIONS.items():
            function = getattr(library, name)
            function.argtypes, function.restype = arguments, result
        sources = [path.read_bytes() for path in sorted(FOLDER.glob("*.[ch]"))]
        if sources and library.sources() != hashlib.sha256(b"".join(sources)).hexdigest().encode():
            raise OSError("it was compiled from other sources")
    except (OSError, AttributeError) as error:
        reason = "it is missing" if not path.exists() else str(error)
        advice = "reinstall guara-perception; in a checkout: make install, or python hatch_build.py"
        raise DamagedInstallation(f"the compiled kernel {path} cannot be loaded ({reason}): {advice}") from None
    return library


def processor() -> str:
    """Processor type of this machine, which is also the name of the library's file without its ending."""
    machine = platform.machine()
    if machine != "x86_64":
        return {"aarch64": "armv8-a"}.get(machine, machine)
    flags = Path("/proc/cpuinfo").read_text().partition("\nflags")[2].partition("\n")[0].split()
    return "x86-64-v3" if set(flags) >= V3_FLAGS else "x86-64-v2"


class _Memory(threading.local):
    """Work memory of a thread, reused for successive bands."""

    bytes: Array = np.empty(0, np.uint8)


_MEMORY = _Memory()


# Largest request [bytes] that is met from the memory kept by the thread. It suffices for a band of a scan. More memory,
# for whole images, is freed after use.
MOST_KEPT = 8 << 20


def memory(size: int) -> Array:
    """Work memory of at least `size` bytes (uint8), aligned to 64 bytes.

    Calls in one thread with a size of up to MOST_KEPT share one memory, which is replaced if it is too small.
    """
    if size > MOST_KEPT:
        return _aligned(size)
    if _MEMORY.bytes.size < size:
        _MEMORY.bytes = _aligned(size + size // 8)
    return _MEMORY.bytes


def _aligned(size: int) -> Array:
    whole = np.empty(size + 64, np.uint8)
    return whole[-whole.ctypes.data % 64 :]


def address(array: Array) -> int:
    """Address of the memory of an array.

    Raises:
        ValueError: the array is not C-contiguous.
    """
    if not array.flags.c_contiguous:
        raise ValueError(f"an array given to the kernel has strides {array.strides}; it must be C-contiguous")
    return _start(array)


def _start(array: Array) -> int:
    """Address of the first element of an array."""
    try:
        # Several times as fast as `array.ctypes.data`, which matters for the many small calls of a scan.
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        # The array is read-only, empty or not contiguous.
        return array.ctypes.data


def addresses(*arrays: Array) -> list[int]:
    """Addresses of the memory of several arrays; see `address`."""
    return [address(array) for array in arrays]
