"""Terrain perception for walking robots from one camera and a swept laser stripe.

Starting points, each of which `help` describes, as in `help(gp.TerrainGrid)`:

    load_terrain, TerrainGrid     a grid from a file; its queries: check_foothold, best_foothold, swing, explain
    TerrainClient                 the grids of a running node; `guara run --simulated` starts one without hardware
    open_scan, process_scan       a recorded scan, and the grid computed from it
    open_recording                a recorded walk: its scans and grids
    TerrainMap                    a map fused from the scans of a walk
    calibrate, load_calibration   the calibration of a rangefinder
    terrain_from_points           a grid from another sensor
    Hazard                        flags of a cell: causes of unknown ground, and hazards of known ground

Public names are listed in `__init__.pyi` and loaded on first use, so that importing the package is fast.
"""

from __future__ import annotations

import ast
import functools
import importlib
import importlib.util
import os
import sys
from pathlib import Path
from typing import Any

# Module of each public name, read from `__init__.pyi`.
_MODULES = {
    alias.name: statement.module
    for statement in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(statement, ast.ImportFrom) and statement.module
    for alias in statement.names
}
_HOME = Path(__file__).resolve().parent.parent
# Modules that are not installed, because the distribution guara-client does not include them.
_MISSING = {
    module
    for module in {*_MODULES.values()}
    if not (path := _HOME.joinpath(*module.split("."))).is_dir() and not path.with_suffix(".py").is_file()
}
__all__ = sorted(name for name, module in _MODULES.items() if module not in _MISSING)


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _MODULES:
        raise AttributeError(f"guara_perception has no attribute {name!r}; it has {', '.join(sorted(_MODULES))}")
    _refuse_hidden_packages()
    if _MODULES[name] in _MISSING:
        from guara_perception.exceptions import MissingExtra

        raise MissingExtra(f"guara-client does not include {name}: pip install guara-perception")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, for completion, and the special attributes of the module."""
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])


@functools.cache
def _refuse_hidden_packages() -> None:
    """Check that no other file hides the packages `kinematics` and `transport`.

    Raises:
        ImportError: a file hides one of them; the message names the file.
    """
    home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    for package in ("kinematics", "transport"):
        loaded = sys.modules.get(package)
        spec = importlib.util.find_spec(package) if loaded is None else loaded.__spec__
        file = getattr(loaded, "__file__", None) or (None if spec is None else spec.origin)
        if file is not None and not os.path.abspath(file).startswith(os.path.join(home, package) + os.sep):
            raise ImportError(f"{file} hides the package `{package}` that guara_perception needs: rename that file")
