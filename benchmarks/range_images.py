"""Range images of recorded scans beside their truth, their grid, and the grid that is made of them again.

`python -m benchmarks accuracy DATA --images`. A pixel is 0.88 x 0.84 mm, the truth is known every millimetre: a pixel
that is known counts as made up where camera or laser sees none of the millimetres that it covers.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

import guara_perception as gp
from benchmarks.command import Table
from guara_perception.app.scene.scene import range_image_messages
from guara_perception.scanning.pictures import COLUMNS, ROWS, cause_image, sigma_image_mm, with_pictures
from guara_perception.scanning.process import run_scan
from kinematics import RobotModel

# Edges of the truth's and the grid's cells [m].
MILLIMETRE, CELL = 0.001, 0.005
# An unknown pixel between known ones that are no further apart is a hole where the surface was seen.
HOLE_PIXELS = 2
ROUNDS = 5
HEAD = (
    "scan: | unknown pixels %:.1f | unknown cells %:.1f | ratio:.2f | ratio of a perfect image:.2f | made up: | "
    "in holes: | mean mm:.3f | hazards differ %:.2f | free alone: | ms:.0f | MB:.1f"
)


@dataclass(frozen=True, slots=True)
class ImageFigures:
    """Figures of one orthorectified range image.

    Attributes:
        unknown, unknown_cells: shares of the image's pixels and of the grid's cells.
        perfect: the ratio of the two for an image of all that camera and laser see, by truth.
        made_up: known pixels of which camera or laser sees nothing, and the same judged by their centres.
        surplus: unknown pixels in known cells, those that truth calls unseen, and those in holes.
        mean: of the differences of height between the grid made of the image and the scan's own [mm].
        differ: share of the cells whose hazards differ between the two.
        free_alone: cells that are free by the image only.
        seconds: processor time of drawing both images.
        size: of the three messages [bytes].
    """

    unknown: float
    unknown_cells: float
    perfect: float
    made_up: tuple[int, int]
    surplus: tuple[int, ...]
    mean: float
    differ: float
    free_alone: int
    seconds: float
    size: int

    def row(self) -> tuple[float, ...]:
        """Figures of the table, by HEAD."""
        shares = 100 * self.unknown, 100 * self.unknown_cells, _ratio(self.unknown, self.unknown_cells), self.perfect
        again = self.mean, 100 * self.differ, self.free_alone
        return *shares, self.made_up[0], self.surplus[2], *again, 1e3 * self.seconds, self.size / 1e6

    def budget(self, name: str) -> str:
        """Sentence on the unknown pixels of known cells."""
        whole, unseen, holes = self.surplus
        rest, percent = whole - unseen - holes, 100 / max(whole, 1)
        return (
            f"{name}: {whole} unknown pixels in known cells: {percent * unseen:.0f} % camera or laser cannot see, "
            f"{percent * holes:.1f} % in holes, {percent * rest:.0f} % between the last return and an edge; "
            f"{self.made_up[1]} known pixels have a centre that nobody sees, {self.made_up[0]} are wholly unseen"
        )


def image_figures(folder: Path, calibration: gp.Calibration, robot: RobotModel, rounds: int = 1) -> ImageFigures:
    """Figures of the scan in a folder with its truth."""
    processor = run_scan(gp.open_scan(folder), calibration, robot)
    bare, seconds = processor.finish(), []
    for _ in range(rounds):
        start = time.process_time()
        scan = with_pictures(bare, processor)
        seconds.append(time.process_time() - start)
    image = scan.pictures["ortho_image_mm"]
    with np.load(folder / "truth.npz") as truth:
        seen = truth["visible"] & truth["lit"] & ~truth["dark"]
    again = gp.terrain_from_range_image(image, cause_image(scan), sigma_mm=sigma_image_mm(scan), robot=robot)
    both = np.isfinite(again.elevation) & np.isfinite(scan.elevation)
    known, (centre_seen, any_seen) = np.isfinite(image), _seen_pixels(seen)
    x, y = (np.arange(ROWS) + 0.5) * 0.45 / ROWS, (np.arange(COLUMNS) + 0.5) * 0.54 / COLUMNS
    in_known_cell = np.isfinite(scan.elevation)[(y / CELL).astype(int)[None, :], (x / CELL).astype(int)[:, None]]
    side = round(CELL / MILLIMETRE)
    seen_cells = seen.reshape(seen.shape[0] // side, side, -1, side).any(axis=(1, 3))
    surplus, in_hole = ~known & in_known_cell, _holes(known)
    return ImageFigures(
        unknown=float((~known).mean()),
        unknown_cells=float(np.isnan(scan.elevation).mean()),
        perfect=_ratio(float((~centre_seen).mean()), float((~seen_cells).mean())),
        made_up=(int((known & ~any_seen).sum()), int((known & ~centre_seen).sum())),
        surplus=tuple(int(some.sum()) for some in (surplus, surplus & ~centre_seen, surplus & centre_seen & in_hole)),
        mean=float(np.abs(again.elevation - scan.elevation)[both].mean() * 1e3),
        differ=float((again.hazard != scan.hazard).mean()),
        free_alone=int(((again.hazard == 0) & (scan.hazard != 0)).sum()),
        seconds=min(seconds),
        size=sum(len(message.data) for message in range_image_messages(scan).values()),
    )


def _ratio(pixels: float, cells: float) -> float:
    """Ratio of the two shares; 1 where both are zero, as on an empty floor."""
    return pixels / cells if cells else 1.0 if not pixels else float("inf")


def _seen_pixels(seen: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Pixels (ROWS, COLUMNS) whose centre is seen, and those of which any millimetre is; `seen` is [iy, ix]."""

    def at(row: float, column: float) -> npt.NDArray[np.bool_]:
        """The millimetre at this share of each pixel's length and width."""
        iy, ix = (
            ((np.arange(count) + share) * length / count).astype(int)
            for count, share, length in zip((COLUMNS, ROWS), (column, row), seen.shape, strict=True)
        )
        return seen[np.ix_(iy, ix)].T

    # A pixel is shorter than a millimetre: its corners lie in all that it covers.
    ends = (1e-6, 1 - 1e-6)
    return at(0.5, 0.5), np.any([at(row, column) for row in ends for column in ends], axis=0)


def _holes(known: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Pixels between known ones of their row or column that are at most HOLE_PIXELS + 1 apart."""
    holes = np.zeros(known.shape, dtype=bool)
    for axis in (0, 1):
        for before in range(1, HOLE_PIXELS + 1):
            for behind in range(1, HOLE_PIXELS + 2 - before):
                holes |= np.roll(known, before, axis) & np.roll(known, -behind, axis)
    return holes


def print_images(folders: list[tuple[str, Path, gp.Calibration]], robot: RobotModel) -> None:
    """Print a row for each scan and, below the table, where the unknown pixels of known cells come from."""
    table, budgets = Table(HEAD, markdown=True), []
    for name, folder, calibration in folders:
        found = image_figures(folder, calibration, robot, ROUNDS)
        table.row(name, *found.row())
        budgets.append(found.budget(name))
    print("must: ratio 1.15, made up 0, mean 0.1 mm, hazards differ 2 %, free alone 0", *budgets, sep="\n")
