"""Camera motion during a scan in dim light, estimated from all pixels of all its images (direct alignment).

At a mean level of one or two, no corner of a single image stands out from the noise. The mean of all images, after
alignment, is like one exposure as long as all of theirs together. Gauss-Newton steps align every image with the mean of
the others, from coarse to fine:

    T(p) - I(p + G(p) m) = grad T(p) G(p) dm + a + b T(p)

where T is the mean, I the image, G the flow of the ground per unit of motion m, and a and b are changes of the light.
The square of T's gradients also contains the noise of T. The product of the gradients of two means, each of one half of
the images, does not: the steps are solved with this product, and its ratio to the square shows whether the ground has
texture.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Grey, Index, Mask

# Number of passes over all images, by reduction factor of the images.
PASSES = {2: 3, 1: 2}
# Number of steps of each image per pass, during which the mean does not change.
STEPS = 2
# Width of the border that is not compared, and sigma of the smoothing of the gradients [px of the reduced images].
MARGIN_PX, SMOOTH_PX = 4, 0.8
# Side of the tiles of a chessboard pattern [px]. The black and the white tiles give one estimate each, whose difference
# shows the noise.
TILE_PX = 8
# Differences are clipped at this multiple of their rms, so that parts that move by themselves, such as the legs, have
# little weight.
CLIPPED = 3.0
# Least share of texture in the gradients, in the direction of motion in which it is smallest: for all images together,
# and for one half of the tiles of an image. With less, errors exceed their sigmas.
LEAST_TEXTURE, LEAST_OF_HALF = 0.8, 0.4
# Least number of images, and of pixels that show the ground.
LEAST_PICTURES, LEAST_PIXELS = 4, 64
# Sigmas of the two smoothings whose difference is `contrast` [px].
FINE_PX, COARSE_PX = 1.0, 8.0
# The images show other ground than the first one if their mean covariance with it is less than LEAST_SHARE of that of
# neighbouring images, which must exceed LIKENESS_SIGMAS sigmas.
LEAST_SHARE, LIKENESS_SIGMAS = 0.5, 10.0
# Degrees of freedom of the motion, then offset and gain of the light.
MOTION, PARAMETERS = 6, 8
# Median of the mean square of MOTION standard normal errors.
MEDIAN_OF_SPREAD = 0.89


def dim_motions(
    pictures: Sequence[Grey], hidden: Sequence[tuple[float, float]], flow: Float
) -> list[tuple[Float, Float] | None]:
    """Motion of the camera in each of several dim images.

    Args:
        pictures: (h, w) images, reduced and brightened.
        hidden: first and end row of the part of each image that may show the laser and is not compared; equal = none.
        flow: (h, w, 2, 6) motion of each pixel along x and y [px] per unit of motion of the camera; NaN off the ground.

    Returns:
        Motion (6,) of each image from an unknown pose that is common to all, and its covariance (6, 6); None for an
        image with too little texture. Empty for too few images, or if all together show too little texture.
    """
    ground = np.asarray(np.isfinite(flow).all(axis=(2, 3)))
    if len(pictures) < LEAST_PICTURES or np.count_nonzero(ground) < LEAST_PIXELS:
        return []
    rows = flow[ground].reshape(-1, MOTION)
    # Units in which every motion moves the pixels by about 1 px, so that single precision suffices.
    unit = np.linalg.inv(np.linalg.cholesky(rows.T @ rows / len(rows))).T
    flow = np.nan_to_num(flow) @ unit
    motions = np.zeros((len(pictures), MOTION))
    covariances = motions[:, :, None]
    for factor, passes in PASSES.items():
        aligner = _Aligner(pictures, hidden, flow, ground, factor)
        for _ in range(passes):
            found = aligner.aligned(motions)
            if found is None:
                return []
            motions, covariances = found
    return [
        (unit @ motion, unit @ covariance @ unit.T) if np.isfinite(covariance).all() else None
        for motion, covariance in zip(motions, covariances, strict=True)
    ]


def contrast(picture: Grey) -> Float32:
    """Grey image without large-scale shading, smoothed slightly to reduce noise."""
    exact = picture.astype(np.float32)
    fine, coarse = (cv2.GaussianBlur(exact, (0, 0), sigma) for sigma in (FINE_PX, COARSE_PX))
    return np.asarray(fine - coarse)


def show_other_ground(pictures: Sequence[Grey], hidden: Sequence[tuple[float, float]]) -> bool:
    """Test that dim images show ground with texture, but other ground than the first: the camera has moved far.

    Covariances of the pixels of two images are free of noise. Those of neighbouring images show whether there is
    texture; if the camera stood still, those with the first image are the same.

    Args:
        pictures, hidden: as for `dim_motions`.
    """
    plain = [contrast(each) for each in pictures]
    for each, (first, end) in zip(plain, hidden, strict=True):
        each[max(int(first), 0) : max(int(np.ceil(end)), 0)] = 0.0
    if len(plain) < LEAST_PICTURES:
        return False
    alike = np.array([np.vdot(one, other) for one, other in pairwise(plain)])
    with_first = [np.vdot(plain[0], each) for each in plain[1:]]
    sigma = float(alike.std(ddof=1)) / np.sqrt(len(alike))
    return bool(alike.mean() > LIKENESS_SIGMAS * sigma and np.mean(with_first) < LEAST_SHARE * alike.mean())


class _Aligner:
    """Images of a scan, reduced by one factor, and their alignment with each other."""

    def __init__(
        self, pictures: Sequence[Grey], hidden: Sequence[tuple[float, float]], flow: Float, ground: Mask, factor: int
    ) -> None:
        height, width = (side // factor for side in pictures[0].shape)
        middle = slice(factor // 2, None, factor)
        self._pictures = [cv2.resize(each, (width, height), interpolation=cv2.INTER_AREA) for each in pictures]
        self._hidden = [(first / factor, end / factor) for first, end in hidden]
        self._flow = (flow[middle, middle][:height, :width] / factor).astype(np.float32)
        inner = slice(MARGIN_PX, -MARGIN_PX)
        # 1 for pixels that are compared, 0 for others.
        self._counts = np.zeros((height, width), np.float32)
        self._counts[inner, inner] = ground[middle, middle][:height, :width][inner, inner]
        rows, columns = np.mgrid[:height, :width].astype(np.float32)
        self._places = np.stack((columns, rows), axis=-1)
        is_black = (columns * factor // TILE_PX + rows * factor // TILE_PX) % 2 == 0
        self._colours = np.array([is_black, ~is_black], np.float32)

    def aligned(self, motions: Float) -> tuple[Float, Float] | None:
        """Refine motions; return them (n, 6) and their covariances (n, 6, 6), or None if there is too little texture.

        Args:
            motions: (n, 6) motions to refine.
        """
        moved = [self._moved(number, motion) for number, motion in enumerate(motions)]
        sums, counts = (
            np.array([np.sum([each[kind] for each in moved[half::2]], axis=0) for half in (0, 1)]) for kind in (0, 1)
        )
        whole, count = sums.sum(axis=0), counts.sum(axis=0)
        mean = whole / np.maximum(count, 1)
        derivatives = self._derivatives(mean, SMOOTH_PX)
        # Rows that the laser hides in all images of one half are taken from the mean of all, to avoid artificial edges.
        one, other = np.where(counts > 0, sums / np.maximum(counts, 1), mean)
        squares = self._products(derivatives, derivatives)
        texture = self._products(self._derivatives(one, SMOOTH_PX), self._derivatives(other))
        texture = (texture + self._products(self._derivatives(other, SMOOTH_PX), self._derivatives(one))) / 2
        if _least_share(squares.sum(axis=(0, 1)), texture.sum(axis=(0, 1))) < LEAST_TEXTURE:
            return None
        result, shapes = motions.copy(), np.full((len(motions), MOTION, MOTION), np.nan)
        spreads = []
        for number, (seen, usable) in enumerate(moved):
            rest = np.maximum(count - usable, 1)
            others, compared = (whole - seen) / rest, self._counts * (count > usable)
            visible = self._is_visible(number, np.arange(len(seen)))
            square, by_motion = (each[:, visible].sum(axis=1) for each in (squares, texture))
            if min(map(_least_share, square, by_motion)) < LEAST_OF_HALF:
                continue
            for step in range(STEPS):
                if step:
                    seen, usable = self._moved(number, result[number])
                difference = (others * usable - seen) * compared
                limit = CLIPPED * np.sqrt((difference**2).sum() / max((usable * compared).sum(), 1))
                np.clip(difference, -limit, limit, out=difference)
                right = (self._colours * difference).reshape(2, -1) @ derivatives.reshape(-1, PARAMETERS)
                result[number] += np.linalg.solve(by_motion.sum(axis=0), right.sum(axis=0))[:MOTION]
            of_half, shape = np.linalg.solve(by_motion, right[:, :, None].astype(np.float64)), _shape(by_motion, square)
            apart = np.subtract(*of_half)[:MOTION, 0]
            spreads.append(float(apart @ np.linalg.solve(shape.sum(axis=0), apart)) / MOTION)
            shapes[number] = _shape(by_motion.sum(axis=0), square.sum(axis=0))
        return (result, statistics.median(spreads) / MEDIAN_OF_SPREAD * shapes) if spreads else None

    def _moved(self, number: int, motion: Float) -> tuple[Float32, Float32]:
        """Image with its motion undone, 0 where it may show the laser; and a mask as float, 1 where it cannot."""
        flow = self._flow.reshape(-1, MOTION) @ motion.astype(np.float32)
        places = self._places + flow.reshape(self._places.shape)
        across, down = places[..., 0], places[..., 1]
        seen = cv2.remap(self._pictures[number], across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        usable = self._is_visible(number, down).astype(np.float32)
        return seen * usable, usable

    def _is_visible(self, number: int, rows: Float32 | Index) -> Mask:
        """Mask of the rows of an image that cannot show the laser."""
        first, end = self._hidden[number]
        return np.asarray((rows <= first - 1) | (rows >= end) | (first == end))

    def _derivatives(self, mean: Float32, smooth: float = 0.0) -> Float32:
        """Derivatives (h, w, 8) of an image with respect to motion, and to offset and gain of the light."""
        result = np.empty((*mean.shape, PARAMETERS), np.float32)
        image = cv2.GaussianBlur(mean, (0, 0), smooth) if smooth else mean
        along_x, along_y = (cv2.Sobel(image, cv2.CV_32F, x, 1 - x, ksize=3, scale=1 / 8)[..., None] for x in (1, 0))
        result[..., :MOTION] = along_x * self._flow[:, :, 0] + along_y * self._flow[:, :, 1]
        result[..., MOTION], result[..., MOTION + 1] = mean.std(), mean - mean.mean()
        return np.asarray(result * self._counts[..., None])

    def _products(self, one: Float32, other: Float32) -> Float:
        """Sums (2, h, 8, 8) of products of derivatives over the tiles of each colour in each row."""
        turned = np.swapaxes(one, 1, 2)
        return np.array([turned * colour[:, None] @ other for colour in self._colours], np.float64)


def _least_share(square: Float, texture: Float) -> float:
    """Share of texture in the gradients, in the direction of motion in which it is smallest.

    Args:
        square, texture: (8, 8) sums of products of the derivatives of one mean, and of two means.
    """
    try:
        shares = np.linalg.eigvals(np.linalg.solve(square[:MOTION, :MOTION], texture[:MOTION, :MOTION]))
    except np.linalg.LinAlgError:
        return 0.0
    return float(shares.real.min())


def _shape(by_motion: Float, square: Float) -> Float:
    """Covariance (..., 6, 6) of a motion for noise of variance 1 per pixel, from sums (..., 8, 8) of products."""
    inverse = np.linalg.inv(by_motion)
    return np.asarray((inverse @ square @ np.swapaxes(inverse, -1, -2))[..., :MOTION, :MOTION])
