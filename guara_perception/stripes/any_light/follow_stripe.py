"""The best path of a stripe through all columns of a band, "no stripe here" included; pieces that are the laser's."""

from __future__ import annotations

from operator import sub

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Index, Mask
from guara_perception.stripes.any_light.laser_colour import CLIPPED
from guara_perception.stripes.peaks import robust_sigma

# In units of evidence: a path pays for every row that it moves by from one column to the next, but never more than
# for a jump, and for every end.
COST_PER_ROW = 0.7
COST_OF_JUMP = 6.0
COST_OF_END = 4.0
# Rows that a path may move by from one column to the next without jumping, and what each move costs.
REACH_ROWS = 3
PRICES = tuple(COST_PER_ROW * abs(move) for move in range(-REACH_ROWS, REACH_ROWS + 1))
# Instead of a row: there is no stripe.
NONE = -1
# A piece of the path ends where it moves by more rows than this from one column to the next.
PIECE_JUMP_PX = 4
# Shorter pieces are no stripe: least number of columns, and least number times relative strength.
LEAST_COLUMNS, LEAST_STRONG_COLUMNS = 12, 6
STRONG_PERCENTILE = 75
# A laser keeps the ratio of its channels on any surface; other light deviates by more.
MOST_COLOUR_DEVIATION = 0.9
# Laser light is coherent, so it looks grainy on every rough surface; ambient light does not. The grain is measured in
# pieces of at least GRAINED_COLUMNS, as what a running mean over GRAIN_COLUMNS leaves of the light across the stripe.
# It shows where it is CLEAR_GRAIN times the noise beside it; a piece with less than LEAST_GRAIN of the brightest
# piece's grain is not lit by the laser.
GRAINED_COLUMNS, GRAIN_COLUMNS, CLEAR_GRAIN, LEAST_GRAIN = 24, 9, 2.0, 1 / 3
# From this share of clipped columns on a piece is too bright to show its grain.
MOST_CLIPPED = 0.25


def follow_stripe(evidence: Float32) -> tuple[Index, Mask, Float]:
    """Follow the stripe in several pictures of its evidence at once.

    The Viterbi algorithm (Forney: The Viterbi algorithm, Proc. IEEE 61, 1973), run from both ends at once until the
    two runs meet: the sum of the best paths up to a pixel from either side is the best path through it.

    Args:
        evidence: (pictures, columns, rows) evidence of the stripe at each pixel, negative where none is likely.

    Returns:
        Row per column (pictures, columns), that of the nearest column with a stripe where there is none; whether there
        is one (pictures, columns); and the evidence of the whole path minus its costs (pictures,).
    """
    pictures, columns, rows = evidence.shape
    centre = columns // 2
    # Both halves in one array, whose rows and the gaps between, in which no path runs, lie in one piece: what is done
    # at each column is a few calls on one short row of numbers, and the fixed cost of a call counts.
    seen = np.empty((centre + 1, _begin(2 * pictures, rows)), np.float32)
    seen[:, :REACH_ROWS] = seen[:, REACH_ROWS:].reshape(centre + 1, 2 * pictures, -1)[:, :, rows:] = -np.inf
    by_half = _without_gaps(seen, rows)
    by_half[:, :pictures] = evidence[:, : centre + 1].transpose(1, 0, 2)
    by_half[:, pictures:] = evidence[:, ::-1][:, : centre + 1].transpose(1, 0, 2)
    best, ends = _best_paths(seen, rows)
    scores = _without_gaps(best, rows)
    # Index of the centre column in the second half, which counts from the last column.
    met = columns - 1 - centre
    through = scores[centre, :pictures] + scores[met, pictures:] - by_half[centre, :pictures]
    without = (ends[centre, 1, :pictures] + ends[met, 1, pictures:])[:, 0]
    row = through.argmax(axis=1)
    score = through.max(axis=1)
    path = np.empty((pictures, columns), np.intp)
    for picture in range(pictures):
        start = int(row[picture]) if score[picture] > without[picture] else NONE
        path[picture, : centre + 1] = _traced(best, ends, picture, rows, centre, start)[::-1]
        path[picture, centre:] = _traced(best, ends, pictures + picture, rows, met, start)
    return np.stack([_filled(each) for each in path]), path != NONE, np.maximum(score, without).astype(np.float64)


