"""Size and time of a grid in both encodings: `python -m benchmarks transport compact`.

Recorded scans of the tests' data, and the map that one of them makes; processor time, median of 30 interleaved rounds.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import guara_perception as gp
from guara_perception.app.messages import terrain_to_message
from kinematics import PoseInOdom, load_robot
from testbed.truth import truth_calibration
from transport import decode_terrain, encode_terrain
from transport.messages.compact import encode_compact

DATA = Path(__file__).parents[1] / "tests" / "data"
SCANS = ("paper", "dark", "tilt")
ROUNDS = 30
# Rates of the links [bit/s].
LINKS = (2e6, 5e6, 20e6)


def main() -> None:
    """Size and time of grids in both encodings [--data FOLDER, --json]."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA, help="folder with calibration/ and scans/")
    parser.add_argument("--json", action="store_true", help="the last line is one JSON object")
    options = parser.parse_args()
    rows = [row for name, grid in grids(options.data) for row in measured(name, grid)]
    print(f"{'grid':<18} {'encoding':<9} {'bytes':>9} {'of lossless':>11} {'make ms':>8} {'read ms':>8}", end="")
    print("".join(f"{f'{rate / 1e6:g} Mbit/s':>12}" for rate in LINKS))
    for row in rows:
        print(f"{row['grid']:<18} {row['encoding']:<9} {row['bytes']:>9} {row['share']:>11.3f}", end="")
        print(f"{row['make_ms']:>9.2f} {row['read_ms']:>8.2f}", end="")
        print("".join(f"{8e3 * row['bytes'] / rate:>9.0f} ms" for rate in LINKS))
    if options.json:
        print(json.dumps({"compact": rows}))


def grids(data: Path) -> list[tuple[str, gp.TerrainGrid]]:
    """Grids of recorded scans, and a fused map of the first."""
    robot, calibration = load_robot("guara"), truth_calibration(data)
    found = []
    for name in SCANS:
        grid = gp.process_scan(gp.open_scan(data / "scans" / name), calibration, robot)
        found.append((f"{name}, footprint", grid))
    walk = gp.TerrainMap(robot)
    found.append(("map of one scan", walk.update(found[0][1], PoseInOdom(np.eye(4), 1e-8 * np.eye(6)))))
    return found


def measured(name: str, grid: gp.TerrainGrid) -> list[dict[str, Any]]:
    """A row for each encoding."""
    message = terrain_to_message(grid, robot="guara", sequence=1)
    makers: dict[str, Callable[[], bytes | bytearray]] = {
        "lossless": lambda: encode_terrain(message),
        "compact": lambda: encode_compact(message),
    }
    payloads = {encoding: make() for encoding, make in makers.items()}
    times: dict[str, list[tuple[float, float]]] = {encoding: [] for encoding in makers}
    for _ in range(ROUNDS):
        for encoding, make in makers.items():
            times[encoding].append((spent(make), spent(partial(decode_terrain, payloads[encoding]))))
    rows = []
    for encoding, payload in payloads.items():
        make, read = np.median(times[encoding], axis=0)
        share = len(payload) / len(payloads["lossless"])
        row = {"grid": name, "encoding": encoding, "bytes": len(payload), "share": share}
        rows.append(row | {"make_ms": 1e3 * float(make), "read_ms": 1e3 * float(read)})
    return rows


def spent(work: Callable[[], object]) -> float:
    """Processor time of a call [s]."""
    start = time.process_time()
    work()
    return time.process_time() - start
