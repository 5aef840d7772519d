"""Detection of fiducial crosses on the floor near their predicted positions, to a few hundredths of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Grey
from guara_perception.calibration.calibration import CameraModel, floor_pixels, to_floor
from kinematics.arrays import FrozenArrays

# Offset [m] of a spot from the predicted position of a cross, and correlation score of the spot.
Candidate = tuple[Float, float]
# Half length of the bars of a cross (docs/calibration.md), and their half width in the template and at the start of the
# fit.
ARM_M = 0.012
BAR_M = 0.0015
# Half side of the square that is searched around the predicted position of a cross. It covers an error of the mount of
# 3 degrees and 20 mm at a distance of 0.6 m.
SEARCH_M = 0.060
RASTER_M = 0.0005
# Least normalised correlation of a candidate. Crosses reach 0.8 or more, floor texture usually about 0.3.
MIN_SCORE = 0.5
ANGLES = np.deg2rad((0.0, 15.0, -15.0, 30.0, -30.0, 45.0))
CANDIDATES = 3
# Misfit [m] that counts as much in the choice of candidates as a decrease of the mean correlation by 1.
SCORE_WEIGHT_M = 0.02
# Factor applied to the sigma of the fit, which is too small, because the pixels of a mark share blur and texture.
SIGMA_FACTOR = 2.0
SIGMA_FLOOR_PX = 0.02
# Largest number of function evaluations of a fit. A cross needs 10 to 30; a fit to floor texture may not converge.
MOST_FITS = 100
# Least blur of a bar in the fit, in units of ARM_M.
LEAST_BLUR = 1e-3


@dataclass(frozen=True, slots=True)
class Mark(FrozenArrays):
    """Fiducial in an image.

    Attributes:
        centre_px: (2,) centre (u, v) [px].
        sigma_px: standard deviation of the centre per axis [px].
        score: correlation with an ideal cross, MIN_SCORE ... 1; NaN if the user gave the position.
    """

    centre_px: Float
    sigma_px: float
    score: float


def find_crosses(
    grey: Grey, camera: CameraModel, transform_camera_to_footprint: Float, points_in_footprint: Float
) -> list[Mark | None]:
    """Find the crosses near given points of the floor.

    Args:
        grey: (h, w) uint8 image.
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4) assumed pose of the camera, with an error of up to SEARCH_M on the floor.
        points_in_footprint: (n, 2) positions of the crosses on the floor [m].

    Returns:
        One mark per point, None where no cross was found.
    """
    found = [_candidates(grey, camera, transform_camera_to_footprint, point) for point in points_in_footprint]
    seen = [i for i, candidates in enumerate(found) if candidates]
    marks: list[Mark | None] = [None] * len(points_in_footprint)
    if not seen:
        return marks
    chosen = _consistent([found[i] for i in seen], points_in_footprint[seen])
    for i, (offset, score) in zip(seen, chosen, strict=True):
        refined = _refine(grey, camera, transform_camera_to_footprint, points_in_footprint[i] + offset)
        if refined is not None:
            marks[i] = Mark(*refined, score)
    return marks


def _candidates(grey: Grey, camera: CameraModel, transform: Float, point: Float) -> list[Candidate]:
    """Up to CANDIDATES most cross-like spots around `point`, best first; spots outside the image are skipped."""
    half = SEARCH_M + 1.5 * ARM_M
    line = np.arange(-half, half + RASTER_M / 2, RASTER_M)
    x, y = np.meshgrid(point[0] + line, point[1] + line, indexing="ij")
    pixels = floor_pixels(camera, transform, np.column_stack((x.ravel(), y.ravel())))
    maps = np.nan_to_num(pixels, nan=-1e4).astype(np.float32).reshape(*x.shape, 2)
    patch = cv2.remap(grey, maps[:, :, 0], maps[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    patch = cv2.GaussianBlur(patch.astype(np.float32), (0, 0), 1.0)
    score = np.max([cv2.matchTemplate(patch, _template(a), cv2.TM_CCOEFF_NORMED) for a in ANGLES], axis=0)
    margin = (len(line) - score.shape[0]) // 2
    found: list[Candidate] = []
    while len(found) < CANDIDATES:
        i, j = np.unravel_index(int(np.argmax(score)), score.shape)
        best = float(score[i, j])
        offset = np.array([line[i + margin], line[j + margin]])
        if best < MIN_SCORE:
            break
        pixel = floor_pixels(camera, transform, (point + offset)[None])[0]
        if 0 <= pixel[0] < camera.size[0] and 0 <= pixel[1] < camera.size[1]:
            found.append((offset, best))
        reach = int(ARM_M / RASTER_M)
        score[max(i - reach, 0) : i + reach, max(j - reach, 0) : j + reach] = -1
    return found


def _template(angle: float) -> Float32:
    half = 1.5 * ARM_M
    line = np.arange(-half, half + RASTER_M / 2, RASTER_M)
    x, y = np.meshgrid(line, line, indexing="ij")
    along, across = x * np.cos(angle) + y * np.sin(angle), -x * np.sin(angle) + y * np.cos(angle)
    one = (np.abs(across) <= BAR_M) & (np.abs(along) <= ARM_M)
    other = (np.abs(along) <= BAR_M) & (np.abs(across) <= ARM_M)
    return cv2.GaussianBlur(1.0 - (one | other).astype(np.float32), (0, 0), 1.5).astype(np.float32)


def _consistent(found: list[list[Candidate]], points: Float) -> tuple[Candidate, ...]:
    """Choose one candidate per mark, for a high correlation and a good fit of all marks to a rigid motion."""

    def cost(choice: tuple[Candidate, ...]) -> float:
        moved = points + np.array([offset for offset, _ in choice])
        a, b = points - points.mean(axis=0), moved - moved.mean(axis=0)
        angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        misfit = np.linalg.norm(b - a @ rotation.T, axis=1).mean()
        return float(misfit) + SCORE_WEIGHT_M * sum(1 - score for _, score in choice) / len(choice)

    # Comparing more combinations would take too long. The limit allows six marks with three candidates each.
    if np.prod([len(candidates) for candidates in found]) > 3**6:
        return tuple(candidates[0] for candidates in found)
    return min(product(*found), key=cost)


def _refine(grey: Grey, camera: CameraModel, transform: Float, start: Float) -> tuple[Float, float] | None:
    """Fit a blurred cross to the pixels around `start`; return centre and sigma [px], or None without a good fit."""
    from scipy.optimize import least_squares

    around = start + 1.4 * ARM_M * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    corners = floor_pixels(camera, transform, around)
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 1, camera.size)
    if not np.isfinite(corners).all() or min(high - low) < 5:
        return None
    u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    floor = to_floor(camera, transform, np.column_stack((u.ravel(), v.ravel())).astype(float)) - start
    near = np.hypot(floor[:, 0], floor[:, 1]) < 1.4 * ARM_M
    position = floor[near] / ARM_M
    grey_level = grey[low[1] : high[1], low[0] : high[0]].ravel()[near].astype(float)
    contrast = max(float(np.ptp(np.percentile(grey_level, (2, 90)))), 1.0)
    first = np.array([0, 0, 0, 0, 1.0, BAR_M / ARM_M, 0.08, contrast, np.percentile(grey_level, 80), 0, 0])
    scale = np.array([0.02, 0.02, 0.05, 0.05, 0.05, 0.02, 0.02, contrast / 5, contrast / 5, contrast / 5, contrast / 5])

    def residual(q: Float) -> Float:
        return _cross_model(first + q * scale, position) - grey_level

    def derivatives(q: Float) -> Float:
        return _cross_derivatives(first + q * scale, position) * scale

    misfit = max(0.05 * contrast, 1.0)
    fit = least_squares(
        residual, np.zeros(11), derivatives, method="trf", loss="soft_l1", f_scale=misfit, max_nfev=MOST_FITS
    )
    if not fit.success:
        return None
    p = first + fit.x * scale
    if np.hypot(p[0], p[1]) > 0.5 or not 0.6 < p[4] < 1.5 or p[7] <= 0.3 * contrast:
        return None
    noise = float(np.std(residual(fit.x)))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac)[:2, :2] * np.outer(scale[:2], scale[:2]) * noise**2 * ARM_M**2
    centre = start + p[:2] * ARM_M
    pixel = floor_pixels(camera, transform, centre[None])[0]
    nudged = floor_pixels(camera, transform, centre + 1e-4 * np.eye(2))
    jacobian = (nudged - pixel).T / 1e-4
    sigma = float(np.sqrt(np.trace(jacobian @ covariance @ jacobian.T) / 2))
    return pixel, float(np.hypot(SIGMA_FACTOR * sigma, SIGMA_FLOOR_PX))


def _cross_model(p: Float, position: Float) -> Float:
    """Grey levels (n,) of a dark cross on a floor whose brightness varies linearly.

    Args:
        p: (11,) centre x and y, angle of one bar to x and of the other to y [rad], half length, half width and blur
            of the bars, contrast, brightness of the floor and its slopes along x and y; lengths in units of ARM_M.
        position: (n, 2) positions on the floor, in units of ARM_M.
    """
    one, other = _ink_of_bar(p, position, p[2]), _ink_of_bar(p, position, p[3] + np.pi / 2)
    ink = 1 - (1 - one[0] * one[1]) * (1 - other[0] * other[1])
    return np.asarray(p[8] + p[9] * position[:, 0] + p[10] * position[:, 1] - p[7] * ink)


def _ink_of_bar(p: Float, position: Float, angle: float) -> tuple[Float, Float]:
    """Amount of ink of a bar at an angle, as two factors: along its length and across its width."""
    from scipy.special import ndtr

    (along, across), blur = _along_and_across(p, position, angle), _blur(p)
    length = ndtr((along + p[4]) / blur) - ndtr((along - p[4]) / blur)
    return length, ndtr((across + p[5]) / blur) - ndtr((across - p[5]) / blur)


def _cross_derivatives(p: Float, position: Float) -> Float:
    """Derivatives (n, 11) of `_cross_model` with respect to its parameters."""
    derivatives = np.zeros((len(position), 11))
    one, other = _ink_of_bar(p, position, p[2]), _ink_of_bar(p, position, p[3] + np.pi / 2)
    bars = one[0] * one[1], other[0] * other[1]
    for column, angle, (length, width), beside in ((2, p[2], one, bars[1]), (3, p[3] + np.pi / 2, other, bars[0])):
        (along, across), (c, s) = _along_and_across(p, position, angle), (np.cos(angle), np.sin(angle))
        by_along, by_length, by_blur = _slopes(along, p[4], _blur(p))
        by_across, by_width, by_blur_across = _slopes(across, p[5], _blur(p))
        by_bar = -p[7] * (1 - beside)
        by_along, by_across = by_bar * by_along * width, by_bar * by_across * length
        derivatives[:, 0] += by_across * s - by_along * c
        derivatives[:, 1] -= by_across * c + by_along * s
        derivatives[:, column] = by_along * across - by_across * along
        derivatives[:, 4] += by_bar * by_length * width
        derivatives[:, 5] += by_bar * by_width * length
        derivatives[:, 6] += by_bar * (by_blur * width + by_blur_across * length)
    derivatives[:, 6] *= np.sign(p[6]) * (abs(p[6]) > LEAST_BLUR)
    derivatives[:, 7] = (1 - bars[0]) * (1 - bars[1]) - 1
    derivatives[:, 8] = 1
    derivatives[:, 9:] = position
    return derivatives


def _along_and_across(p: Float, position: Float, angle: float) -> tuple[Float, Float]:
    """Coordinates along and across a bar, relative to the centre of the cross."""
    x, y = position[:, 0] - p[0], position[:, 1] - p[1]
    c, s = np.cos(angle), np.sin(angle)
    return x * c + y * s, y * c - x * s


def _blur(p: Float) -> float:
    return max(abs(float(p[6])), LEAST_BLUR)


def _slopes(t: Float, half: float, blur: float) -> tuple[Float, Float, Float]:
    """Derivatives of ndtr((t + half) / blur) - ndtr((t - half) / blur) with respect to t, half and blur."""
    first, last = (t + half) / blur, (t - half) / blur
    at_first, at_last = (np.exp(-0.5 * z**2) / (blur * np.sqrt(2 * np.pi)) for z in (first, last))
    return at_first - at_last, at_first + at_last, last * at_last - first * at_first
