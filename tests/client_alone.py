"""A planner that has guara-client alone: `python -I -S client_alone.py SITE LIBRARIES HIDDEN GRIDS ENDPOINT`.

SITE holds the client's files, LIBRARIES all libraries of the tests; HIDDEN is the JSON list of those that the client
does not bring. It prints one line of JSON for every grid in GRIDS, and for every grid that a node hands it: the digests
of the answers. The test asks the same in its own process.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class Hidden:
    """A finder that finds nothing, and lets nobody else find what is hidden."""

    def __init__(self, names: list[str]) -> None:
        self.names = set(names)

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> None:
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def plain(value: Any) -> Any:
    """Values that compare to the last bit."""
    import numpy as np

    import guara_perception as gp

    if isinstance(value, gp.TerrainGrid):
        return None  # Verdicts hold the grid that they are about.
    if isinstance(value, np.ndarray | np.generic):
        return [str(value.dtype), value.shape, np.ascontiguousarray(value).tobytes().hex()]
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, list | tuple) else repr(value)


def answers(terrain: Any, seed: int, folder: Path) -> dict[str, str]:
    """Question -> digest of its answers at places drawn from a seed."""
    import numpy as np

    import guara_perception as gp

    rng = np.random.default_rng(seed)
    (x0, y0), (ny, nx), cell = terrain.origin, terrain.shape, terrain.resolution
    x, y = x0 + rng.uniform(-0.02, nx * cell + 0.02, 24), y0 + rng.uniform(-0.02, ny * cell + 0.02, 24)
    iy, ix = np.nonzero(terrain.hazard == 0)
    if iy.size:
        chosen = rng.integers(0, iy.size, 8)
        x[:8], y[:8] = x0 + (ix[chosen] + 0.3) * cell, y0 + (iy[chosen] + 0.6) * cell
    z = np.nan_to_num(terrain.height_at(x, y))
    places = list(zip(x.tolist(), y.tolist(), z.tolist(), strict=True))
    steps = list(zip(places[:8], places[1:9], strict=True))
    saved = folder / "again.npz"
    terrain.save(saved)
    again = gp.load_terrain(saved)
    found = {
        "height_at": terrain.height_at(x, y),
        "hazard_at": terrain.hazard_at(x, y),
        "is_traversable": terrain.is_traversable(x, y),
        "check_foothold": [terrain.check_foothold(x, y), *(terrain.check_foothold(a, b) for a, b, _ in places[:6])],
        "best_foothold": [terrain.best_foothold(a, b, 0.06) for a, b, _ in places[:6]],
        "best_refused": [terrain.best_refused(a, b, 0.03) for a, b, _ in places[8:10]],
        "check_path": [terrain.check_path([(*a[:2], a[2] + 0.1), (*b[:2], b[2] + 0.1)], 0.03) for a, b in steps],
        "swing": [terrain.swing(a, b, 0.02) for a, b in steps],
        "lift_off": [
            terrain.swing(sole[0], (sole[0, 0] + 0.14, sole[0, 1], 0.0), 0.02)
            for sole in (terrain.record.support_soles or {}).values()
        ],
        "steppable_region": [terrain.steppable_region(a, b, 0.15) for a, b, _ in places[:4]],
        "steppable_regions": terrain.steppable_regions(),
        "height_scan": terrain.height_scan(np.column_stack((x, y))),
        "to_occupancy": [terrain.to_occupancy(), terrain.to_occupancy(unknown=-1)],
        "save": [again.layers, again.origin, again.shape, again.stamp, again.step, json.dumps(dict(again.metadata))],
        "repr": repr(terrain),
    }
    return {name: hashlib.sha256(json.dumps(plain(value)).encode()).hexdigest() for name, value in found.items()}


def main(site: str, libraries: str, hidden: str, grids: str, endpoint: str) -> None:
    """Answer as a planner that has nothing else."""
    sys.path += [site, libraries]
    sys.meta_path.insert(0, Hidden(json.loads(hidden)))  # type: ignore[arg-type]
    import guara_perception as gp

    assert str(Path(gp.__file__).parents[1]) == site
    folder = Path(grids)
    for path in sorted(folder.glob("*.npz")):
        print(json.dumps(answers(gp.load_terrain(path), 0, folder.parent)), flush=True)
    with gp.TerrainClient(endpoint, timeout=180) as client:
        first = client.wait_for_step(1, timeout=180)
        for terrain in (first, client.latest(), client.query(timeout=180), next(client.stream(timeout=180))):
            print(json.dumps(answers(terrain, 0, folder.parent)), flush=True)
        print(json.dumps(str(terrain.stamp)), flush=True)
    for ask in (lambda: gp.calibrate, lambda: gp.load_robot("guara"), lambda: terrain.check_foothold(0.7, 0, leg="lf")):
        try:
            print(json.dumps(repr(ask())), flush=True)
        except ImportError as error:
            print(json.dumps(str(error)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
