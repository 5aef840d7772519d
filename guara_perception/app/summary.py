"""One line that says what a grid holds."""

from __future__ import annotations

import numpy as np

from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, cells_by_flag


def summary(terrain: TerrainGrid) -> str:
    """Step, mode, how much is known and safe, the commonest causes, and what is wrong with the scan if anything."""
    hazard = np.asarray(terrain.hazard)
    known = float(np.mean((hazard & UNKNOWN_MASK) == 0))
    safe = float(np.mean(np.asarray(terrain.traversability) > 0))
    counts = cells_by_flag(hazard)
    most = sorted((name for name, n in counts.items() if n), key=lambda name: -counts[name])[:4]
    parts = [
        f"step {terrain.step}",
        str(terrain.metadata.get("mode", "?")),
        f"{terrain.shape[1]}x{terrain.shape[0]} cells of {terrain.resolution * 1e3:g} mm",
        f"known {known:.0%}",
        f"traversable {safe:.0%}",
        f"attitude from {terrain.metadata.get('attitude_source', '?')}",
    ]
    if most:
        parts.append("hazards " + " ".join(f"{name} {counts[name]}" for name in most))
    reasons = terrain.metadata.get("health", {}).get("reasons", [])
    if reasons:
        parts.append("; ".join(reasons))
    return ", ".join(parts)
