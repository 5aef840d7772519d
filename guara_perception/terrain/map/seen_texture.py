"""Texture of the ground from laser-off images, and the planar motion (x, y, yaw) of a pause estimated from it.

The laser-off image of a scan is orthorectified with the heights of the scan, in pixels fixed in `odom`. Corners of this
view are found in the texture of earlier pauses by optical flow, forward and backward. Because image and heights belong
to one pose of the camera, an error of this pose moves all corners in the same way:

    d = (x, y) + yaw * (-py, px),        minimised: sum |r|^2 / s^2 / n + m' P^-1 m

where p is the corner relative to the footprint, m = (x, y, yaw), r the measured shift of a corner minus d, s the rms of
r per axis over the corners that agree, and P the prior covariance from odometry. Errors of neighbouring corners are
correlated, so their information is divided by n. The covariance of the measured motion also contains VIEW_SIGMA.

A pixel keeps the texture with which it was first seen, at the pose of the walk at that time. Errors therefore
accumulate only as texture leaves the view. Let f be the fraction of the ground in view that is new at each pause. The
mean age of the texture is then (1/f + 1)/2 pauses. Let C be the covariance of one motion. Half of it comes from the new
image, half from the texture; the part first seen at one pause covers the fraction f of the view, so its noise is 1/f
times that of the whole texture. The variance of the walk therefore grows by

    (1/2 + 1/(2f)) C / ((1/f + 1)/2)^2 = 2 f / (1 + f) C

at each pause; C is added once at the start and once at the end.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np

from guara_perception.arrays import Codes, Float, Float32, Grey, Index, Mask
from guara_perception.ground_picture import GroundPicture
from guara_perception.images import follow
from guara_perception.terrain.grid import TerrainGrid
from kinematics.arrays import FrozenArrays

PIXEL_M = 0.003
# Texture is kept in a margin of this width around the ground in view, for a robot that turns or sways.
MARGIN_PX = 33
# Size of the neighbourhood whose mean is the reference of a pixel's contrast, grey level of zero contrast, and grey
# levels per unit of contrast; soil and concrete vary by 5 to 15 %.
NEIGHBOURHOOD_PX, GREY, LEVELS_OF_CONTRAST = 27, 128, 400.0
# Median grey level, from 0 to 255, up to which sensor noise is as strong as texture.
DARK_LEVEL = 10.0
# Largest height range of a cell and its eight neighbours; steeper ground looks different from each side.
MOST_RISE_M = 0.008
MOST_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX = 120, 0.02, 6
WINDOW_PX, PYRAMID = 11, 2
# Largest distance between a corner and its position after tracking forward and backward.
MOST_RETURN_PX = 0.3
# Least number and least fraction of the tracked corners that agree, and largest contradiction between their motion and
# odometry [sigmas]. A pause outside these limits is refused.
LEAST_CORNERS, LEAST_AGREEING, MOST_SIGMAS = 25, 0.5, 3.0
# Corners show the motion of the whole view if more than the fraction WHOLE of them agree, and if the standard deviation
# of their positions exceeds LEAST_EXTENT_M in every direction (it is at least 0.13 m over a whole view). Otherwise they
# may be on a part of the view that moves by itself.
WHOLE, LEAST_EXTENT_M = 0.8, 0.08
# Largest deviation of an agreeing corner, in units of the spread, and bounds of the spread. The upper bound is about
# half a pixel of the image; with a larger spread, corners would agree by chance.
AGREEING_SIGMAS, LEAST_SPREAD_M, MOST_SPREAD_M = 3.0, 0.0003, 0.0006
# Least sigma of a corner per axis, a thirtieth of PIXEL_M, and number of corners that count as one. Motions estimated
# from two interleaved halves of the corners differ by 1.2 times as much as if corners were independent, which gives a
# number of 1.44; it is set higher, because this test does not show errors common to neighbouring corners.
LEAST_SIGMA_M, CORNERS_THAT_COUNT_AS_ONE = 0.0001, 2.0
# Sigmas of a view as a whole, due to heights and lens [m, m, rad].
VIEW_SIGMA = np.array([5e-5, 5e-5, 5e-5])
# After a pause that texture could not correct, a new reference texture is taken if at most this fraction of the ground
# in view has old texture.
LEAST_LEFT = 0.3
ROUNDS = 5
SIDEWAYS = [0, 1, 5]


@dataclass(frozen=True, slots=True, eq=False)
class VisualMotion:
    """Motion of a pause estimated from texture.

    Attributes:
        motion: (3,) correction of the pose of odometry to that of the texture: x, y [m] and yaw [rad] about the
            footprint; zero if refused.
        covariance: (6, 6) covariance of the pose, the prior if refused.
        corners: number of corners that agree; if too few were found, the number found; 0 if none were looked for.
        is_whole: True if nearly all corners agree and they extend over the view, which means that either the robot or
            all ground in view moved; False if refused.
        inherited: fraction of the covariance that later pauses inherit.
        refused: reason why the motion is not used, None if it is used.
        denied: (3,) motion shown by most corners but contradicted by odometry, zero if there is none.
        part: description of the part of the view that agrees; empty if it is the whole view, or if refused.
    """

    motion: Float
    covariance: Float
    corners: int
    is_whole: bool
    inherited: float
    refused: str | None
    denied: Float = field(default_factory=partial(np.zeros, 3))
    part: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class SeenTexture(FrozenArrays):
    """Texture of the ground in `odom`.

    Attributes:
        texture: (ny, nx) contrast of each pixel as a grey level, GREY for zero contrast, 0 where unknown.
        first: (2,) indices (y, x) of `texture[0, 0]`; pixel 0 begins at the origin.
    """

    texture: Grey
    first: Index

    def at(self, first: Index, shape: tuple[int, int]) -> Grey:
        """Copy of the pixels (ny, nx) starting at `first`."""
        result = np.zeros(shape, np.uint8)
        low = np.maximum(first, self.first)
        high = np.minimum(first + shape, self.first + self.texture.shape)
        if (high > low).all():
            to, of = (tuple(slice(*ends) for ends in zip(low - f, high - f, strict=True)) for f in (first, self.first))
            result[to] = self.texture[of]
        return result


@dataclass(frozen=True, slots=True, eq=False)
class GroundView:
    """Image of a scan, to be projected to a view from above.

    Attributes:
        picture: laser-off image.
        terrain: grid of the scan.
        places: (ny, nx, 2) position of each cell in the image [px], far outside the image for cells not visible in it;
            cells of unknown height are assumed at `level`.
        known: (ny, nx) 255 where a cell and its neighbours are known, inside the image and within MOST_RISE_M of each
            other in height, otherwise 0.
        level: median height [m].
        median: median grey level of the image at the cells of `known`, 0 if there are none.
    """

    picture: GroundPicture
    terrain: TerrainGrid
    places: Float32
    known: Codes
    level: float
    median: float

    @staticmethod
    def of(picture: GroundPicture, terrain: TerrainGrid) -> GroundView:
        """View of a scan; its grid may be that of the area "wide" (`ScanProcessor.finish`)."""
        elevation = np.asarray(terrain.elevation, np.float32)
        is_known = np.isfinite(elevation)
        level = float(np.median(elevation[is_known])) if is_known.any() else 0.0
        heights = np.where(is_known, elevation, np.float32(level))
        x, y = np.meshgrid(*terrain.geometry.centres())
        pose = picture.transform_camera_to_footprint
        points = np.column_stack((x.ravel(), y.ravel(), heights.ravel())) - pose[:3, 3]
        places = picture.camera.project(points @ pose[:3, :3]).reshape(*x.shape, 2)
        height, width = picture.grey.shape
        inside: Mask = np.all((places > 2) & (places < (width - 3, height - 3)), axis=2)
        near = np.ones((3, 3), np.uint8)
        rise = cv2.dilate(heights, near) - cv2.erode(heights, near)
        known = cv2.erode((is_known & inside).astype(np.uint8), near) * (rise < MOST_RISE_M).astype(np.uint8)
        at = np.rint(places[known > 0]).astype(np.intp)
        median = float(np.median(picture.grey[at[:, 1], at[:, 0]])) if len(at) else 0.0
        placed = np.where(inside[..., None], places, -1e4).astype(np.float32)
        return GroundView(picture, terrain, placed, np.asarray(255 * known, np.uint8), level, median)

    def pixels(self, transform: Float) -> tuple[Index, tuple[int, int]]:
        """First pixel and number of pixels, (y, x) each, of the rectangle in odom around the grid at a pose (4, 4)."""
        ny, nx = self.terrain.geometry.shape
        origin = np.array(self.terrain.geometry.origin)
        size = np.array((nx, ny)) * self.terrain.resolution
        corners = origin + size * np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        there = corners @ transform[:2, :2].T + transform[:2, 3]
        first = np.floor(there.min(axis=0) / PIXEL_M).astype(np.intp)[::-1]
        end = np.ceil(there.max(axis=0) / PIXEL_M).astype(np.intp)[::-1]
        return first, (int(end[0] - first[0]), int(end[1] - first[1]))

    def from_above(self, transform: Float, first: Index, shape: tuple[int, int]) -> Grey:
        """Texture of the pixels (ny, nx) starting at `first`, seen from a pose (4, 4); 0 where unknown."""
        # Transform from pixels to cells, by way of odom and the footprint.
        back = np.linalg.inv(transform[:2, :2])
        scale = PIXEL_M / self.terrain.resolution
        base = (first[::-1] + 0.5) * PIXEL_M - transform[:2, 3] - transform[:2, 2] * self.level
        offset = (back @ base - np.array(self.terrain.geometry.origin)) / self.terrain.resolution - 0.5
        to_cell = np.column_stack((back * scale, offset))
        size, how = shape[::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        outside = (-1e4, -1e4)
        places = np.asarray(cv2.warpAffine(self.places, to_cell, size, flags=how, borderValue=outside), np.float32)
        known = cv2.warpAffine(self.known, to_cell, size, flags=how) == 255
        # A pixel of the view is about three pixels of the image wide, so the image is averaged over 3 x 3 pixels.
        smooth = cv2.blur(self.picture.grey, (3, 3))
        seen = np.asarray(cv2.remap(smooth, places[..., 0], places[..., 1], cv2.INTER_LINEAR), np.float32)
        weight = known.astype(np.float32)
        around = (NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX)
        mean = cv2.blur(seen * weight, around) / np.maximum(cv2.blur(weight, around), np.float32(1e-3))
        contrast = seen / np.maximum(mean, np.float32(1.0)) - 1
        return np.where(known, np.clip(GREY + LEVELS_OF_CONTRAST * contrast, 1, 255), 0).astype(np.uint8)


def view_of(picture: GroundPicture | str, terrain: TerrainGrid) -> GroundView | str:
    """View of a scan, or the reason why it has no image."""
    return picture if isinstance(picture, str) else GroundView.of(picture, terrain)


def visual_motion(
    view: GroundView | str, seen: SeenTexture | None, transform: Float, prior: Float, since: Float, slip: Float
) -> VisualMotion:
    """Estimate the error of an odometry pose from ground texture.

    Args:
        view: image and scan of the pause, or the reason why there is no image.
        seen: texture of earlier pauses, None if there is none.
        transform: (4, 4) transform_footprint_to_odom from odometry, with the corrections so far.
        prior: (6, 6) covariance of the pose error relative to the texture, in REP-103 order.
        since: (3, 3) covariance of the odometry error since texture last corrected the walk or a new reference texture
            was taken.
        slip: (3, 3) covariance of slip that is accepted if the whole view shows it.
    """

    def refused(reason: str, corners: int = 0) -> VisualMotion:
        return VisualMotion(np.zeros(3), prior, corners, False, 1.0, reason)

    if isinstance(view, str):
        return refused(view)
    if not view.known.any():
        return refused("the scan shows no level ground in its picture")
    if view.median <= DARK_LEVEL:
        return refused(f"the laser-off picture is dark: its median level is {view.median:.0f} of 255")
    if seen is None:
        return refused("there is no earlier picture")
    first, shape = view.pixels(transform)
    now, before = view.from_above(transform, first, shape), seen.at(first, shape)
    new = 1.0 - float(np.mean(before[now > 0] > 0)) if now.any() else 1.0
    found, shifts = _found_again(now, before)
    if len(found) < LEAST_CORNERS:
        return refused(f"corners found again: {len(found)}, needed: {LEAST_CORNERS}", len(found))
    about = (found + first[::-1] + 0.5) * PIXEL_M - transform[:2, 3]
    motion, sigma, agreeing = _agreed(about, shifts * PIXEL_M)
    count = int(agreeing.sum())
    if count < max(LEAST_CORNERS, LEAST_AGREEING * len(found)):
        return refused(f"only {count} of {len(found)} corners of the texture agree on a motion", count)
    jacobian = _jacobian(about[agreeing])
    information = jacobian.T @ jacobian / (sigma**2 * CORNERS_THAT_COUNT_AS_ONE)
    measured = np.linalg.inv(information) + np.diag(VIEW_SIGMA**2)
    before_it = prior[np.ix_(SIDEWAYS, SIDEWAYS)]
    extent = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(about[agreeing].T))[0], 0.0)))
    is_whole = count > WHOLE * len(found) and extent > LEAST_EXTENT_M
    part = "" if is_whole else f"{count} of {len(found)} corners agree, over {1e3 * extent:.0f} mm"
    believed = measured + min(since, before_it, key=np.trace)
    if is_whole:
        believed = believed + slip
    sigmas = float(np.sqrt(motion @ np.linalg.solve(believed, motion)))
    if sigmas > MOST_SIGMAS:
        reason = f"texture and odometry contradict each other by {sigmas:.1f} combined sigma"
        return VisualMotion(np.zeros(3), prior, count, False, 1.0, reason, motion)
    gain = np.linalg.solve(before_it + measured, prior[SIDEWAYS]).T
    covariance = prior - gain @ prior[SIDEWAYS]
    covariance = 0.5 * (covariance + covariance.T)
    return VisualMotion(gain[SIDEWAYS] @ motion, covariance, count, is_whole, 2 * new / (1 + new), None, part=part)


def seen_after(
    view: GroundView | str, seen: SeenTexture | None, transform: Float, *, held: bool
) -> tuple[SeenTexture | None, bool]:
    """Texture of the ground in view after a pause: the old texture, extended by the image of the pause.

    Args:
        view: as in `visual_motion`.
        seen: texture of earlier pauses, None if there is none.
        transform: (4, 4) corrected transform_footprint_to_odom.
        held: True if texture corrected this transform. Otherwise the old texture is not extended, and a new reference
            texture replaces it when little of it is in view.

    Returns:
        Texture (None if no image has shown any), and True if a new reference texture was taken at this pause.
    """
    if isinstance(view, str) or view.median <= DARK_LEVEL:
        return seen, False
    first, shape = view.pixels(transform)
    now = view.from_above(transform, first, shape)
    first, shape = first - MARGIN_PX, (shape[0] + 2 * MARGIN_PX, shape[1] + 2 * MARGIN_PX)
    texture = np.zeros(shape, np.uint8) if seen is None else seen.at(first, shape)
    in_view = texture[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    if seen is not None and not held:
        if np.count_nonzero((in_view > 0) & (now > 0)) > LEAST_LEFT * np.count_nonzero(now):
            return seen, False
        texture[:] = 0
    in_view[:] = np.where(in_view > 0, in_view, now)
    return SeenTexture(texture, first), seen is None or not held


def _found_again(now: Grey, before: Grey) -> tuple[Float, Float]:
    """Corners (n, 2) of a view from above, and their shifts (n, 2) to the earlier texture, x and y [px]."""
    window = np.ones((WINDOW_PX, WINDOW_PX), np.uint8)
    common = cv2.erode(
        ((now > 0) & (before > 0)).astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    now, before = (np.where(each > 0, each, GREY).astype(np.uint8) for each in (now, before))
    corners = cv2.goodFeaturesToTrack(now, MOST_CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX, mask=common, blockSize=5)
    if corners is None:
        return np.empty((0, 2)), np.empty((0, 2))
    found = np.asarray(corners[:, 0], np.float64)
    there = follow(now, before, found, WINDOW_PX, PYRAMID)
    is_there = np.isfinite(there[:, 0])
    found, there = found[is_there], there[is_there]
    back = follow(before, now, there, WINDOW_PX, PYRAMID)
    good = np.linalg.norm(back - found, axis=1) < MOST_RETURN_PX
    return found[good], (there - found)[good]


def _agreed(about: Float, shifts: Float) -> tuple[Float, float, Mask]:
    """Motion (3,) on which most corners agree, sigma of a corner per axis [m], and mask (n,) of these corners."""
    # Starting from a common shift without rotation would, for a yaw of 20 mrad, keep only corners near each other.
    limit = AGREEING_SIGMAS * MOST_SPREAD_M
    start, _ = cv2.estimateAffinePartial2D(about, about + shifts, method=cv2.RANSAC, ransacReprojThreshold=limit)
    motion = np.zeros(3) if start is None else np.append(start[:, 2], np.arctan2(start[1, 0], start[0, 0]))
    agreeing = np.ones(len(about), dtype=bool)
    for _ in range(ROUNDS):
        cosine, sine = np.cos(motion[2]), np.sin(motion[2])
        turned = about @ np.array([[cosine, sine], [-sine, cosine]])
        left = about + shifts - turned - motion[:2]
        off = np.linalg.norm(left, axis=1)
        # The median length of a vector of two normal errors is 1.18 sigma.
        spread = float(np.clip(np.median(off) / 1.18, LEAST_SPREAD_M, MOST_SPREAD_M))
        agreeing = off < AGREEING_SIGMAS * spread
        if agreeing.sum() < LEAST_CORNERS:
            break
        motion += np.linalg.lstsq(_jacobian(turned[agreeing]), left[agreeing].ravel(), rcond=None)[0]
    rms = float(np.sqrt(np.mean(left[agreeing] ** 2))) if agreeing.any() else 0.0
    return motion, max(rms, LEAST_SIGMA_M), agreeing


def _jacobian(about: Float) -> Float:
    """Derivatives (2 n, 3) of the shifts of corners with respect to x, y and yaw."""
    result = np.zeros((len(about), 2, 3))
    result[:, 0, 0] = result[:, 1, 1] = 1.0
    result[:, 0, 2], result[:, 1, 2] = -about[:, 1], about[:, 0]
    return result.reshape(-1, 3)
