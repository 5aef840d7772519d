"""Stripe extraction on photographs of real laser lines, compared with textbook methods.

`python -m benchmarks.photographs FOLDER`: FOLDER holds index.json (set, name, on, off, along, colour) and truth.npz,
per picture where a stripe is seen (must), where one may be returned (may) and where none may be (gap). Families of one
camera, laser and scene count alike, whatever their number of pictures.
`--board FOLDER`: calib<i>.jpg and light<i>.jpg there show a board of 7 x 7 dots without and with a line; all lines lie
in one plane, and each picture is measured by the plane of the others.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.photograph_peers import PEERS, read
from guara_perception.arrays import Float, Image
from testbed.run_ends import run_ends

Method = Callable[[Image, Image | None, str, int], Float]

# The laser's channel by its letter in the index; a mono picture has one.
CHANNELS = {"b": 0, "g": 1, "r": 2, "m": 0}

# A position this near is right; where a stripe is only allowed it may be off by this much more.
RIGHT_PX, MARGIN_PX = 3.0, 2.0
BAND_PIXELS = 640 * 160
# The board: dots along each side, their distance [m], pictures; error from which a point is off [mm].
DOTS, DOT_PITCH_M, BOARD_PICTURES, OFF_MM = 7, 0.0375, range(12), 1.0


@dataclass
class Counts:
    """Counts over the pictures of one family."""

    seen: int = 0
    right: int = 0
    gross: int = 0
    gaps: int = 0
    filled: int = 0
    squares: float = 0.0
    seconds: float = 0.0
    pixels: int = 0

    @property
    def coverage(self) -> float:
        """Share of the stripe that was found."""
        return self.right / max(self.seen, 1)

    @property
    def gross_share(self) -> float:
        """Share of the positions returned for the stripe that are wrong by more than RIGHT_PX."""
        return self.gross / max(self.right + self.gross, 1)

    @property
    def filled_share(self) -> float:
        """Share of the gaps in which a position was returned; NaN without gaps."""
        return self.filled / self.gaps if self.gaps else float("nan")

    @property
    def shares(self) -> tuple[float, float, float]:
        """Shares found, gross and filled."""
        return self.coverage, self.gross_share, self.filled_share

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the right positions from the truth, which is good to a third of a pixel [px]."""
        return float(np.sqrt(self.squares / max(self.right, 1)))

    @property
    def band_ms(self) -> float:
        """Processor time of a band of 640 x 160 pixels [ms]."""
        return 1e3 * self.seconds / max(self.pixels, 1) * BAND_PIXELS

    def add(self, position: Float, must: Float, may: Float, gap: npt.NDArray[np.bool_]) -> None:
        """Count one picture."""
        is_seen = np.isfinite(must)
        error = np.abs(position - must)[is_seen]
        beside = np.isfinite(may) & ~is_seen
        self.seen += int(is_seen.sum())
        self.right += int((error <= RIGHT_PX).sum())
        self.gross += int((error > RIGHT_PX).sum())
        self.gross += int((np.abs(position - may)[beside] > RIGHT_PX + MARGIN_PX).sum())
        self.gaps += int(gap.sum())
        self.filled += int(np.isfinite(position[gap]).sum())
        self.squares += float((error[error <= RIGHT_PX] ** 2).sum())


def product(on: Image, off: Image | None, along: str, _channel: int) -> Float:
    """This package's precise method, which is not given the laser's colour."""
    return gp.extract_stripe(on, off=off, along=along).position_px.astype(np.float64)


def judge(folder: Path, method: Method, *, with_off: bool) -> dict[str, Counts]:
    """Counts of every family.

    Args:
        folder: folder of the photographs.
        method: gives a position for each column (row) of a picture, NaN where there is none.
        with_off: judge only pictures with a laser-off picture, and use it.
    """
    families: dict[str, Counts] = {}
    with np.load(folder / "truth.npz") as truth:
        for item in json.loads((folder / "index.json").read_text()):
            if with_off and not item["off"]:
                continue
            on, off = (read(folder, item[name], item["colour"]) for name in ("on", "off"))
            assert on is not None
            counts = families.setdefault(item["set"], Counts())
            start = time.process_time()
            position = method(on, off if with_off else None, item["along"], CHANNELS[item["colour"]])
            counts.seconds += time.process_time() - start
            counts.pixels += on.shape[0] * on.shape[1]
            name = f"{item['set']}/{item['name']}"
            counts.add(position, *(truth[f"{name}.{kind}"] for kind in ("must", "may", "gap")))
    return families


def means(families: dict[str, Counts]) -> tuple[float, float, float]:
    """Mean coverage, gross share and filled share of the families."""
    coverage, gross, filled = np.nanmean([counts.shares for counts in families.values()], axis=0).tolist()
    return coverage, gross, filled


