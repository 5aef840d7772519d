"""Size and time of a grid in both encodings: `python -m benchmarks transport compact`.

Recorded scans of the tests' data, and the map that one of them makes; processor time, median of 30 rounds.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.rounds import alternate
from guara_perception.app.messages import terrain_to_message
from kinematics import PoseInOdom, load_robot
from testbed.truth import truth_calibration
from transport import decode_terrain, encode_terrain
from transport.messages.terrain_message import encode_compact

DATA = Path(__file__).parents[1] / "tests" / "data"
SCANS = ("paper", "dark", "tilt")
ROUNDS = 30


def main() -> None:
    """Size and time of grids in both encodings."""
    options(__doc__)
    table = Table("grid:<18 | encoding:<9 | bytes:9d | of lossless:.3f | make ms:8.2f | read ms:8.2f")
    for name, grid in grids():
        for row in measured(name, grid):
            table.row(*row.values())


def grids() -> list[tuple[str, gp.TerrainGrid]]:
    """Grids of recorded scans, and a fused map of the first."""
    robot, calibration = load_robot("guara"), truth_calibration(DATA)
    found = []
    for name in SCANS:
        grid = gp.process_scan(gp.open_scan(DATA / "scans" / name), calibration, robot)
        found.append((f"{name}, footprint", grid))
    walk = gp.TerrainMap(robot)
    found.append(("map of one scan", walk.update(found[0][1], PoseInOdom(np.eye(4), 1e-8 * np.eye(6)))))
    return found


def measured(name: str, grid: gp.TerrainGrid) -> list[dict[str, Any]]:
    """A row for each encoding."""
    message = terrain_to_message(grid, robot="guara", sequence=1)
    rows: list[dict[str, Any]] = []
    for encoding, encode in (("lossless", encode_terrain), ("compact", encode_compact)):
        payload = encode(message)
        times = alternate({"make": partial(encode, message), "read": partial(decode_terrain, payload)}, ROUNDS)
        row: dict[str, Any] = {"grid": name, "encoding": encoding, "bytes": len(payload)}
        row["share"] = len(payload) / (rows[0]["bytes"] if rows else len(payload))
        rows.append(row | {f"{work}_ms": times.milliseconds(work) for work in ("make", "read")})
    return rows
