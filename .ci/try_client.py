"""Try guara-client where it is installed alone: `python -I try_client.py [ENDPOINT]`, an endpoint of a running node."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import guara_perception as gp

LARGEST_MB = 150
TIMED = (
    "import time; begin = time.perf_counter(); import guara_perception as gp; gp.TerrainClient, gp.TerrainGrid; "
    "print(time.perf_counter() - begin)"
)


def megabytes() -> float:
    """Size of the client and all that it needs, as pip installed it."""
    needed, left = set(), ["guara-client"]
    while left:
        name = left.pop()
        try:
            requirements = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue  # For another Python.
        if name not in needed:
            needed.add(name)
            left += ["".join(c if c.isalnum() or c in "-_." else " " for c in r).split()[0] for r in requirements]
    files = {file.locate() for name in needed for file in importlib.metadata.files(name) or []}
    return sum(Path(file).stat().st_size for file in files if Path(file).is_file()) / 1e6


def seconds() -> float:
    """Time to import the client in a fresh process, the least of five: other programs only add to it."""
    runs = [subprocess.run([sys.executable, "-I", "-c", TIMED], check=True, capture_output=True) for _ in range(5)]
    return min(float(run.stdout) for run in runs)


def refused(name: str, ask: Callable[[], object]) -> None:
    """Check that what is not here says in one line what to install."""
    try:
        ask()
    except ImportError as error:
        assert "pip install guara-perception" in str(error) and "\n" not in str(error), error
    else:
        raise AssertionError(f"{name} works without guara-perception")


def ask_node(endpoint: str) -> None:
    """Receive grids of a node in every way, and ask them."""
    with gp.TerrainClient(endpoint, timeout=60) as client:
        first = client.wait_for_step(0, timeout=120, allow_stale=True)
        grids = [first, client.latest(allow_stale=True), client.query(allow_stale=True)]
        grids.append(next(client.stream(timeout=60, allow_stale=True)))
    for terrain in grids:
        ask_grid(terrain)


def ask_grid(terrain: gp.TerrainGrid) -> None:
    """Ask all that a planner asks at the first free cell, and save and load the grid."""
    iy, ix = np.argwhere(terrain.hazard == 0)[0].tolist()
    axes = terrain.geometry.centres()
    x, y, stale = float(axes[0][ix]), float(axes[1][iy]), {"allow_stale": True}
    z = float(terrain.height_at(x, y, **stale))
    assert terrain.is_traversable(x, y, **stale) and terrain.hazard_at(x, y, **stale) == 0
    assert terrain.check_foothold(x, y, **stale).ok and terrain.best_foothold(x, y, 0.05, **stale) is not None
    assert terrain.steppable_region(x, y, 0.1, **stale) is not None and terrain.steppable_regions(**stale)
    assert terrain.height_scan([[x, y]], **stale).known.all() and terrain.to_occupancy(**stale).shape == terrain.shape
    assert terrain.swing((x, y, z), (x, y, z), 0.02, **stale).ok
    assert terrain.check_path([(x, y, z + 0.2), (x, y, z + 0.3)], 0.02, **stale).ok
    if find_spec("pinocchio") is None:
        refused("leg", lambda: terrain.check_foothold(x, y, leg="lf", **stale))
    with TemporaryDirectory() as folder:
        terrain.save(Path(folder, "t.npz"))
        assert gp.load_terrain(Path(folder, "t.npz")).hazard.tobytes() == terrain.hazard.tobytes()


def main() -> None:
    """Check what is here, what is not, and its size."""
    refused("calibrate", lambda: gp.calibrate)
    if find_spec("pinocchio") is None:
        refused("load_robot", lambda: gp.load_robot("guara"))
    assert "TerrainClient" in gp.__all__ and "calibrate" not in gp.__all__
    for endpoint in sys.argv[1:]:
        ask_node(endpoint)
    size = megabytes()
    name = f"guara-client on Python {sys.version.split()[0]} with numpy {np.__version__}"
    sys.stdout.write(f"{name}: {size:.0f} MB, {seconds():.2f} s to import\n")
    assert size <= LARGEST_MB, f"{size:.0f} MB, allowed: {LARGEST_MB}"


main()
