"""Path of a stripe in any light by plain array operations: reference of the kernel on small bands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Image, Index, Mask
from tests.guara_perception.stripes.plain_laser_colour import (
    CLIPPED,
    SIGMAS_PX,
    Ridges,
    core_colour,
    covariance,
    details,
    in_laser_colour,
    laser_weights,
    purity,
    relative_colour,
    ridge_of_width,
    ridges,
    rim_colour,
)
from tests.guara_perception.stripes.plain_light import robust_sigma

# Value of a row without a stripe, and costs of the path in units of evidence.
NONE, PER_ROW, OF_JUMP, OF_END = -1, 0.7, 6.0, 4.0
# A piece of the path ends where it moves by more rows than this from one column to the next.
PIECE_JUMP_PX = 4
# Least number of columns of a piece, and least number times relative strength.
LEAST_COLUMNS, LEAST_STRONG_COLUMNS = 12, 6
STRONG_PERCENTILE = 75
# A laser keeps the ratio of its channels on any surface; other light deviates by more than this.
MOST_COLOUR_DEVIATION = 0.9
# Laser light is coherent, so it looks grainy on every rough surface; ambient light does not. The grain is measured in
# pieces of at least GRAINED_COLUMNS, as the deviation of the light across the stripe from its running mean over
# GRAIN_COLUMNS. It is visible if it is at least CLEAR_GRAIN times the noise beside it; a piece with less than
# LEAST_GRAIN of the brightest piece's grain is not lit by the laser.
GRAINED_COLUMNS, GRAIN_COLUMNS, CLEAR_GRAIN, LEAST_GRAIN = 24, 9, 2.0, 1 / 3
# Share of clipped columns from which a piece is too bright to show its grain.
MOST_CLIPPED = 0.25


def follow_stripe(evidence: Float32) -> tuple[Index, Mask, float]:
    """Follow the stripe through a picture of its evidence: the best path, "no stripe here" included.

    Args:
        evidence: (rows, columns) evidence of the stripe at each pixel, negative where none is likely.

    Returns:
        Row per column (columns,), that of the nearest column with a stripe where there is none; whether there is one
        (columns,); and the evidence of the whole path minus its costs.
    """
    rows, columns = evidence.shape
    moves = np.minimum(PER_ROW * np.abs(np.subtract.outer(np.arange(rows), np.arange(rows))), OF_JUMP)
    costs = np.pad(moves, (0, 1), constant_values=OF_END)
    costs[rows, rows] = 0
    value = np.append(evidence[:, 0] - np.float32(OF_END), 0.0)
    came = np.zeros((columns, rows + 1), np.intp)
    for column in range(1, columns):
        ways = value[:, None] - costs
        came[column] = ways.argmax(axis=0)
        value = ways.max(axis=0) + np.append(evidence[:, column], 0.0)
    value[:rows] -= OF_END
    state = int(value.argmax())
    path = np.empty(columns, np.intp)
    for column in range(columns - 1, -1, -1):
        path[column] = state if state < rows else NONE
        state = came[column][state]
    return _filled(path), path != NONE, float(value.max())


def _filled(path: Index) -> Index:
    """Path (columns,) with the row of the nearest column with a stripe where there is none."""
    known = np.flatnonzero(path != NONE)
    if not known.size:
        return np.zeros_like(path)
    nearest = np.rint(np.interp(np.arange(path.size), known, np.arange(known.size))).astype(np.intp)
    return np.asarray(path[known[nearest]])


def pieces(rows: Index, is_stripe: Mask) -> list[slice]:
    """The unbroken pieces of a path."""
    cut = is_stripe[1:] != is_stripe[:-1]
    cut |= (np.abs(np.diff(rows)) > PIECE_JUMP_PX) & is_stripe[1:] & is_stripe[:-1]
    edges = np.flatnonzero(np.concatenate(([True], cut, [True])))
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True) if is_stripe[a]]


def strong_pieces(height: Float32, rows: Index, is_stripe: Mask, is_core: Mask, least_share: float) -> Mask:
    """Columns of the pieces that are long enough and high enough relative to the strong ones."""
    good = np.zeros_like(is_stripe)
    if not is_stripe.any():
        return good
    strong = np.percentile(height[is_stripe], STRONG_PERCENTILE)
    height = np.where(is_core, np.maximum(height, strong), height)
    for piece in pieces(rows, is_stripe):
        length, strength = piece.stop - piece.start, float(np.median(height[piece]) / strong)
        is_long = length >= LEAST_COLUMNS and length * strength >= LEAST_STRONG_COLUMNS
        good[piece] = is_long and strength > least_share
    return good


def of_laser_colour(frame: Float32, detail: Float32, rows: Index, is_stripe: Mask, colour: Float, channel: int) -> Mask:
    """Columns of the pieces that have the laser's colour; mostly clipped pieces are not judged."""
    good = is_stripe.copy()
    columns = np.arange(rows.size)
    is_clear = frame[rows, columns].max(axis=1) < CLIPPED
    added = detail[rows, columns]
    for piece in pieces(rows, is_stripe):
        clear = is_clear[piece]
        if clear.sum() < max(LEAST_COLUMNS // 2, 0.5 * clear.size):
            continue
        mean = added[piece][clear].mean(axis=0)
        deviation = np.abs(mean / max(float(mean[channel]), 1e-6) - colour).max()
        good[piece] = mean[channel] > 0 and deviation < MOST_COLOUR_DEVIATION
    return good


def of_laser_speckle(light: Float32, rows: Index, is_stripe: Mask, is_core: Mask, sigma: Float32) -> Mask:
    """Columns of the pieces that are as grainy as laser light, or whose grain cannot be judged.

    Speckle (Goodman: Some fundamental properties of speckle, JOSA 66, 1976) depends on camera and laser more than on
    the surface: the pieces are compared with the brightest. None is judged where that one shows no grain, nor a piece
    whose grain is lost in clipped light or in noise.

    Args:
        light: (rows, columns) float32.
        rows, is_stripe, is_core: (columns,) row of the path, whether there is a stripe, and whether it is clipped.
        sigma: (columns,) width of its ridge [px].
    """
    good = is_stripe.copy()
    long = [
        piece
        for piece in pieces(rows, is_stripe)
        if piece.stop - piece.start >= GRAINED_COLUMNS and is_core[piece].mean() < MOST_CLIPPED
    ]
    if not long:
        return good
    brightest = max(long, key=lambda piece: float(np.median(light[rows[piece], np.arange(piece.start, piece.stop)])))
    shown, noise = _grain(light, rows, brightest, sigma)
    if shown < CLEAR_GRAIN * noise:
        return good
    least = LEAST_GRAIN * shown
    for piece in long:
        grain, noise = _grain(light, rows, piece, sigma)
        good[piece] = noise > least or grain**2 - noise**2 > least**2
    return good


def _grain(light: Float32, rows: Index, piece: slice, sigma: Float32) -> tuple[float, float]:
    """Relative variation of the light of a piece from column to column, and the part of it that is noise."""
    size = 2 * int(np.ceil(2 * np.median(sigma[piece]))) + 1
    across = rows[piece] + np.arange(3 * size)[:, None] - 3 * size // 2
    seen = light[np.clip(across, 0, len(light) - 1), np.arange(piece.start, piece.stop)]
    above, here, below = seen.reshape(3, size, -1).sum(axis=1)
    added = here - np.float32(0.5) * (above + below)
    level = max(float(added.mean()), 1e-6)
    return _unevenness(added) / level, float(np.sqrt(0.75)) * _unevenness(above - below) / level


def _unevenness(values: Float32) -> float:
    """Standard deviation of values (n,) from their running mean."""
    smooth = cv2.blur(values[None], (GRAIN_COLUMNS, 1), borderType=cv2.BORDER_REFLECT_101)[0]
    return robust_sigma(values - smooth)


# The exposure is fitted to some rows and columns.
SAMPLE_ROWS, SAMPLE_COLUMNS = 8, 4


def subtract(on: Float32, off: Float32) -> tuple[Float32, Float32]:
    """Light on - gain * off - offset of each channel, fitted without outliers; and the gains (channels,)."""
    light, gains = np.empty_like(on), np.ones(on.shape[2], np.float32)
    for channel in range(on.shape[2]):
        dark, bright = (picture[::SAMPLE_ROWS, ::SAMPLE_COLUMNS, channel].ravel() for picture in (off, on))
        is_good = (dark < CLIPPED) & (bright < CLIPPED)
        dark, bright = dark[is_good], bright[is_good]
        gain, offset, use = 1.0, 0.0, np.ones(dark.size, bool)
        for _ in range(6):
            gain, offset = np.polyfit(dark[use], bright[use], 1)
            left = np.abs(bright - gain * dark - offset)
            use = left <= 2.5 * max(float(np.median(left)), 0.5)
        plain = np.median(bright - dark)
        both = [(gain, offset), (1.0, plain)]
        bright_ones = dark >= np.quantile(dark, 0.9)
        lefts = [np.abs(bright - factor * dark - shift) for factor, shift in both]
        fitted, simple = (np.median(left) + np.median(left[bright_ones]) for left in lefts)
        gains[channel], shift = both[0 if fitted < 0.7 * simple else 1]
        light[:, :, channel] = on[:, :, channel] - gains[channel] * off[:, :, channel] - np.float32(shift)
    return light, gains


# Distance of the columns in the first pass, which finds the laser's channel, and least width of a picture in which it
# omits columns.
FIRST_PASS_COLUMNS, FIRST_PASS_FROM = 4, 160
# Channels whose score reaches this share of the best are searched in all columns.
HOPEFUL = 0.4
# The stripe and its halo lie within this many rows of its path; the scene is what is further away.
NEAR_PEAK_PX, NEAR_PATH_PX = 10, 12
# Least height of a piece, relative to the strong pieces: the dimmest parts of a line have a tenth of the height of its
# brightest. Without a laser-off picture, and more so without colour, texture can be stronger than that.
LEAST_SHARE, LEAST_SHARE_ALONE, LEAST_SHARE_MONO = 0.1, 0.15, 0.5
# Relative strength above which a second clipped ridge may equally be the stripe.
TWIN_OF_RIDGE = 0.5
# Least height of the ridge in the laser-on picture, as a fraction of its height in the difference of both pictures, and
# least fraction of the columns of a piece that have it, since edges of the scene can hide it. A moved edge is no ridge.
LEAST_OWN_RIDGE, LEAST_OWN_COLUMNS = 0.4, 0.25


@dataclass(frozen=True, slots=True)
class StripePath:
    """Path of a stripe.

    Attributes:
        row: (columns,) row of its path.
        masks: (3, columns) whether there may be a stripe, there is one beyond doubt, and its channel is clipped.
        sigma: (columns,) width of the ridge found [px].
        channel: the laser's own channel.
        weights: (channels,) weights that mix the channels to light in its colour.
        gains: (channels,) factors of the laser-off picture before it is subtracted.
    """

    row: Index
    masks: Mask
    sigma: Float32
    channel: int
    weights: Float
    gains: Float32


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures of a band; all (rows, columns, channels) float32.

    Attributes:
        frame: laser on as delivered, 0 to 255.
        dark: the same with the laser off, None without such a picture.
        light: `frame`, `dark` removed.
        gains: (channels,) factors of `dark` before it was removed.
        detail: what of the light changes across the columns within a few pixels.
    """

    frame: Float32
    dark: Float32 | None
    light: Float32
    gains: Float32
    detail: Float32

    def thinned(self, columns: slice) -> Pictures:
        """Pictures with some of their columns."""
        frame, light, detail = (np.ascontiguousarray(one[:, columns]) for one in (self.frame, self.light, self.detail))
        dark = None if self.dark is None else np.ascontiguousarray(self.dark[:, columns])
        return replace(self, frame=frame, dark=dark, light=light, detail=detail)

    def level(self) -> Float32 | None:
        """Brightness (rows, columns) of the scene of a mono camera, its noise smoothed away, where it is known.

        With several channels the covariance already separates the noise.
        """
        if self.dark is None or self.dark.shape[2] != 1:
            return None
        return np.asarray(cv2.blur(self.dark, (5, 5)), np.float32)


@dataclass(frozen=True, slots=True)
class FirstPass:
    """Path of a stripe in one channel, from some columns of a picture.

    Attributes:
        channel: channel that may be the laser's.
        row: (columns,) row of the path, interpolated between the columns that were searched.
        is_stripe: (columns,) whether there may be a stripe in one of them less than FIRST_PASS_COLUMNS away.
    """

    channel: int
    row: Index
    is_stripe: Mask


@dataclass(frozen=True, slots=True)
class LaserOfChannel:
    """A picture in the colour of a laser of one channel.

    Attributes:
        colour: (channels,) colour of the laser, 1 in its own channel.
        weights: (channels,) weights that mix the channels to `laser`.
        laser: (rows, columns) float32 light in that colour.
        core: (rows, columns) mask of the clipped pixels.
        found: ridges of `laser`.
    """

    colour: Float
    weights: Float
    laser: Float32
    core: Mask
    found: Ridges


def find_path(on: Image, off: Image | None) -> StripePath:
    """Find the path of the stripe that runs across the columns.

    Args:
        on: (rows, columns[, channels]) uint8 or uint16, laser on.
        off: the same with the laser off, or None.
    """
    frame, dark = levels(on), None if off is None else levels(off)
    one = np.ones(frame.shape[2], np.float32)
    light, gains = (frame, one) if dark is None else subtract(frame, dark)
    pictures = Pictures(frame, dark, light, gains, details(light))
    firsts = _first_passes(pictures)
    seen = [_laser_of(pictures, first) for first in firsts]
    tried = [_path_of(pictures, first, each) for first, each in zip(firsts, seen, strict=True)]
    best, _, height = max(tried, key=lambda each: each[1])
    return best if pictures.dark is None else _without_moved_edges(best, height, frame)


def _laser_of(pictures: Pictures, first: FirstPass) -> LaserOfChannel:
    """Picture in the colour of a laser of one channel, with its ridges."""
    light, frame, channel = pictures.light, pictures.frame, first.channel
    elsewhere = _away(first.row, first.is_stripe, frame.shape, NEAR_PATH_PX)
    scene = covariance(pictures.detail, elsewhere)
    colour = relative_colour(rim_colour(light, frame, first.row, first.is_stripe, channel), channel)
    laser, core = in_laser_colour(light, frame, scene, colour, channel)
    found = ridges(laser, elsewhere, pictures.level())
    return LaserOfChannel(colour, laser_weights(scene, colour), laser, core, found)


def _path_of(pictures: Pictures, first: FirstPass, seen: LaserOfChannel) -> tuple[StripePath, float, Float32]:
    """The stripe of a laser of one channel, its score, and the height (columns,) of its ridge [grey levels]."""
    evidence = seen.found.evidence()
    rows, is_stripe, _ = follow_stripe(evidence)
    channel, found = first.channel, seen.found
    columns = np.arange(rows.size)
    is_core = seen.core[rows, columns]
    height, sigma = found.along(rows, columns)
    if pictures.frame.shape[2] == 1:
        is_good = strong_pieces(height, rows, is_stripe, is_core, LEAST_SHARE_MONO)
        is_good = of_laser_speckle(seen.laser, rows, is_good, is_core, sigma)
    else:
        least_share = LEAST_SHARE_ALONE if pictures.dark is None else LEAST_SHARE
        is_good = strong_pieces(height, rows, is_stripe, is_core, least_share)
        is_good = of_laser_colour(pictures.frame, pictures.detail, rows, is_good, seen.colour, channel)
    has_twin = _has_twin(found, seen.core, rows, columns)
    score = float(evidence[rows, columns][is_good].sum())
    path = StripePath(
        # Columns in which only the first pass found a stripe, before texture counted as noise, are doubtful.
        row=np.where(is_stripe, rows, first.row),
        masks=np.array((is_stripe | first.is_stripe, is_good & ~has_twin, is_core & is_good)),
        sigma=sigma,
        channel=channel,
        weights=seen.weights,
        gains=pictures.gains,
    )
    return path, score * _purity(pictures, rows, is_good, channel), height


def levels(frame: Image) -> Float32:
    """Frame as (rows, columns, channels) float32, 0 to 255."""
    scale = np.float32(255 / np.iinfo(frame.dtype).max)
    picture = np.ascontiguousarray(frame).astype(np.float32)
    if scale != 1:
        picture *= scale
    return picture.reshape(*frame.shape[:2], -1)


def _first_passes(pictures: Pictures) -> list[FirstPass]:
    """Paths in the channels that may be the laser's, from some columns.

    Two passes: the second, in which texture counts as noise and the colour is that of the first, selects the channels.
    """
    columns, channels = pictures.light.shape[1:]
    interval = FIRST_PASS_COLUMNS if columns >= FIRST_PASS_FROM else 1
    looked_at = np.arange(interval // 2, columns, interval)
    pictures = pictures.thinned(np.s_[interval // 2 :: interval])
    light, frame, detail = pictures.light, pictures.frame, pictures.detail
    every = np.ones(looked_at.size, dtype=bool)
    shape = light.shape[:2]
    away = [_away(detail[:, :, c].argmax(axis=0), every, shape, NEAR_PEAK_PX) for c in range(channels)]
    rows, is_stripe, _ = _follow(pictures, away, list(np.eye(channels)), is_texture_noise=False)
    nearest = np.minimum(np.arange(columns) // interval, looked_at.size - 1)
    between = (np.rint(np.interp(np.arange(columns), looked_at, row)).astype(np.intp) for row in rows)
    first = [FirstPass(c, row, is_stripe[c, nearest]) for c, row in enumerate(between)]
    if channels == 1:
        return first
    away = [_away(rows[c], is_stripe[c], shape, NEAR_PATH_PX) for c in range(channels)]
    colours = [relative_colour(rim_colour(light, frame, rows[c], is_stripe[c], c), c) for c in range(channels)]
    rows, is_stripe, scores = _follow(pictures, away, colours, is_texture_noise=True)
    scores *= [_purity(pictures, rows[c], is_stripe[c], c) for c in range(channels)]
    return [first[c] for c in range(channels) if scores[c] >= HOPEFUL * scores.max()]


def _follow(
    pictures: Pictures, away: list[Mask], colours: list[Float], *, is_texture_noise: bool
) -> tuple[Index, Mask, Float]:
    """Rows and masks (channels, columns) and scores (channels,) of the paths of a laser of each of these colours."""
    found, level = [], pictures.level()
    for channel, (elsewhere, colour) in enumerate(zip(away, colours, strict=True)):
        scene = covariance(pictures.detail, elsewhere)
        laser, _ = in_laser_colour(pictures.light, pictures.frame, scene, colour, channel)
        found.append(follow_stripe(ridges(laser, elsewhere if is_texture_noise else None, level).evidence()))
    rows, is_stripe, scores = (np.array(each) for each in zip(*found, strict=True))
    return rows, is_stripe, scores


def _purity(pictures: Pictures, rows: Index, is_stripe: Mask, channel: int) -> float:
    """Purity of the colour of a path: the higher of the purities of its rim and of its core."""
    rim = rim_colour(pictures.light, pictures.frame, rows, is_stripe, channel)
    core = core_colour(pictures.detail, pictures.frame, rows, is_stripe, channel)
    return max(purity(rim, channel), purity(core, channel))


def _away(rows: Index, is_stripe: Mask, shape: tuple[int, ...], reach: int) -> Mask:
    """Mask (rows, columns) of the pixels farther from a path than `reach` rows."""
    away = np.ones(shape[:2], dtype=bool)
    columns = np.flatnonzero(is_stripe)
    around = rows[columns] + np.arange(-reach, reach + 1)[:, None]
    away[np.clip(around, 0, shape[0] - 1), columns] = False
    return away


def _has_twin(found: Ridges, core: Mask, rows: Index, columns: Index) -> Mask:
    """Columns (n,) in which a clipped ridge elsewhere has more than TWIN_OF_RIDGE of the path's strength.

    One of the two is a reflection, and clipped light does not show which.
    """
    if not core.any():
        return np.zeros(rows.size, dtype=bool)
    clipped = np.where(core, found.strength, np.float32(0))
    clipped[np.clip(rows + np.arange(-NEAR_PATH_PX, NEAR_PATH_PX + 1)[:, None], 0, len(core) - 1), columns] = 0
    return np.asarray(clipped.max(axis=0) > TWIN_OF_RIDGE * found.strength[rows, columns])


def _without_moved_edges(found: StripePath, strength: Float32, frame: Float32) -> StripePath:
    """Keep only the pieces that are ridges of the laser-on picture too: a moved edge is none."""
    own = np.asarray(cv2.transform(frame, found.weights[None].astype(np.float32)), np.float32).reshape(frame.shape[:2])
    columns = np.arange(found.row.size)
    height = np.max([ridge_of_width(own, sigma)[found.row, columns] for sigma in SIGMAS_PX], axis=0)
    is_path, good, is_core = found.masks.copy()
    is_ridge = (height > LEAST_OWN_RIDGE * strength) | is_core
    for piece in pieces(found.row, found.masks[1]):
        good[piece] = bool(is_ridge[piece].mean() > LEAST_OWN_COLUMNS)
    return replace(found, masks=np.array((is_path, good, is_core & good)))
