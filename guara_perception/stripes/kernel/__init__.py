"""The compiled kernel: loops over rows and columns of pictures, over the columns of stripes and over samples.

`stripes`, `ranging`, `scanning` and `terrain.assessment` call it; it imports nothing of them. `hatch_build.py` compiles
it when the package is installed.
"""

from __future__ import annotations
