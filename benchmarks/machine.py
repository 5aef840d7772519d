"""What a run was made on, without names of hosts or paths."""

from __future__ import annotations

import os
import platform
import re
from pathlib import Path

import cv2
import numpy as np


def machine() -> dict[str, str]:
    """Processor, cores, system and versions."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text()) if info.is_file() else None
    load = os.getloadavg()[0]
    return {
        "processor": found[1].strip() if found else platform.processor() or platform.machine(),
        "cores": str(os.cpu_count()),
        "load at the start": f"{load:.1f} processes wanted a core (quiet: well below the number of cores)",
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "OpenCV": cv2.__version__,
    }
