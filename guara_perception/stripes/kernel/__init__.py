"""Compiled kernel: loops over rows and columns of images, columns of stripes, and samples of the surface.

`stripes`, `calibration`, `ranging`, `scanning` and `terrain.assessment` call the kernel, and `app` preloads it; it
imports none of them. `hatch_build.py` compiles it when the package is built or installed from source.
"""

from __future__ import annotations
