"""Prints the error of every scan of a data folder against its truth, as the data's README defines it."""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from kinematics import load_robot
from tests.truth import truth_calibration

# From a change of height this large inside 3 x 3 mm, cells this near are no interior.
JUMP_M = 0.003
INTERIOR_MARGIN_MM = 6
# A known cell that nobody could see must at least lie within its true heights by this much.
UNSEEN_TOLERANCE_M = 0.002


@dataclass(frozen=True)
class Truth:
    """Truth of a scan per grid cell, (ny, nx) each."""

    mean: npt.NDArray[np.float64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    interior: npt.NDArray[np.bool_]
    unseen: npt.NDArray[np.bool_]
    dark: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Figures:
    """Figures of one scan; millimetres and per cent."""

    mean: float
    p95: float
    worst: float
    near: float
    far: float
    bias: float
    bias_near: float
    bias_far: float
    known: float
    unseen_known: float
    unseen_wrong: int
    dark_known: float
    unsafe: int


def load_truth(path: Path, cell_mm: int) -> Truth:
    """Truth of a recorded scan."""
    with np.load(path) as data:
        seen = data["visible"] & data["lit"] & ~data["dark"]
        return truth_of(data["elevation"].astype(np.float64), seen, data["dark"], cell_mm)


def truth_of(
    elevation: npt.NDArray[np.float64], seen: npt.NDArray[np.bool_], dark: npt.NDArray[np.bool_], cell_mm: int
) -> Truth:
    """Truth at 1 mm, a[iy, ix], gathered into cells of `cell_mm`."""
    kernel = np.ones((3, 3), np.uint8)
    relief = cv2.dilate(elevation, kernel) - cv2.erode(elevation, kernel)
    side = 2 * INTERIOR_MARGIN_MM + 1
    near_jump = cv2.dilate((relief > JUMP_M).astype(np.uint8), np.ones((side, side), np.uint8)) > 0

    def cells(layer: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        ny, nx = (n // cell_mm for n in layer.shape)
        return layer.reshape(ny, cell_mm, nx, cell_mm).swapaxes(1, 2).reshape(ny, nx, -1)

    heights = cells(elevation)
    return Truth(
        mean=heights.mean(axis=-1),
        low=heights.min(axis=-1),
        high=heights.max(axis=-1),
        interior=np.asarray(cells(seen & ~near_jump).all(axis=-1)),
        unseen=np.asarray(~cells(seen).any(axis=-1)),
        dark=np.asarray(cells(dark).all(axis=-1)),
    )


def figures(terrain: gp.TerrainGrid, truth: Truth) -> Figures:
    """Compare a grid with its truth."""
    elevation = terrain.elevation.astype(np.float64)
    known = np.isfinite(elevation)
    error = (elevation - truth.mean) * 1e3
    used = truth.interior & known
    third = elevation.shape[1] // 3
    near, far = used.copy(), used.copy()
    near[:, third:] = False
    far[:, : elevation.shape[1] - third] = False
    unseen = truth.unseen & known
    wrong = unseen & ((elevation > truth.high + UNSEEN_TOLERANCE_M) | (elevation < truth.low - UNSEEN_TOLERANCE_M))
    traversable = terrain.traversability > 0
    return Figures(
        mean=_mean(np.abs(error[used])),
        p95=float(np.percentile(np.abs(error[used]), 95)) if used.any() else np.nan,
        worst=float(np.abs(error[used]).max()) if used.any() else np.nan,
        near=_mean(np.abs(error[near])),
        far=_mean(np.abs(error[far])),
        bias=_mean(error[used]),
        bias_near=_mean(error[near]),
        bias_far=_mean(error[far]),
        known=_share(used, truth.interior),
        unseen_known=_share(unseen, truth.unseen),
        unseen_wrong=int(wrong.sum()),
        dark_known=_share(truth.dark & known, truth.dark),
        unsafe=int((traversable & (truth.unseen | truth.dark)).sum()),
    )


def _mean(values: npt.NDArray[np.float64]) -> float:
    return float(values.mean()) if values.size else np.nan


def _share(part: npt.NDArray[np.bool_], whole: npt.NDArray[np.bool_]) -> float:
    return 100.0 * float(part.sum()) / float(whole.sum()) if whole.any() else 0.0


HEADER = (
    f"{'scan':<21} {'method':<7} {'mean':>6} {'p95':>5} {'worst':>5} | {'near':>5} {'far':>5} | "
    f"{'bias':>6} {'near':>6} {'far':>6} | {'known%':>6} {'unseen%':>8} {'wrong':>5} {'dark%':>6} {'unsafe':>6} | time"
)


def row(name: str, method: str, f: Figures, seconds: float) -> str:
    """One line of the table."""
    return (
        f"{name:<21} {method:<7} {f.mean:6.3f} {f.p95:5.2f} {f.worst:5.2f} | {f.near:5.3f} {f.far:5.3f} | "
        f"{f.bias:+.3f} {f.bias_near:+.3f} {f.bias_far:+.3f} | {f.known:6.2f} {f.unseen_known:8.2f} "
        f"{f.unseen_wrong:5d} {f.dark_known:6.2f} {f.unsafe:6d} | {seconds:.1f} s"
    )


def add_data(parser: argparse.ArgumentParser) -> None:
    """Arguments that say which recorded scans take part."""
    parser.add_argument("data", type=Path, nargs="+", help="data folders with calibration/ and scans/")
    parser.add_argument("-c", "--calibration", type=Path, help="calibration.json; default: the truth of each folder")
    parser.add_argument("--scans", default="", help="comma-separated names of scans; default: all")


def scans_with_truth(arguments: argparse.Namespace) -> Iterator[tuple[str, gp.Scan, Truth, gp.Calibration]]:
    """Name, scan, truth by cells of 5 mm and calibration of every scan that `add_data` asks for."""
    for data in arguments.data:
        calibration = gp.load_calibration(arguments.calibration) if arguments.calibration else truth_calibration(data)
        for path in sorted(data.glob("scans/*/truth.npz")):
            if not arguments.scans or path.parent.name in arguments.scans.split(","):
                yield f"{data.name}/{path.parent.name}", gp.open_scan(path.parent), load_truth(path, 5), calibration


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_data(parser)
    parser.add_argument("--method", default="precise", help="comma-separated methods")
    parser.add_argument("--no-gravity", action="store_true", help="leave gravity out of each stance")
    parser.add_argument("--no-off", action="store_true", help="leave out the frames with the laser off")
    arguments = parser.parse_args()
    robot = load_robot("guara")
    print("millimetres; interior cells of 5 mm against the mean truth of the cell")
    print(HEADER)
    for name, scan, truth, calibration in scans_with_truth(arguments):
        if arguments.no_gravity:
            scan = dataclasses.replace(scan, stance=dataclasses.replace(scan.stance, gravity_in_base=None))
        if arguments.no_off:
            stripes = tuple(dataclasses.replace(stripe, off=None) for stripe in scan.stripes)
            scan = dataclasses.replace(scan, stripes=stripes)
        for method in arguments.method.split(","):
            start = time.perf_counter()
            terrain = gp.process_scan(scan, calibration, robot, method=method, pictures=False)
            seconds = time.perf_counter() - start
            print(row(name, method, figures(terrain, truth), seconds), flush=True)


if __name__ == "__main__":
    main()
