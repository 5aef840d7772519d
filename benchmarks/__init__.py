"""Benchmarks: figures of accuracy and speed, printed by commands anyone can run.

Linear algebra runs on one thread, as OpenCV does: no contender gets help that the others do not have.
"""

from __future__ import annotations

import os

# Before numpy is loaded.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
