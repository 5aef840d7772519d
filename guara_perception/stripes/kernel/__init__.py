"""Compiled kernel of stripe extraction: the loops over rows and columns.

`stripes` calls it; it imports nothing from there. `hatch_build.py` compiles it when the package is installed.
"""

from __future__ import annotations
