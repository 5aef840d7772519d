"""What is wrong with a scan of few returns: where its light lies against where the calibration expects each stripe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.calibration.calibration import Calibration
from guara_perception.frame_pair import FramePair
from guara_perception.ranging.scan_geometry import ScanGeometry
from guara_perception.stripes.glance import brightest_rows

# [m] The lines of the stripes on z = 0 are drawn this far to both sides.
HALF_LENGTH_M = 0.6
# Columns that a glance takes from each frame, spread over the picture.
GLANCED = 12
# A frame fits a stripe when half of its light lies within this of it: less than half a pitch of neighbouring stripes.
FIT_PX_OF_HEIGHT = 0.008
# Frames of a scan that are glanced at, spread over its sweep: a glance costs half of what finding a stripe does.
GLANCED_FRAMES = 12
# Frames that must fit for a cause to be named, as a share and in number.
FITTING_SHARE = 0.6
FEWEST_FRAMES = 4
# A part of the frames that fits otherwise than the rest is reported from here on.
MIXED_SHARE = 0.15
TURNED, FLIPPED, UPRIGHT = "turned by 180 degrees", "flipped top to bottom", ""


class Glances:
    """Where the brightest light of some frames of a scan is, whatever their stripes should show."""

    def __init__(self, order: Sequence[int], width: int) -> None:
        """Choose frames: by an odd stride, which shows it when every second one is wrong.

        Args:
            order: indices of the scan's stripes.
            width: of the frames [px].
        """
        self._chosen = frozenset(order[:: len(order) // GLANCED_FRAMES | 1])
        self._columns = np.linspace(0.1 * width, 0.9 * width - 1, GLANCED).astype(np.intp)
        self._rows: dict[int, Float] = {}

    def look(self, pair: FramePair) -> None:
        """Glance at a frame, where it is one of those chosen."""
        if pair.index in self._chosen:
            self._rows[pair.index] = brightest_rows(pair.on, pair.off, self._columns)

    def take_over(self, other: Glances) -> None:
        """Count what was seen in a part of this scan too."""
        self._rows.update(other._rows)

    def wrong_frames(self, geometry: ScanGeometry, calibration: Calibration) -> str:
        """What the frames have in common that they should not: turned, flipped, out of order; empty for nothing.

        Args:
            geometry: of the scan.
            calibration: in use.
        """
        indices = [index for index in sorted(self._rows) if np.isfinite(self._rows[index]).sum() >= GLANCED // 3]
        if len(indices) < FEWEST_FRAMES:
            return ""
        seen = np.array([self._rows[index] for index in indices])
        width, height = calibration.camera.size
        order = list(geometry.stripes)
        expected = _expected(geometry, calibration, self._columns)
        mirrored = _expected(geometry, calibration, width - 1 - self._columns)
        fits: dict[str, tuple[Sequence[int], Mask]] = {}
        for name, rows in ((UPRIGHT, expected), (TURNED, height - 1 - mirrored), (FLIPPED, height - 1 - expected)):
            fits[name] = _best_stripes(seen, rows, order, FIT_PX_OF_HEIGHT * height)
        own = {name: fit & (np.array(stripe) == indices) for name, (stripe, fit) in fits.items()}
        shares = {name: float(is_own.mean()) for name, is_own in own.items()}
        other = max((TURNED, FLIPPED), key=lambda name: shares[name])
        if shares[UPRIGHT] + shares[other] >= FITTING_SHARE and shares[other] >= MIXED_SHARE:
            which = (
                "the frames are"
                if shares[UPRIGHT] < MIXED_SHARE
                else f"{int(own[other].sum())} of {len(indices)} frames looked at are"
            )
            return f"{which} {other}: give them as the camera had them when it was calibrated"
        if shares[UPRIGHT] >= FITTING_SHARE:
            return ""
        for name, (stripe, fit) in fits.items():
            if fit.mean() >= FITTING_SHARE:
                turned = f" and {name}" if name else ""
                return f"{_order_words(np.array(indices)[fit], np.array(stripe)[fit])}{turned}"
        return ""


def _expected(geometry: ScanGeometry, calibration: Calibration, columns: Index) -> Float:
    """(s, n) row in which each stripe crosses some columns on ground at z = 0, NaN outside the picture."""
    y = np.linspace(-HALF_LENGTH_M, HALF_LENGTH_M, 41)
    rows = []
    for plane in geometry.planes_in_footprint:
        x = -(plane[1] * y + plane[3]) / plane[0]
        pixels = geometry.pixels(calibration, np.column_stack((x, y, np.zeros_like(y))))
        ordered = pixels[np.argsort(pixels[:, 0])]
        rows.append(np.interp(columns, ordered[:, 0], ordered[:, 1], left=np.nan, right=np.nan))
    return np.array(rows)


def _best_stripes(seen: Float, rows: Float, order: Sequence[int], within: float) -> tuple[Sequence[int], Mask]:
    """Index of the stripe that each frame (f, n) fits best, and whether it fits."""
    distance = np.abs(seen[:, None, :] - rows[None])
    near = (distance < within).sum(axis=2)
    closest = np.where(distance < within, distance, within).sum(axis=2)
    best = np.argmin(closest, axis=1)
    counted = np.isfinite(seen).sum(axis=1)
    return [order[k] for k in best], near[np.arange(len(seen)), best] >= 0.5 * counted


def _order_words(index: Index, stripe: Index) -> str:
    """How the stripes that frames show differ from the stripes that they are said to be."""
    off = stripe - index
    usual = int(np.median(off))
    if (np.abs(off - usual) <= 1).mean() > FITTING_SHARE:
        way = "ahead" if usual > 0 else "behind"
        return f"the frames are {abs(usual)} stripe indices {way}: a frame was lost or the camera lags"
    if np.corrcoef(index, stripe)[0, 1] < -0.8:
        return "the frames are in reverse order"
    return "the frames show other stripes than they are said to be: they are out of order, or of another pattern"
