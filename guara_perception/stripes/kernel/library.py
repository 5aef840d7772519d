"""The kernel's library for this processor, loaded once."""

from __future__ import annotations

import ctypes
import platform
from functools import cache
from pathlib import Path
from typing import Any

from guara_perception.arrays import Array
from guara_perception.exceptions import DamagedInstallation

FOLDER = Path(__file__).parent
# What `x86-64-v3` may use beyond older processors.
V3_FLAGS = {"avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
P, N, D, F = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double, ctypes.c_float
# Function -> types of its arguments and of its result. The interpreter's lock is released while one runs.
FUNCTIONS: dict[str, tuple[list[Any], Any]] = {
    "details": ([P, N, N, N, P, P, N, N, P, P], None),
    "centres": ([P, N, P, P], None),
    "evidence": ([P, N, D, D, D, P], None),
    "exposure": ([P, P, N, D, P, P], None),
    "follow": ([P, N, N, P, P], D),
    "highest_peaks_float": ([P, N, N, P, P, P, P], None),
    "highest_peaks_int16": ([P, N, N, P, P, P, P], None),
    "measure": ([P] * 8 + [N] * 3 + [D] * 3 + [P] * 5, N),
    "ridges": ([P, N, N, P, N, N, P, P], None),
    "select_value": ([P, N, N], F),
    "smooth_line": ([P, P, N, P, P], None),
    "strongest": ([P, P, P, N, D, D, D, P], None),
    "subtract": ([P, P, N, N, P, P, P], None),
}


@cache
def kernel() -> ctypes.CDLL:
    """Load the library.

    Raises:
        DamagedInstallation: it is missing, or is no library of this version for this machine.
    """
    path = FOLDER / f"{processor()}.so"
    try:
        library = ctypes.CDLL(str(path))
        for name, (arguments, result) in FUNCTIONS.items():
            function = getattr(library, name)
            function.argtypes, function.restype = arguments, result
    except (OSError, AttributeError) as error:
        reason = "it is missing" if not path.exists() else str(error)
        advice = "reinstall guara-perception; in a checkout: make install, or python hatch_build.py"
        raise DamagedInstallation(f"the compiled kernel {path} cannot be loaded: {reason}. {advice}") from None
    return library


def processor() -> str:
    """Kind of this machine's processor, which is the name of its library."""
    machine = platform.machine()
    if machine != "x86_64":
        return {"aarch64": "armv8-a"}.get(machine, machine)
    flags = Path("/proc/cpuinfo").read_text().partition("\nflags")[2].partition("\n")[0].split()
    return "x86-64-v3" if set(flags) >= V3_FLAGS else "x86-64-v2"


# Columns that the kernel handles at a time, as in kernel.h and ridges.c.
LANES, STRIP = 16, 64


def address(array: Array) -> int:
    """Address of the memory of a C-contiguous array."""
    if not array.flags.c_contiguous:
        raise ValueError(f"an array with strides {array.strides} was given to the kernel")
    return array.ctypes.data


def addresses(*arrays: Array) -> list[int]:
    """Address of each array."""
    return [address(array) for array in arrays]
