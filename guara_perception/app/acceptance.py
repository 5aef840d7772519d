"""Acceptance test of a rangefinder: blocks of known height on a flat floor, with a power cycle before each scan."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from guara_perception.app.calibration_report.drawing import BLUE, ORANGE, new_figure, to_png
from guara_perception.app.calibration_report.html import STYLE, image, table
from guara_perception.app.summary import facts
from guara_perception.arrays import Float, Image
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput, PerceptionError
from guara_perception.files import write_text
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.fuse_scan import pose_variance
from guara_perception.terrain.questions.obstacles import fit_floor
from kinematics.arrays import FrozenArrays

if TYPE_CHECKING:
    from guara_perception.app.node.rangefinder import Rangefinder

FORMAT: Final = "guara-acceptance/1"
REPORT_FILE: Final = "report.html"
# Lowest and highest block allowed [m]; a lower one may not be detected as an obstacle.
LOWEST_M, HIGHEST_M = 0.008, 0.5
# Smallest difference between heights [m], because blocks are identified by height; largest number of blocks.
LEAST_APART_M, MOST_BLOCKS = 0.005, 6
# Distance from the outline of a block within which a cell may contain its edge [m].
RIM_M = 0.010
# Largest error allowed, as a multiple of the standard deviation stated by the grid.
SIGMAS = 3.0


class AcceptanceFailed(PerceptionError, RuntimeError):
    """Scan that does not show exactly the given blocks. Earlier scans are kept; the same command resumes the test."""


@dataclass(frozen=True, slots=True)
class Turn(FrozenArrays):
    """Measurement of the blocks in one scan, lowest block first.

    Attributes:
        heights: (n,) measured heights above the floor [m].
        sigmas: (n,) stated standard deviations of the heights [m]: for each block, the median over its inner cells,
            combined with the standard deviation of the floor. The pose error, shared by blocks and floor, is excluded.
        known: fraction of the grid that is known.
        reasons: reasons why the grid's health is not "ok".
    """

    heights: Float
    sigmas: Float
    known: float
    reasons: tuple[str, ...]


def parse_blocks(text: str) -> tuple[float, ...]:
    """Parse comma-separated heights of blocks [m]; return them in ascending order.

    Raises:
        InvalidInput: a height is not a number or out of range, there are too many heights, or two are nearly equal.
    """
    try:
        heights = tuple(sorted(float(height) for height in text.split(",")))
    except ValueError:
        raise InvalidInput(f"--blocks is {text!r}, allowed: heights in metres, separated by commas") from None
    in_range = all(LOWEST_M <= height <= HIGHEST_M for height in heights)
    if not in_range or len(heights) > MOST_BLOCKS or np.diff(heights).min(initial=1.0) < LEAST_APART_M:
        raise InvalidInput(
            f"--blocks is {text!r}, allowed: 1 ... {MOST_BLOCKS} heights of {LOWEST_M:g} ... {HIGHEST_M:g} m, "
            f"{LEAST_APART_M:g} m or more apart; give metres"
        )
    return heights


def measure(terrain: TerrainGrid, heights: Sequence[float]) -> Turn:
    """Measure the blocks in a grid: for each block, the median height of its inner cells above the fitted floor.

    Args:
        terrain: grid of one scan of a floor with nothing but the blocks on it.
        heights: true heights in ascending order [m].

    Raises:
        AcceptanceFailed: the grid does not show exactly these blocks.
    """
    rows, columns = np.nonzero(np.isfinite(terrain.elevation))
    x, y = (centres.take(index) for centres, index in zip(terrain.geometry.centres(), (columns, rows), strict=True))
    z, variance, local = (
        layer[rows, columns].astype(np.float64)
        for layer in (terrain.elevation, terrain.variance, terrain.variance_local)
    )
    # Exclude the variance of the pose, because the pose error is the same for floor and blocks.
    sigma = np.sqrt(np.maximum(variance - pose_variance(terrain, x, y), local))
    floor = fit_floor(x, y, z)
    found = []
    for block in terrain.obstacles():
        outline = block.outline.astype(np.float32)
        inside = np.array([cv2.pointPolygonTest(outline, point, True) > RIM_M for point in zip(x, y, strict=True)])
        if floor is not None and block.height > 0.5 * heights[0] and inside.any():
            rise = z[inside] - floor.height_at(x[inside], y[inside])
            found.append((float(np.median(rise)), float(np.median(np.hypot(sigma[inside], floor.sigma)))))
    found.sort()
    measured = np.array([height for height, _ in found])
    limit = 0.5 * np.diff(heights).min(initial=2 * LEAST_APART_M)
    if len(found) != len(heights) or np.abs(measured - heights).max() > limit:
        seen = ", ".join(f"{1e3 * height:.1f}" for height in measured)
        raise AcceptanceFailed(
            f"the scan shows {f'blocks of {seen} mm' if seen else 'no blocks'}, allowed: those of --blocks "
            f"({', '.join(f'{1e3 * height:g}' for height in heights)} mm): place them 5 cm or more apart, entirely in "
            f"the scanned area, each {4e3 * RIM_M:.0f} mm wide or wider, with nothing else in view"
        )
    record = terrain.record
    reasons = record.health.reasons if record.health else ()
    return Turn(measured, np.array([spread for _, spread in found]), facts(terrain)["known"], reasons)


def device_facts(rangefinder: Rangefinder, calibration: Calibration, picture: Image) -> dict[str, str]:
    """Describe the open devices, their calibration, the ambient light and the software, for a report.

    Args:
        rangefinder: open devices.
        calibration: calibration of the devices.
        picture: laser-off image, for the brightness of the ambient light.
    """
    brightness = float(picture.mean()) / np.iinfo(picture.dtype).max
    identity, locked = rangefinder.board.identity, rangefinder.settings
    settings = asdict(locked).items() if locked is not None else ()
    held = ", ".join(
        f"{name} {value:g}{' s' * (name == 'exposure')}" for name, value in settings if isinstance(value, float)
    )
    size, quality = calibration.camera.size, calibration.quality
    return {
        "camera": f"{rangefinder.camera.name}, {size[0]} x {size[1]} px; {held or 'no setting is locked'}",
        "laser board": f"firmware {'.'.join(map(str, identity.firmware))}, protocol "
        f"{'.'.join(map(str, identity.protocol))}, serial {getattr(rangefinder.board, 'serial', '') or 'none'}",
        "calibration": f"hash {calibration.hash or 'none'}, created: {calibration.created}, verdict "
        f"{quality.get('verdict')}, {len(calibration.stripes)} stripes",
        "light": f"the picture without the laser is at {100 * brightness:.0f} % of full scale",
        "programs": f"guara-perception {version('guara-perception')}, numpy {np.__version__}, OpenCV "
        f"{cv2.__version__}, Python {platform.python_version()}, {platform.system()} {platform.machine()}",
    }


@dataclass(frozen=True, slots=True)
class Acceptance:
    """Result of an acceptance test.

    Attributes:
        blocks: true heights in ascending order [m].
        turns: measurements, one per scan.
        device: facts about the device, from `device_facts`.
        note: the operator's note on light, floor and blocks.
        is_simulated: True if no real device was used.
    """

    blocks: tuple[float, ...]
    turns: tuple[Turn, ...]
    device: dict[str, str]
    note: str
    is_simulated: bool

    @property
    def errors(self) -> Float:
        """(turns, blocks) measured minus true heights [m]."""
        return np.array([turn.heights for turn in self.turns]) - np.array(self.blocks)

    @property
    def is_held(self) -> bool:
        """True if every error is within SIGMAS standard deviations stated by its grid."""
        return bool(np.all(np.abs(self.errors) <= SIGMAS * np.array([turn.sigmas for turn in self.turns])))

    @property
    def verdict(self) -> str:
        """Verdict as one sentence."""
        worst = 1e3 * float(np.abs(self.errors).max())
        passed = "passed: all" if self.is_held else "FAILED: not all"
        return (
            f"{passed} heights are within {SIGMAS:g} times the standard "
            f"deviation stated by the grid; largest error {worst:.2f} mm in {len(self.turns)} scans of "
            f"{len(self.blocks)} block{'s' * (len(self.blocks) > 1)}"
        )

    def save(self, folder: Path) -> Path:
        """Write acceptance.json and report.html to a folder; return the path of the report."""
        data = {"format": FORMAT, "is_held": self.is_held, **asdict(self)}
        for turn in data["turns"]:
            turn.update(heights=turn["heights"].tolist(), sigmas=turn["sigmas"].tolist())
        for name, text in (("acceptance.json", json.dumps(data, indent=2)), (REPORT_FILE, self._page())):
            write_text(folder / name, text)
        return folder / REPORT_FILE

    def _page(self) -> str:
        errors, known = 1e3 * self.errors, [turn.known for turn in self.turns]
        sigmas = 1e3 * np.array([turn.sigmas for turn in self.turns])
        blocks = [
            (f"{1e3 * true:g}", f"{of.mean():+.2f}", f"{np.abs(of).max():.2f}", f"{of.std(ddof=1):.3f}", f"{s:.2f}")
            for true, of, s in zip(self.blocks, errors.T, np.median(sigmas, axis=0), strict=True)
        ]
        turns = [
            (str(i), " ".join(f"{e:+.2f}" for e in of), f"{100 * turn.known:.1f} %", "; ".join(turn.reasons) or "ok")
            for i, (of, turn) in enumerate(zip(errors, self.turns, strict=True), start=1)
        ]
        head = ("height [mm]", "mean error", "largest error", "repeatability (one sigma)", "stated sigma")
        kind = "A simulated device; no real device was involved." if self.is_simulated else "A real device."
        return "\n".join(
            [
                '<!doctype html><html lang="en"><meta charset="utf-8"><title>Acceptance report</title>',
                f"<style>{STYLE}</style><h1>Acceptance of a rangefinder</h1>",
                f'<p class="verdict {"good" if self.is_held else "refused"}">{escape(self.verdict)}</p>',
                f"<p><b>{kind}</b> A real device is switched off and on before each scan, and its mirror homed again. "
                f"Known cells: {100 * min(known):.1f} ... {100 * max(known):.1f} %.</p><h2>Blocks</h2>",
                table(blocks, head),
                f"{image(self._errors_png(), 'error of each block and scan')}<h2>Scans</h2>",
                table(turns, ("scan", "errors, lowest block first [mm]", "known cells", "health")),
                "<h2>Device</h2>",
                table([*self.device.items(), ("note", self.note or "none given")], ("", "")),
                "</html>",
            ]
        )

    def _errors_png(self) -> bytes:
        figure, (axes,) = new_figure(9.0, 3.2)
        for number, turn in enumerate(self.turns):
            axes.errorbar(
                np.arange(len(self.blocks)) + 0.05 * (number - len(self.turns) / 2),
                1e3 * self.errors[number],
                SIGMAS * 1e3 * turn.sigmas,
                fmt="o",
                color=BLUE,
                ecolor=ORANGE,
                markersize=3,
            )
        axes.axhline(0, color="black", linewidth=0.6)
        axes.set(ylabel="error [mm], bars: three sigmas", xticks=range(len(self.blocks)))
        axes.set_xticklabels([f"{1e3 * height:g} mm" for height in self.blocks])
        return to_png(figure)
