"""Camera motion during a scan, estimated from the background of its images.

Corners of a laser-off image are tracked (Lucas-Kanade) into the other images of the scan, outside the rows of the laser
line. In dim light a single image is too noisy: all images of the scan, laser-off ones too, are then aligned with their
common mean (`dim_motions`), and estimates of neighbouring stripes are averaged. Without texture there is no estimate.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Image, Index, Mask
from guara_perception.calibration.calibration import CameraModel
from guara_perception.images import follow
from guara_perception.scanning.dim_background import contrast, dim_motions, show_other_ground
from guara_perception.stripes.band import full_scale, pictures_of
from guara_perception.stripes.kernel.library import Picture, address, addresses, kernel
from kinematics.transforms import inverse, transform_points

CAMERA_MOVED = "camera moved"
MOVED = f"{CAMERA_MOVED}: the ground in its image is not where it should be if the body moved as the joints report"
# Motion is detected if heights change by more than MOST_RISE_M [m] and more than LEAST_SIGMAS sigmas. A stripe is then
# not used if its heights change by more than MOST_RISE_M, or if the change plus SURE_SIGMAS sigmas exceeds WRONG_M [m].
MOST_RISE_M, LEAST_SIGMAS = 0.003, 5.0
WRONG_M, SURE_SIGMAS = 0.005, 2.0
# Number of stripes before and after a stripe that are averaged with it. At 35 ms per stripe, they span 0.18 s; the mean
# keeps 0.95 of the amplitude of a sway of 1 Hz.
NEIGHBOURS = 2
# Width to which images are reduced before tracking, and dim images before alignment, approximately [px].
FOLLOWED_PX, DIM_PX = 320, 160
# Mean level up to which an image counts as dim, mean level to which it is then brightened [grey levels of 255], and
# largest gain.
DIM_LEVEL, BRIGHT_LEVEL, MOST_GAIN = 32.0, 100.0, 16.0
# Least mean level of a dim image [grey levels of 255]. Below it, the pattern of the sensor, which is the same in all
# images, could pass for ground that stands still.
LEAST_LEVEL = 1.0
# Largest fraction of the rows of a dim image that may contain the laser; with more, too little background is left.
MOST_HIDDEN = 0.5
# Corners: largest number, quality relative to the best one, least distance [px]. An estimate needs at least
# LEAST_CORNERS corners that agree, and at least LEAST_SHARE of the corners must be tracked. Of the tracked corners, at
# least LEAST_SHARE must agree; `aligned` requires this share of all corners.
MOST_CORNERS, QUALITY, APART_PX, LEAST_CORNERS, LEAST_SHARE = 48, 0.01, 14, 16, 0.6
WINDOW_PX, LEVELS = 13, 2
# Largest number of corners in the first, fast test for a camera that stands still.
FEW_CORNERS = 20
# Largest error of a corner that agrees with the homography, and median motion below which an image counts as unmoved
# [px].
AGREE_PX, STILL_PX = 0.7, 0.15
# Least sigma of the rises in a dim image [m].
LEAST_SIGMA_M = 1e-5
# Distance to which the glow of the line reaches beyond its rows, and least noise of a corner [px of the reduced image].
GLOW_PX, LEAST_NOISE_PX = 6, 0.03
# An image whose contrast is at least this share of that of the reference image, but which correlates with it by less,
# shows other ground: the camera has moved too far for its corners to be found again.
LEAST_CONTRAST, LEAST_LIKENESS = 0.5, 0.5
# Iterations of the fit, and largest condition number of its equations (below 1e3 for corners all over the image).
STEPS, MOST_CONDITION = 4, 1e9


def gain_of(picture: Image) -> float:
    """Gain that makes a dim image bright enough for tracking; 1 for other images."""
    level = max(_level(picture), 1.0)
    return 1.0 if level > DIM_LEVEL else min(BRIGHT_LEVEL / level, MOST_GAIN)


def _level(picture: Image) -> float:
    """Mean level of an image [grey levels of 255]."""
    return float(picture[::16, ::16].mean()) * 255.0 / full_scale(picture)


def grey(picture: Image, gain: float, width: int = FOLLOWED_PX) -> Image:
    """Brighten one channel of an image, convert it to 8 bits and reduce its size.

    Args:
        picture: (h, w) or (h, w, 3).
        gain: factor of brightness; see `gain_of`.
        width: approximate width of the result [px].
    """
    given, *how = _reduction(picture, gain, width)
    factor = how[1]
    out = np.empty((given.rows // factor, given.columns // factor), np.uint8)
    line, sums = np.empty(given.columns, np.uint16), np.empty((2, given.columns), np.uint32)
    kernel().shrink(given, *how, *addresses(line, sums, out))
    return out


def _reduction(picture: Image, gain: float, width: int = FOLLOWED_PX) -> tuple[Picture, int, int, float]:
    """Image, channel, factor and gain of `grey`, for the kernel."""
    given, factor = pictures_of(picture, None)[0], max(round(picture.shape[1] / width), 1)
    # Of three channels, green is used, because it has the least noise.
    return given, given.channels // 2, factor, gain / 256 if given.size == 2 else gain


def corners(picture: Image) -> Float:
    """Corners (n, 2) of a grey image [px]; none if it has no texture."""
    found = cv2.goodFeaturesToTrack(picture, MOST_CORNERS, QUALITY, APART_PX)
    return np.zeros((0, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2)


def aligned(picture: Image, to: Image) -> Image | None:
    """Warp an image to the view of another; None if no motion is detected, or too few corners agree.

    Args:
        picture: laser-off image, (h, w) or (h, w, 3).
        to: the other image, of the same size and type.
    """
    gain = gain_of(picture)
    one, other = grey(picture, gain), grey(to, gain)
    points = corners(one)
    if len(points) < LEAST_CORNERS:
        return None
    there = follow(one, other, points, WINDOW_PX, LEVELS)
    kept = np.isfinite(there[:, 0])
    if np.count_nonzero(kept) < LEAST_CORNERS:
        return None
    homography, agree = cv2.findHomography(points[kept], there[kept], cv2.RANSAC, AGREE_PX)
    if homography is None or np.count_nonzero(agree) < max(LEAST_CORNERS, LEAST_SHARE * len(points)):
        return None
    if np.median(np.linalg.norm(there[kept] - points[kept], axis=1)) < STILL_PX:
        return None
    scale = np.diag([one.shape[1] / picture.shape[1], one.shape[0] / picture.shape[0], 1.0])
    whole = np.linalg.inv(scale) @ homography @ scale
    # Pixels outside the first image are copied from the second, so that they show no difference.
    return np.asarray(
        cv2.warpPerspective(picture, whole, picture.shape[1::-1], to.copy(), borderMode=cv2.BORDER_TRANSPARENT)
    )


def motion_text(moved: Mapping[int, float], parted: int, count: int, *, has_track: bool) -> str:
    """Describe motion of the body during a scan; empty if all stripes are used and joined.

    Args:
        moved: stripe index -> largest error of the heights of a stripe that is not used [m].
        parted: number of pairs of neighbouring stripes that are not joined, because of motion between them.
        count: number of stripes.
        has_track: True if the motion of the body was measured with the joints.
    """
    texts = []
    if moved:
        beyond = " from the motion that the joints report" if has_track else ""
        still = "the robot must stand still, or stream its joint positions"
        remedy = "check the joints and their clock" if has_track else still
        most = max((each for each in moved.values() if each < math.inf), default=math.nan)
        off = f"off by up to {1e3 * most:.0f} mm{beyond}" if most >= 0 else "their images show other ground"
        texts.append(f"{len(moved)} of {count} stripes not used, {off}: {remedy}")
    if parted:
        texts.append(
            f"{parted} pair{'s' * (parted > 1)} of neighbouring stripes not joined, because the body moved too far "
            "between their flashes, or its motion is too uncertain: scan faster, or keep the body still"
        )
    return f"{CAMERA_MOVED}: {'; '.join(texts)}" if texts else ""


@dataclass(frozen=True, slots=True)
class _Seen:
    """Camera motion since the reference image.

    Attributes:
        rise: (4,) rise of the corners of the scanned area due to this motion [m].
        sigma: (4,) standard deviations of `rise` due to the noise of the images, without that of the reference image,
            which all estimates share [m].
        shift: median motion of the corners of the image [px of the reduced image].
        largest_sigma: the largest of `sigma`, stored because it is needed often [m].
    """

    rise: Float
    sigma: Float
    shift: float
    largest_sigma: float

    @property
    def is_sure(self) -> bool:
        """True if the sigmas can be trusted; the errors of noisier estimates are larger than their sigmas."""
        return self.largest_sigma <= MOST_RISE_M

    @property
    def is_still(self) -> bool:
        """True if the images show that heights change by less than MOST_RISE_M."""
        most = LEAST_SIGMAS * math.sqrt(2.0)
        ends = zip(self.rise.tolist(), self.sigma.tolist(), strict=True)
        return all(abs(rise) + most * sigma <= MOST_RISE_M for rise, sigma in ends)

    def is_beyond(self, common: Float) -> bool:
        """Test whether the rise differs significantly from 0; `common` is the shared sigma [m]."""
        return is_beyond(self.rise, self.sigma, common)


def _seen_of(found: Float) -> _Seen:
    """Camera motion from the kernel's result (2 n + 1,): n rises, their sigmas and the shift."""
    ends = len(found) // 2
    sigma = found[ends:-1]
    return _Seen(found[:ends], sigma, float(found[-1]), float(sigma.max()))