def _best_paths(seen: Float32, rows: int) -> tuple[Float32, Float32]:
    """Scores of the best paths up to every pixel.

    Args:
        seen: (columns, n) evidence of some pictures, one after the other with gaps.
        rows: number of rows of each picture.

    Returns:
        Scores (columns, n); and (columns, 3, pictures, 1) of the best path that comes from elsewhere to a column, of
        the best one with no stripe in it, and of the best one with a stripe.
    """
    best = np.empty_like(seen)
    best[:, :2] = best[:, -2:] = -np.inf
    scores = _without_gaps(best, rows)
    columns, pictures = scores.shape[:2]
    ends = np.zeros((columns, 3, pictures, 1), np.float32)
    costs = np.array([[COST_OF_END, COST_OF_JUMP], [0.0, COST_OF_END]], np.float32)[:, :, None, None]
    ended = np.empty((2, 2, pictures, 1), np.float32)
    here, near = np.full((2, seen.shape[1]), -np.inf, np.float32)
    start = _without_gaps(here[None], rows)[0]
    # Moves by one row, and after these by two, are all up to REACH_ROWS, each at its price.
    above, at, below, moved = here[:-2], here[1:-1], here[2:], near[1:-1]
    above_2, at_2, below_2 = near[:-4], near[2:-2], near[4:]
    one, two = np.empty(above.size, np.float32), np.empty(above_2.size, np.float32)
    price_of_one, price_of_two = np.array([[COST_PER_ROW], [2 * COST_PER_ROW]], np.float32)
    np.subtract(seen[0], np.float32(COST_OF_END), out=best[0])
    maximum, add, subtract, highest = np.maximum, np.add, np.subtract, np.maximum.reduce
    for before, now, own, top, before_ends, now_ends, elsewhere in zip(
        scores[:-1],
        best[1:, 2:-2],
        seen[1:, 2:-2],
        ends[:-1, 2],
        ends[:-1, 1:],
        ends[1:, :2],
        ends[1:, 0],
        strict=True,
    ):
        highest(before, axis=1, keepdims=True, out=top)
        subtract(before_ends, costs, out=ended)
        highest(ended, axis=1, out=now_ends)
        maximum(before, elsewhere, out=start)
        maximum(above, below, out=one)
        subtract(one, price_of_one, out=one)
        maximum(at, one, out=moved)
        maximum(above_2, below_2, out=two)
        subtract(two, price_of_two, out=two)
        maximum(at_2, two, out=now)
        add(now, own, out=now)
    return best, ends


def _begin(picture: int, rows: int) -> int:
    """Index at which the rows of a picture begin; of the number of pictures, the length of them all with the gaps."""
    return REACH_ROWS + picture * (rows + REACH_ROWS)


def _without_gaps(line: Float32, rows: int) -> Float32:
    """View (columns, pictures, rows) of an array (columns, n) of pictures with gaps."""
    return line[:, REACH_ROWS:].reshape(len(line), -1, rows + REACH_ROWS)[:, :, :rows]


def _traced(best: Float32, ends: Float32, picture: int, rows: int, last: int, row: int) -> list[int]:
    """Follow the best path of a picture back from a row (or NONE) of one column to the first column."""
    begin, length = _begin(picture, rows), best.shape[1]
    flat = memoryview(best.reshape(-1))  # type: ignore[arg-type]
    elsewhere, none, top = ends[:, :, picture, 0].T.tolist()
    path = [row]
    for column in range(last - 1, -1, -1):
        # Coming from a stripe elsewhere costs this much more than coming from no stripe.
        extra = COST_OF_END
        if row != NONE:
            at = column * length + begin + row
            near = list(map(sub, flat[at - REACH_ROWS : at + REACH_ROWS + 1].tolist(), PRICES))
            score = max(near)
            if score >= elsewhere[column + 1]:
                row += near.index(score) - REACH_ROWS
                path.append(row)
                continue
            extra = COST_OF_JUMP - COST_OF_END
        is_stripe = top[column] - extra > none[column]
        row = int(best[column, begin : begin + rows].argmax()) if is_stripe else NONE
        path.append(row)
    return path


def _filled(path: Index) -> Index:
    """A path (columns,) with the row of the nearest stripe where there is none."""
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
    """Columns of the pieces that are long enough and have this share of the height of the strong ones."""
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
    """Columns of the pieces that have the laser's colour, as far as they are not clipped."""
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