def report(folder: Path) -> None:
    """Print both tables."""
    methods: dict[str, Method] = {"product": product, **PEERS}
    for with_off in (False, True):
        print(f"\n{'with' if with_off else 'without'} laser-off pictures: coverage / gross / gaps filled")
        judged = {name: judge(folder, method, with_off=with_off) for name, method in methods.items()}
        table = Table(" | ".join(["family:<8", "rms px:.2f", "ms:6.1f", *(f"{name}:>20" for name in judged)]))
        shares = "{:.3f} / {:.3f} / {:.2f}".format
        for family, own in judged["product"].items():
            cells = (shares(*counts[family].shares) for counts in judged.values())
            table.row(family, own.rms_px, own.band_ms, *cells)
        table.row("mean", None, None, *(shares(*means(families)) for families in judged.values()))


def fitted_plane(points: Float) -> tuple[Float, float]:
    """Normal (3,) and distance of the plane of most of the points (n, 3)."""
    used = np.ones(len(points), bool)
    for _ in range(5):
        middle = points[used].mean(axis=0)
        normal = np.linalg.svd(points[used] - middle, full_matrices=False)[2][2]
        far = np.abs((points - middle) @ normal)
        used = far < 4 * 1.4826 * np.median(far)
    return normal, float(normal @ middle)


def board_points(folder: Path, *, with_off: bool) -> list[tuple[Float, npt.NDArray[np.bool_]]]:
    """Points (n, 3) of the line on the board of each picture [m], and a mask of those that a scan uses (`run_ends`).

    Args:
        folder: folder of the pictures.
        with_off: also pass the pictures without the laser to the extraction.
    """
    marks = np.array([(x, y, 0) for y in range(DOTS) for x in range(DOTS)], np.float32) * DOT_PITCH_M
    names = [[f"{kind}{i}.jpg" for kind in ("light", "calib")] for i in BOARD_PICTURES]
    pairs = [[np.asarray(read(folder, name, "r")) for name in pair] for pair in names]
    centres = [cv2.findCirclesGrid(off, (DOTS, DOTS))[1] for _, off in pairs]
    size = pairs[0][0].shape[1::-1]
    _, matrix, lens, turns, shifts = cv2.calibrateCamera([marks] * len(pairs), centres, size, None, None)
    found: list[tuple[Float, npt.NDArray[np.bool_]]] = []
    for (on, off), turn, shift in zip(pairs, turns, shifts, strict=True):
        profile = gp.extract_stripe(on, off if with_off else None)
        rotation, origin = cv2.Rodrigues(turn)[0], shift[:, 0]
        pixels = np.column_stack((np.arange(size[0]), np.nan_to_num(profile.position_px))).astype(np.float64)
        rays = np.column_stack((cv2.undistortPoints(pixels[:, None], matrix, lens)[:, 0], np.ones(size[0])))
        points = rays * ((rotation[:, 2] @ origin) / (rays @ rotation[:, 2]))[:, None]
        on_board = (points - origin) @ rotation
        seen = np.isfinite(profile.position_px) & (np.abs(on_board[:, :2] / DOT_PITCH_M - 3) < DOTS / 2).all(axis=1)
        height = np.where(np.isfinite(profile.position_px), points[:, 1], np.nan)
        ends = run_ends(height[None], np.asarray(profile.peak[None], np.float64))[0]
        found.append((np.asarray(points[seen], np.float64), ~ends[seen]))
    return found


def report_board(folder: Path) -> None:
    """Print how many points are off, with and without the pictures without the laser."""
    for with_off in (False, True):
        found = board_points(folder, with_off=with_off)
        errors, kept = [], []
        for number, (points, usable) in enumerate(found):
            normal, distance = fitted_plane(
                np.concatenate([other for k, (other, _) in enumerate(found) if k != number])
            )
            errors.append(1e3 * np.abs(points @ normal - distance))
            kept.append(usable)
        error, used = np.concatenate(errors), np.concatenate(kept)
        for name, each in (("extracted", error), ("used by a scan", error[used])):
            print(
                f"board, {'with' if with_off else 'without'} laser-off pictures, {name}: "
                f"{np.count_nonzero(each > OFF_MM)} of {each.size} points are off by more than {OFF_MM:.0f} mm, "
                f"worst {each.max():.1f}, 95 % within {np.percentile(each, 95):.2f}"
            )


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        FOLDER=(Path, "folder with index.json, truth.npz and the pictures"),
        board=(Path, "folder with pictures of a board; then only these are measured"),
    )
    cv2.setNumThreads(1)
    if asked.board is not None:
        report_board(asked.board)
        return
    if (asked.folder / "index.json").is_file():
        report(asked.folder)
    else:
        missing = "no index.json there; the photographs are not part of the repository, nothing was measured"
        print(f"{asked.folder}: {missing}")


if __name__ == "__main__":
    main()
