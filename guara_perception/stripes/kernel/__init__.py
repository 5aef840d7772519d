"""The compiled kernel of stripe extraction: the loops over rows and columns.

`stripes` and `stripes.any_light` call it; it imports nothing of them. `hatch_build.py` compiles it when the package is
installed.
"""

from __future__ import annotations