def _middle(values: Float) -> Float:
    """Median (k,) of values (n, k) over n; `np.median` takes several times as long for so few."""
    ordered, count = np.sort(values, axis=0), len(values)
    return np.asarray((ordered[(count - 1) // 2] + ordered[count // 2]) / 2)


def is_beyond(rises: Float, sigmas: Float, common: Float | float) -> bool:
    """Test whether any of rises (..., 4) differs significantly from 0.

    Args:
        rises: rises of the corners of the scanned area [m].
        sigmas: their standard deviations [m].
        common: standard deviation that all of them share [m].
    """
    limit = np.maximum(MOST_RISE_M, LEAST_SIGMAS * np.hypot(sigmas, common))
    return bool((np.abs(rises) > limit).any())


def _estimates(looks: Mapping[int, Sequence[_Seen]], common: Float) -> dict[int, _Seen]:
    """Estimates by stripe; an inconclusive one is averaged with those of the neighbouring stripes."""
    groups, found = list(looks.values()), {}
    for number, (index, own) in enumerate(looks.items()):
        seen = own[0] if len(own) == 1 else _pooled(own)
        if seen is None or (LEAST_SIGMAS * seen.largest_sigma > MOST_RISE_M and not seen.is_beyond(common)):
            around = groups[max(number - NEIGHBOURS, 0) : number + NEIGHBOURS + 1]
            seen = _pooled([look for group in around for look in group])
        if seen is not None:
            found[index] = seen
    return found


def _pooled(looks: Sequence[_Seen]) -> _Seen | None:
    """Weighted mean of estimates, None if there are none; its sigma includes their scatter."""
    if len(looks) < 2:
        return looks[0] if looks else None
    rises, weights = np.array([look.rise for look in looks]), np.array([look.sigma for look in looks]) ** -2.0
    mean = (weights * rises).sum(axis=0) / weights.sum(axis=0)
    scatter = (weights * (rises - mean) ** 2).sum() / max(weights.size - len(mean), 1)
    sigma = np.sqrt(max(float(scatter), 1.0) / weights.sum(axis=0))
    return _Seen(mean, sigma, float(np.median([look.shift for look in looks])), float(sigma.max()))


class BackgroundWitness:
    """Camera motion during a scan, relative to its first laser-off image, estimated from the background."""

    def __init__(self, camera: CameraModel, transform_camera_to_footprint: Float, ends: Float) -> None:
        """Start a scan.

        Args:
            camera: the calibrated camera.
            transform_camera_to_footprint: (4, 4) pose of the camera at the beginning of the scan.
            ends: (4, 3) corners of the scanned area in base_footprint.
        """
        self._camera, self._pose, self._ends = camera, transform_camera_to_footprint, ends
        self._reference: Image | None = None
        # Images of a dim scan: stripe (None for the reference), reduced image, first and end row of the laser line; and
        # the last laser-off image among them.
        self._dim: list[tuple[int | None, Image, tuple[float, float]]] = []
        self._dark: Image | None = None
        self._points = self._rays = np.zeros((0, 2))
        # Arguments of the kernel after an image: reference image and its corners; limits and work array of the fit.
        self._work = np.empty(6 * FEW_CORNERS)
        self._of_scan: tuple[int, ...] = ()
        self._of_fit: tuple[float, ...] = ()
        self._flow: Float = np.zeros((0, 2, 6))
        # Change (n, 2, 2) of the ray of each corner per pixel along x and along y.
        self._turn: Float = np.zeros((0, 2, 2))
        self._seen: dict[int, list[_Seen]] = {}
        # Stripes whose images show other ground than the reference image.
        self._elsewhere: set[int] = set()
        # Result of `_standing`, until the next look.
        self._stood: tuple[Float, dict[int, _Seen]] | None = None
        self._pixel = self._gain = self._scale = 0.0
        # Rise of the corners per unit of small motion (translation, rotation) along the axes of the camera.
        turn, arm = transform_camera_to_footprint[:3, :3], ends - transform_camera_to_footprint[:3, 3]
        self._rise = np.column_stack((np.tile(turn[2], (len(ends), 1)), np.cross(turn.T[None], arm[:, None])[:, :, 2]))

    def look(self, index: int, picture: Image, off: Image | None, band: tuple[int, int]) -> None:
        """Estimate the camera motion from the image of a stripe.

        Args:
            index: index of the stripe.
            picture: laser-on image.
            off: laser-off image; the first one of the scan is the reference for all others.
            band: rows between which the stripe can appear.
        """
        if self._reference is None and off is not None:
            self._begin(off)
        self._seen[index], self._stood = [], None
        if self._reference is None:
            return
        scale = self._reference.shape[0] / picture.shape[0]
        rows = scale * band[0] - GLOW_PX, scale * band[1] + GLOW_PX
        if self._dim:
            self._add_dim(index, picture, rows)
            if off is not None:
                self._add_dim(index, off)
        elif len(self._points) >= LEAST_CORNERS:
            seen = self._look(picture, rows, scale)
            self._seen[index] = [] if seen is None else [seen]
            if (seen is None or not seen.is_sure) and self._is_elsewhere(grey(picture, self._gain), rows):
                self._elsewhere.add(index)

    def _add_dim(self, index: int | None, picture: Image, rows: tuple[float, float] | None = None) -> None:
        """Keep an image of a dim scan for `_look_at_dim`; `rows` may show the laser, None = it was off."""
        small = grey(picture, self._gain, DIM_PX)
        # Several stripes may share a laser-off image.
        is_again = rows is None and self._dark is not None and np.array_equal(small, self._dark)
        if is_again or (self._dim and small.shape != self._dim[0][1].shape):
            return
        if rows is None:
            self._dark = small
            rows = 0.0, 0.0
        if rows[1] - rows[0] <= MOST_HIDDEN * len(small):
            self._dim.append((index, small, rows))

    def _look_at_dim(self) -> None:
        """Estimate the camera motion from all images of a dim scan so far."""
        height, width = self._dim[0][1].shape
        points = np.mgrid[:width, :height].reshape(2, -1).T.astype(np.float64)
        ground, _, flow, turn = self._flow_at(points)
        moved = np.full((len(points), *flow.shape[1:]), np.nan)
        moved[ground] = np.linalg.solve(turn, flow)
        indices, pictures, rows = zip(*self._dim, strict=True)
        found = dim_motions(pictures, rows, moved.reshape(width, height, *flow.shape[1:]).swapaxes(0, 1))
        looks = [None if each is None else self._seen_by(*each) for each in found]
        is_lost = 2 * sum(each is not None for each in looks) < len(pictures)
        self._elsewhere = set(self._seen) if is_lost and show_other_ground(pictures, rows) else set()
        # Rises are relative to the mean of the first laser-off image and the image of the first stripe.
        begin = _pooled([look for look in looks[:2] if look is not None])
        self._seen = {index: [] for index in self._seen}
        for index, look in zip(indices[1:], looks[1:], strict=False):
            if begin is not None and look is not None:
                self._seen[index].append(replace(look, rise=look.rise - begin.rise))

    def _seen_by(self, motion: Float, covariance: Float) -> _Seen:
        sigma = np.maximum(np.sqrt(np.diag(self._rise @ covariance @ self._rise.T)), LEAST_SIGMA_M)
        return _Seen(self._rise @ motion, sigma, math.inf, float(sigma.max()))

    def _look(self, picture: Image, rows: tuple[float, float], scale: float) -> _Seen | None:
        """Motion since the reference image; corners within `rows` of the reduced image are not used."""
        assert self._reference is not None
        given, *how = _reduction(picture, self._gain)
        if (given.rows // how[1], given.columns // how[1]) != self._reference.shape:
            return None
        found = np.empty(2 * len(self._rise) + 1)
        # Only the surroundings of a few corners are read, which is enough to see that the camera stands still.
        result = kernel().look_at_corners(given, *how, *self._of_scan, *rows, *self._of_fit, address(found))
        if result < 0:
            return None
        if result and (seen := _seen_of(found)).is_still:
            return seen
        used = np.flatnonzero((self._points[:, 1] < rows[0]) | (self._points[:, 1] >= rows[1]))
        there = follow(self._reference, grey(picture, self._gain), self._points[used], WINDOW_PX, LEVELS)
        flow = self._camera.rays(there / scale)[:, :2] - self._rays[used]
        return self._motion(flow, (there - self._points[used]).astype(np.float32), used)

    def _is_elsewhere(self, picture: Image, rows: tuple[float, float]) -> bool:
        """Test that a reduced image has contrast, but shows other ground than the reference image.

        Images that are flipped or turned by 180 degrees show the same ground; the scan reports them as such.
        """
        if self._reference is None or picture.shape != self._reference.shape:
            return False
        used = np.ones(len(picture), dtype=bool)
        used[max(int(rows[0]), 0) : max(math.ceil(rows[1]), 0)] = False
        one, other = (contrast(each) for each in (self._reference, picture))
        if not used.any() or other[used].std() < LEAST_CONTRAST * one[used].std():
            return False
        views = other, other[::-1], other[:, ::-1], other[::-1, ::-1]
        return all(np.corrcoef(one[used].ravel(), each[used].ravel())[0, 1] < LEAST_LIKENESS for each in views)

    def _begin(self, off: Image) -> None:
        self._gain = gain_of(off)
        is_dim = self._gain > 1.0
        self._reference = grey(off, self._gain, DIM_PX if is_dim else FOLLOWED_PX)
        self._scale = self._reference.shape[0] / off.shape[0]
        if is_dim:
            if _level(off) >= LEAST_LEVEL:
                self._add_dim(None, off)
            return
        # Angle of one pixel of the reduced image [rad].
        self._pixel = 1.0 / (self._scale * float(self._camera.matrix[0, 0]))
        points = corners(self._reference)
        ground, self._rays, self._flow, self._turn = self._flow_at(points)
        self._points = points[ground]
        tracked = addresses(self._reference, self._points, self._turn, self._flow)
        self._of_scan = *tracked, len(self._points), FEW_CORNERS
        self._of_fit = *self._limits, address(self._work)

    def _flow_at(self, points: Float) -> tuple[Mask, Float, Float, Float]:
        """Flow of the ground at points (n, 2) of the reduced image.

        Returns:
            Mask (n,) of the points that show the plane of the feet; of these m points: rays (m, 2), change (m, 2, 6) of
            the rays per unit of small motion of the camera, and change (m, 2, 2) per pixel along x and along y.
        """
        rays = self._camera.rays(points / self._scale)
        down = rays @ self._pose[2, :3]
        ground = down < 0
        # Depth of the ground plane along each ray.
        depth = -self._pose[2, 3] / down[ground]
        (x, y), zero = rays[ground, :2].T, np.zeros(len(depth))
        beside = [
            self._camera.rays((points[ground] + step) / self._scale)[:, :2] - rays[ground, :2] for step in np.eye(2)
        ]
        flow = np.stack(
            (
                np.stack((-1 / depth, zero, x / depth, x * y, -(1 + x**2), y), axis=1),
                np.stack((zero, -1 / depth, y / depth, 1 + y**2, -x * y, -x), axis=1),
            ),
            axis=1,
        )
        return ground, rays[ground, :2], flow, np.stack(beside, axis=-1)

    def is_still(self, index: int) -> bool:
        """Test that the images of a stripe show the background where the reference image shows it."""
        looks = self._seen.get(index, [])
        return bool(looks) and all(look.shift < STILL_PX for look in looks)

    def _motion(self, flow: Float, moved: Float32, used: Index) -> _Seen | None:
        """Camera motion from the flow of image corners; None if the flow does not determine it.

        Args:
            flow: (n, 2) change of the rays of the corners, NaN where a corner was lost.
            moved: (n, 2) motion of the corners [px of the reduced image].
            used: (n,) numbers of these corners.
        """
        count, ends = len(used), len(self._rise)
        found, work = np.empty(2 * ends + 1), np.empty(2 * count)
        given = *addresses(self._flow, flow, moved, used), count, *self._limits
        return _seen_of(found) if kernel().fit_motion(*given, *addresses(work, found)) else None

    @property
    def _limits(self) -> tuple[float, ...]:
        """Limits of `fit_motion` in the kernel, and the rise of the corners of the scanned area."""
        limits = LEAST_CORNERS, LEAST_SHARE, STEPS, LEAST_NOISE_PX * self._pixel, MOST_CONDITION
        return *limits, address(self._rise), len(self._rise)

    @property
    def is_blind(self) -> bool:
        """True if a motion that makes heights wrong by `WRONG_M` could be missed.

        Then there is no texture, too little light, or no laser-off image, without which motion cannot be estimated.
        """
        found = self._standing()[1]
        sigmas = [found[index].largest_sigma if index in found else np.inf for index in self._seen]
        return not sigmas or LEAST_SIGMAS * statistics.median(sigmas) > WRONG_M

    def _standing(self) -> tuple[Float, dict[int, _Seen]]:
        """`_reference_sigma`, and estimates by stripe for a camera that stood still."""
        if self._stood is None:
            if self._dim:
                self._look_at_dim()
            common = self._reference_sigma()
            self._stood = common, _estimates(self._reliable(), common)
        return self._stood

    def _reliable(self) -> dict[int, list[_Seen]]:
        """Reliable estimates by stripe; none if at most half are, because so few may be chance, as in the dark."""
        if all(look.is_sure for looks in self._seen.values() for look in looks):
            return self._seen
        sure = {index: [look for look in looks if look.is_sure] for index, looks in self._seen.items()}
        count, whole = (sum(map(len, looks.values())) for looks in (sure, self._seen))
        return sure if 2 * count > whole else {}

    def moved(self, stripes: Collection[int], places: Mapping[int, Float] | None) -> dict[int, float]:
        """Stripes whose images contradict the poses from the joints, with the largest error of their heights [m].

        If motion is detected, stripes without an estimate are included, with error 0. Stripes whose images show other
        ground than the reference image are included with infinite error, unless the joints report motion.

        Args:
            stripes: indices of the stripes.
            places: poses (4, 4) of the camera in base_footprint from the joints, by stripe index; None = the camera
                stood still.
        """
        common, found = self._standing()
        lost = self._elsewhere.intersection(stripes)
        if places is not None:
            looks = {
                index: [replace(look, rise=look.rise - self._displaced(places[index])[:, 2]) for look in seen]
                for index, seen in self._reliable().items()
                if index in places
            }
            found = _estimates(looks, common)
            # Other ground is expected where the joints report motion.
            if any(np.abs(self._displaced(places[index])).max() > MOST_RISE_M for index in lost.intersection(places)):
                lost = set()
        if not found and not lost:
            return {}
        is_motion = bool(lost)
        if found:
            seen = found.values()
            rises, sigmas = np.array([each.rise for each in seen]), np.array([each.sigma for each in seen])
            middle = _middle(rises)
            if places is not None:
                # All motion is relative to the camera pose of the reference image, which is unknown.
                found = {index: replace(each, rise=each.rise - middle) for index, each in found.items()}
                rises, middle = rises - middle, np.zeros_like(middle)
            is_motion = is_motion or is_beyond(rises, sigmas, common) or is_beyond(rises - middle, sigmas, 0.0)
        if not is_motion:
            return {}
        moved = {index: 0.0 for index in stripes if index not in found}
        for index, each in found.items():
            sure = WRONG_M - SURE_SIGMAS * np.hypot(each.sigma, common)
            if (np.abs(each.rise) > np.minimum(MOST_RISE_M, sure)).any():
                moved[index] = float(np.abs(each.rise).max())
        moved |= dict.fromkeys(lost, math.inf)
        return moved

    def _reference_sigma(self) -> Float:
        """Sigma (4,) of the rises due to the noise of the reference image, taken as that of a typical other image."""
        sigmas = [look.sigma for looks in self._seen.values() for look in looks] or [np.zeros(len(self._ends))]
        return _middle(np.array(sigmas))

    def _displaced(self, transform_camera_to_footprint: Float) -> Float:
        """Displacement (4, 3) of the corners of the scanned area for a pose of the camera [m]."""
        change = transform_camera_to_footprint @ inverse(self._pose)
        return np.asarray(transform_points(change, self._ends) - self._ends)
