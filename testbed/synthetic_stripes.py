"""Synthetic stripes with known centres, and errors of their extraction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float, Image

COLUMNS, ROWS, STRIPES = 1280, 160, 70
SIGMA_PX = 1.7
AMBIENT = 40.0
# Transmission of the laser light by the blue, green and red filters.
CHANNEL_SHARES = (0.05, 0.08, 1.0)
# Number of columns beside a gap or jump that are not evaluated.
GAP_MARGIN_COLUMNS = 4


@dataclass(frozen=True)
class Case:
    """Kind of light: grey levels of peak and noise, and relative standard deviation of the reflectance."""

    name: str
    peak: float
    noise: float
    texture: float = 0.0


CASES = (Case("clean", 150, 3), Case("saturated", 600, 3), Case("dim", 45, 4), Case("textured", 120, 3, 0.35))
# Width of the texture's grains [px].
GRAIN_PX = 4


def stripes(case: Case, seed: int = 0, count: int = STRIPES) -> Iterator[tuple[Image, Image, Float]]:
    """Yield laser-on frame, laser-off frame and true row of each column (NaN in dropouts) of each stripe."""
    random = np.random.default_rng(seed)
    columns = np.arange(COLUMNS)
    rows = np.arange(ROWS)[:, None]
    for _ in range(count):
        centre = (
            ROWS / 2 + random.uniform(-3, 3) + 12 * np.sin(columns / random.uniform(150, 400) + random.uniform(0, 6))
        )
        jump = random.integers(200, 900)
        centre[jump : jump + 160] += random.uniform(8, 20)
        gap = int(random.integers(950, 1150))
        centre[gap : gap + 80] = np.nan
        light = case.peak * np.exp(-0.5 * ((rows - np.nan_to_num(centre, nan=-99)) / SIGMA_PX) ** 2)
        light[:, np.isnan(centre)] = 0
        albedo = _texture(case.texture, random)
        on = albedo * (AMBIENT + light[:, :, None] * CHANNEL_SHARES) + random.normal(0, case.noise, (ROWS, COLUMNS, 3))
        off = albedo * AMBIENT + random.normal(0, case.noise, (ROWS, COLUMNS, 3))
        yield _as_image(on), _as_image(off), centre


def _texture(variation: float, random: np.random.Generator) -> Float | float:
    """Relative reflectance (rows, columns, 1) of coarse sand."""
    if variation == 0:
        return 1.0
    grains = random.normal(1, variation, (ROWS // GRAIN_PX, COLUMNS // GRAIN_PX))
    smooth = cv2.resize(grains, (COLUMNS, ROWS), interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.clip(smooth, 0.1, 2.0), np.float64)[:, :, None]


def _as_image(values: Float) -> Image:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def figures(case: Case, method: str, count: int = STRIPES) -> dict[str, float]:
    """Compute the figures of `stripe_errors`, and the ratio of the actual errors to their sigmas (1 = right)."""
    profiles, centres = [], []
    for on, off, centre in stripes(case, count=count):
        profiles.append(gp.extract_stripe(on, off, method=method))
        centres.append(centre)
    found = stripe_errors([profile.position_px for profile in profiles], centres)
    scaled = [
        (p.position_px - c)[~_near_change(c)] / p.sigma_px[~_near_change(c)]
        for p, c in zip(profiles, centres, strict=True)
    ]
    return {**found, "sigma_ratio": float(np.sqrt(np.nanmean(np.concatenate(scaled) ** 2)))}


def stripe_errors(found: Sequence[npt.NDArray[Any]], centres: Sequence[Float]) -> dict[str, float]:
    """Compute mean and 95th percentile of the error [px], and missed and false columns [%].

    Columns beside a gap or a jump are not evaluated.

    Args:
        found: extracted row of each column for each stripe, NaN if none was found.
        centres: true row of each column for each stripe, NaN in dropouts.
    """
    row, truth = np.concatenate(found), np.concatenate(centres)
    judged = ~np.concatenate([_near_change(centre) for centre in centres])
    is_found, is_there = np.isfinite(row), np.isfinite(truth)
    error = np.abs(row - truth)[is_found & is_there & judged]
    return {
        "mean": float(error.mean()) if error.size else np.nan,
        "p95": float(np.percentile(error, 95)) if error.size else np.nan,
        "missed": 100 * float((is_there & ~is_found & judged).sum()) / max(int((is_there & judged).sum()), 1),
        "false": 100 * float((is_found & ~is_there & judged).sum()) / max(int((~is_there & judged).sum()), 1),
    }


def _near_change(centre: Float) -> npt.NDArray[np.bool_]:
    """Mask of the columns beside a gap or a jump."""
    change = np.abs(np.diff(np.nan_to_num(centre, nan=-99))) > 2
    near = np.zeros(centre.size, bool)
    for index in np.flatnonzero(change):
        near[max(index - GAP_MARGIN_COLUMNS + 1, 0) : index + GAP_MARGIN_COLUMNS + 1] = True
    return near
