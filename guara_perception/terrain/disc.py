"""Plane fit over the disc around every cell at once: slope, roughness and how much of the disc is known."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]

# A value may come from a partly known disc, from this share on; whether the cell is safe is decided elsewhere.
KNOWN_SHARE = 0.6


@dataclass(frozen=True, slots=True)
class DiscFit:
    """Plane z = a x + b y + c fitted to the disc around each cell, (ny, nx) float64 each.

    Attributes:
        slope: angle of the plane to the horizontal [rad], NaN where too little of the disc is known.
        roughness: sqrt(sum of squared distances to the plane / (n - 1)) [m], NaN likewise.
        slope_sigma: standard deviation of the slope from the variance of the heights [rad].
    """

    slope: Float
    roughness: Float
    slope_sigma: Float


def disc_kernel(radius_cells: float) -> npt.NDArray[np.uint8]:
    """Disc of cells whose centres lie within the radius, (2 r + 1, 2 r + 1) uint8."""
    half = int(np.floor(radius_cells + 1e-9))
    offsets = np.arange(-half, half + 1)
    return (offsets[:, None] ** 2 + offsets**2 <= radius_cells**2 + 1e-9).astype(np.uint8)


def fit_disc(elevation: Float, variance: Float, kernel: npt.NDArray[np.uint8], resolution: float) -> DiscFit:
    """Fit a plane to the known cells of the disc around each known cell.

    The definition of slope and roughness is that of the well-known grid-map filters (least squares instead of
    principal components, the same on planes). All sums are float64: in float32 the roughness cancels.

    Args:
        elevation: (ny, nx) [m], NaN where unknown.
        variance: (ny, nx) [m^2], NaN where unknown.
        kernel: disc from `disc_kernel`.
        resolution: cell edge [m].
    """
    known = np.isfinite(elevation)
    mask = known.astype(np.float64)
    level = float(np.median(elevation[known])) if known.any() else 0.0
    height = np.where(known, elevation - level, 0.0)
    half = kernel.shape[0] // 2
    offset = np.arange(-half, half + 1) * resolution
    disc = kernel.astype(np.float64)
    x, y = disc * offset[None, :], disc * offset[:, None]

    def total(layer: Float, weight: Float) -> Float:
        return np.asarray(cv2.filter2D(layer, cv2.CV_64F, weight, borderType=cv2.BORDER_CONSTANT))

    n = total(mask, disc)
    sx, sy = total(mask, x), total(mask, y)
    sxx, sxy, syy = (
        total(mask, x * offset[None, :]),
        total(mask, x * offset[:, None]),
        total(mask, y * offset[:, None]),
    )
    sz, sxz, syz = total(height, disc), total(height, x), total(height, y)
    szz = total(height**2, disc)
    with np.errstate(divide="ignore", invalid="ignore"):
        cxx, cxy, cyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
        cxz, cyz, czz = sxz - sx * sz / n, syz - sy * sz / n, szz - sz * sz / n
        determinant = cxx * cyy - cxy**2
        a = (cyy * cxz - cxy * cyz) / determinant
        b = (cxx * cyz - cxy * cxz) / determinant
        steepness = np.hypot(a, b)
        # Residuals along z, brought to distances from the plane by the cosine of its slope.
        residual = np.maximum(czz - a * cxz - b * cyz, 0.0) / (1 + steepness**2)
        roughness = np.sqrt(residual / np.maximum(n - 1, 1))
        mean_variance = total(np.where(known, variance, 0.0), disc) / n
        slope_sigma = np.sqrt(mean_variance * (cxx + cyy) / (2 * determinant)) / (1 + steepness**2)
    # Known on all four sides, or the plane would lean on nothing.
    sided = np.ones_like(known)
    for side in (offset[None, :] < 0, offset[None, :] > 0, offset[:, None] < 0, offset[:, None] > 0):
        sided &= total(mask, disc * side) > 0.5
    enough = known & sided & (n >= KNOWN_SHARE * disc.sum()) & (determinant > 1e-6 * cxx * cyy)

    def where(layer: Float) -> Float:
        return np.where(enough, layer, np.nan)

    return DiscFit(where(np.arctan(steepness)), where(roughness), where(slope_sigma))
