"""Detection of calibration drift from ordinary scans: check of a single scan, and verdict over several pauses."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Index, Mask
from guara_perception.stripes.kernel.library import address, addresses, kernel
from kinematics.arrays import FrozenArrays

# Number of equal intervals of y that divide each stripe into parts. The height of a part is the median of its points;
# it is unknown if the part has fewer than LEAST_POINTS.
PARTS = 12
PAIRS = np.array(list(combinations(range(PARTS), 2)))
LEAST_POINTS = 4
# Largest distance at which a part counts as on a line: fifteen times the scatter of medians on a flat floor.
LINE_TOLERANCE_M = 0.0005
# A stripe is straight if at least this many of its parts, and this share of its known parts, are on one line.
LEAST_PARTS = 6
LEAST_SHARE = 0.7
HOLDS, DRIFTING, UNKNOWN = "holds", "drifting", "unknown"
# A scan shows a floor only if at least this many stripes, and this share of those with enough points, are straight.
MIN_STRIPES = 8
MIN_FLOOR_SHARE = 0.6
# Least extent of the floor along x. Rough ground also has straight stripes, but they extended over at most 0.23 m in 36
# scans.
MIN_DEPTH_M = 0.30
# Largest median roughness of a flat floor along the stripes. Flat floors have 0.02 to 0.08 mm. Ground that undulates by
# 2 mm has at least 0.14 mm where it looks flat, and a floor with glare, which must be rejected, has 0.16 mm.
MAX_ROUGHNESS_M = 0.00012
# Straight stripes farther than this from the plane of the others are not used to fit it: they are on something else,
# such as a box or a threshold, or the mirror missed a step.
APART_M = 0.008
# Largest rms distance of the ends of the stripes from one plane, and largest distance of the centre of a single stripe.
# The latter is also the smallest jump. A good calibration has 0.01 to 0.06 mm rms.
MAX_STRIPE_RMS_M = 0.00012
MAX_STRIPE_M = 0.0006
# Largest rms of the smooth part of these distances, a bend along x and a twist; FORM_SIGMAS times its uncertainty is
# added. A moved mount causes such a part; errors of single stripes average out. A good calibration has 0.001 to 0.012
# mm; a laser turned by 0.2 degrees about the vertical causes 0.08 mm.
MAX_FORM_M = 0.00003
FORM_SIGMAS = 3.0
# Distance from y = 0 at which the ends of the stripes are evaluated.
HALF_WIDTH_M = 0.2
# Largest height and tilt of the floor relative to z = 0 or to the plane of the soles. STANCE_SIGMAS times the
# uncertainty of the stance or of this plane, respectively, is added in quadrature.
MAX_FLOOR_HEIGHT_M = 0.003
MAX_FLOOR_TILT = float(np.deg2rad(0.6))
STANCE_SIGMAS = 3.0
# Standard deviation of a sole's height relative to the plane of the others, due to joints and ground [m].
SOLE_SIGMA_M = 0.0012
# A jump with at least JUMP_STRIPES stripes on each side explains the deviations if it reduces their sum of squares by
# more than the fraction JUMP_SHARE. Stripes farther than HIGHEST_JUMP_M from the floor are assumed to be on an object
# and ignored.
JUMP_SHARE = 0.8
JUMP_STRIPES = 2
HIGHEST_JUMP_M = 0.030
# The verdict is "drifting" if NEEDED of the last REMEMBERED scans with a floor show drift. One scan is not enough:
# a threshold in the floor or a bump along one stripe imitates drift, but not at the next pause.
REMEMBERED = 3
NEEDED = 2


@dataclass(frozen=True, slots=True)
class FloorLines(FrozenArrays):
    """Straight stripes of a scan as lines z = offset + slope y, ascending by index.

    A stripe on a flat floor stays straight when the camera or the laser moves, but ground that is not flat bends it.
    Straight stripes therefore indicate a flat floor, and the positions of the lines test the calibration.

    Attributes:
        seen: number of stripes with enough points.
        index: (s,) indices of the straight stripes.
        x: (s,) mean x of the parts on the line [m].
        offset: (s,) z at y = 0 [m].
        slope: (s,) dz/dy [-].
        roughness: (s,) rms distance of the parts from the line [m].
    """

    seen: int
    index: Index
    x: Float
    offset: Float
    slope: Float
    roughness: Float


def find_floor_lines(points: Mapping[int, Float]) -> FloorLines:
    """Find the stripes that run straight over most of their length, and fit a line to each.

    Args:
        points: stripe index -> points (w, 3) of the stripe in base_footprint [m], NaN where there is none.
    """
    index, x, y, z = _parts(points)
    enough = np.flatnonzero(np.isfinite(z).sum(axis=1) >= LEAST_PARTS)
    index, x, y, z = index[enough], x[enough], y[enough], z[enough]
    on_line = _largest_agreement(y, z)
    count = on_line.sum(axis=1)
    straight = (count >= LEAST_PARTS) & (count >= LEAST_SHARE * np.isfinite(z).sum(axis=1))
    on_line, count = on_line[straight], count[straight]
    x, y, z = (np.where(on_line, values[straight], 0.0) for values in (x, y, z))
    mean_y, mean_z = y.sum(axis=1) / count, z.sum(axis=1) / count
    dy, dz = (np.where(on_line, v - m[:, None], 0.0) for v, m in ((y, mean_y), (z, mean_z)))
    slope = (dy * dz).sum(axis=1) / (dy * dy).sum(axis=1)
    rest = dz - slope[:, None] * dy
    return FloorLines(
        seen=len(enough),
        index=index[straight],
        x=x.sum(axis=1) / count,
        offset=mean_z - slope * mean_y,
        slope=slope,
        roughness=np.sqrt((rest * rest).sum(axis=1) / (count - 2)),
    )


def _parts(points: Mapping[int, Float]) -> tuple[Index, Float, Float, Float]:
    """Indices (s,) of the stripes; mean x, mean y and median z (s, PARTS) of their parts, NaN with too few points."""
    indices = sorted(points)
    each = [np.asarray(points[index]).T for index in indices]
    stacked = np.concatenate([np.empty((3, 0)), *each], axis=1, dtype=np.float64)
    ends = np.cumsum([0, *(values.shape[1] for values in each)], dtype=np.int64)[1:]
    found, work = np.empty((3, len(indices), PARTS)), np.empty(2 * (stacked.shape[1] + PARTS))
    given = address(stacked), stacked.shape[1], address(ends), len(indices), PARTS, LEAST_POINTS
    kernel().parts_of_stripes(*given, *addresses(work, found))
    x, y, z = found
    return np.array(indices, np.intp), x, y, z


def _largest_agreement(y: Float, z: Float) -> Mask:
    """Mask (s, PARTS) of the parts on each stripe's best line, the line through two parts with the largest weight."""
    if not len(z):
        return np.zeros((0, PARTS), np.bool_)
    first, second = PAIRS.T
    slope = (z[:, second] - z[:, first]) / (y[:, second] - y[:, first])
    distance = z[:, None, :] - z[:, first, None] - slope[:, :, None] * (y[:, None, :] - y[:, first, None])
    np.abs(distance, out=distance)
    # The weight of a part on the line decreases from 1 to 0.5 with its distance. A part without points is on no line.
    is_near = distance < LINE_TOLERANCE_M
    weight = np.where(is_near, 1.0 - 0.5 * distance / LINE_TOLERANCE_M, 0.0)
    best = np.argmax(weight.sum(axis=2), axis=1)
    return np.asarray(is_near[np.arange(len(z)), best])


@dataclass(frozen=True, slots=True)
class Drift:
    """Outcome of a drift check.

    For the verdict "unknown", `worst_stripe` is -1 and all other numbers are NaN, except `floor_share`, which is NaN
    only if too few stripes have points.

    Attributes:
        verdict: "holds", "drifting", or "unknown" if the scan shows no flat floor to compare with.
        reasons: reasons, with numbers, for a verdict other than "holds".
        floor_share: share of the stripes with enough points that are straight and, if a plane was fitted, near it.
        floor_height: height of the floor at the mean x of its visible part [m].
        floor_tilt: angle of the floor relative to the horizontal [rad].
        stripe_rms: rms distance of the ends of the stripes on the floor, at y = +-HALF_WIDTH_M, from one plane [m].
        worst_stripe: index of the stripe on the floor whose centre deviates most.
        worst_distance: signed distance of this centre from the plane [m].
    """

    verdict: str
    reasons: tuple[str, ...]
    floor_share: float
    floor_height: float
    floor_tilt: float
    stripe_rms: float
    worst_stripe: int
    worst_distance: float

    def to_dict(self) -> dict[str, Any]:
        """Convert the outcome to JSON values, with None for unknown numbers."""
        numbers = ("floor_share", "floor_height", "floor_tilt", "stripe_rms", "worst_distance")
        return {
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "worst_stripe": None if self.worst_stripe < 0 else self.worst_stripe,
            **{name: None if np.isnan(getattr(self, name)) else float(getattr(self, name)) for name in numbers},
        }


def check_drift(
    points: Mapping[int, Float],
    pose_covariance: npt.ArrayLike | None = None,
    soles_in_footprint: npt.ArrayLike | None = None,
) -> Drift:
    """Compare the floor in a scan with its expected position.

    Each stripe is triangulated with its own laser plane. On a flat floor each stripe is a straight line even if the
    camera or the laser moved; if too few stripes are straight, the verdict is "unknown". All lines must lie in one
    plane: a moved mount or mirror violates this condition, a tilted body or floor does not. This plane must also agree
    with z = 0 or with the plane of the soles.

    Args:
        points: stripe index -> points (w, 3) of the stripe in base_footprint [m], NaN where there is none
            (`StripePoints.points` of a processed scan).
        pose_covariance: (6, 6) covariance of the stance (x y z [m], rotations [rad]), which widens the limits of height
            and tilt of the floor. None = the stance is exact.
        soles_in_footprint: (n, 3) supporting soles [m]. With three or more, the floor may agree with the plane of the
            soles instead of z = 0, so that a slope under both the robot and the stripes is not taken for drift. If the
            soles are not in one plane, height and tilt are not judged. None = compare the floor with z = 0 only.
    """
    lines = find_floor_lines(points)
    if lines.seen < MIN_STRIPES:
        return _unknown(f"{lines.seen} stripes have points; {MIN_STRIPES} or more are needed")
    share = len(lines.index) / lines.seen
    rough = float(np.median(lines.roughness)) if len(lines.index) else np.inf
    if len(lines.index) < MIN_STRIPES or share < MIN_FLOOR_SHARE or rough > MAX_ROUGHNESS_M:
        roughness = f", with a roughness of {1e3 * rough:.2f} mm" if MAX_ROUGHNESS_M < rough < np.inf else ""
        straight = f"{len(lines.index)} of {lines.seen} stripes run straight"
        return _unknown(f"no flat floor in view: {straight}{roughness}", share)
    plane, on_floor = _plane(lines)
    stray = lines.offset - plane[0] * lines.x - plane[2]
    near = np.abs(stray) < HIGHEST_JUMP_M
    share, depth = int(near.sum()) / lines.seen, float(np.ptp(lines.x[near]))
    if on_floor.sum() < MIN_STRIPES or share < MIN_FLOOR_SHARE or depth < MIN_DEPTH_M:
        return _unknown(
            f"no flat floor in view: {int(near.sum())} of {lines.seen} stripes are near one plane, "
            f"over {depth:.2f} m along x",
            share,
        )
    ends = HALF_WIDTH_M * (lines.slope - plane[1])
    rms = float(np.sqrt(np.mean(stray[on_floor] ** 2 + ends[on_floor] ** 2)))
    worst = int(np.argmax(np.where(on_floor, np.abs(stray), 0.0)))
    centre_x = float(lines.x[on_floor].mean())
    height, tilt = float(plane[0] * centre_x + plane[2]), float(np.arctan(np.hypot(plane[0], plane[1])))
    reasons = _floor_reasons(plane, centre_x, (height, tilt), pose_covariance, soles_in_footprint)
    reasons += _stripe_reasons(lines, stray, on_floor, rms)
    verdict, stripe = DRIFTING if reasons else HOLDS, int(lines.index[worst])
    return Drift(verdict, tuple(reasons), share, height, tilt, rms, stripe, float(stray[worst]))


def _plane(lines: FloorLines) -> tuple[Float, Mask]:
    """Coefficients (a, b, c) of the plane z = a x + b y + c that contains most lines, and mask (s,) of these lines."""
    x, offset = lines.x, lines.offset
    first, second = np.triu_indices(len(x), 1)
    apart = np.abs(x[second] - x[first]) > 0.25 * np.ptp(x)
    first, second = first[apart], second[apart]
    rise = (offset[second] - offset[first]) / (x[second] - x[first])
    # Least median of squares: half of the lines may lie elsewhere.
    distance = np.abs(offset - offset[first, None] - rise[:, None] * (x - x[first, None]))
    best = int(np.argmin(np.median(distance, axis=1)))
    on_floor = distance[best] < APART_M
    for _ in range(2):
        a, c = np.polyfit(x[on_floor], offset[on_floor], 1)
        on_floor = np.abs(offset - a * x - c) < APART_M
    return np.array([a, np.median(lines.slope[on_floor]), c]), on_floor


def _floor_reasons(
    plane: Float,
    centre_x: float,
    height_and_tilt: tuple[float, float],
    pose_covariance: npt.ArrayLike | None,
    soles: npt.ArrayLike | None,
) -> list[str]:
    """Reasons why the floor is neither at z = 0 nor, if known, in the plane of the soles."""
    height, tilt = height_and_tilt
    high, tilted = _allowed(pose_covariance, centre_x)
    is_high, is_tilted = abs(height) > high, tilt > tilted
    if soles is not None and len(np.asarray(soles)) >= 3:
        x, y, z = np.asarray(soles, np.float64).T
        terms = np.column_stack((x, y, np.ones(x.size)))
        support, _ = _fit(terms, z)
        if np.abs(z - terms @ support).max() > STANCE_SIGMAS * SOLE_SIGMA_M:
            return []
        cofactors = np.linalg.pinv(terms.T @ terms)
        own_sigma = STANCE_SIGMAS * SOLE_SIGMA_M * np.sqrt(np.diag(cofactors))
        off = plane - support
        is_tilted &= float(np.hypot(off[0], off[1])) > np.hypot(MAX_FLOOR_TILT, np.hypot(own_sigma[0], own_sigma[1]))
        reach = np.array([centre_x, 0.0, 1.0]) @ cofactors @ (centre_x, 0.0, 1.0)
        is_high &= abs(off[0] * centre_x + off[2]) > np.hypot(
            MAX_FLOOR_HEIGHT_M, STANCE_SIGMAS * SOLE_SIGMA_M * np.sqrt(reach)
        )
    reasons = []
    if is_high:
        reasons.append(
            f"the floor is at {1e3 * height:+.1f} mm relative to the soles (limit {1e3 * high:.1f} mm): the camera or "
            "laser mount moved, or the feet stand on something"
        )
    if is_tilted:
        reasons.append(
            f"the floor is tilted by {np.rad2deg(tilt):.2f} degrees (limit {np.rad2deg(tilted):.2f} degrees): the "
            "camera mount rotated, or the ground slopes"
        )
    return reasons


def _allowed(pose_covariance: npt.ArrayLike | None, centre_x: float) -> tuple[float, float]:
    """Limits of height [m] and tilt [rad], including the uncertainty of the stance."""
    if pose_covariance is None:
        return MAX_FLOOR_HEIGHT_M, MAX_FLOOR_TILT
    covariance = np.asarray(pose_covariance, dtype=np.float64)
    # The height at the centre of the floor has the error dz - x * dpitch.
    lever = np.array([0.0, 0.0, 1.0, 0.0, -centre_x, 0.0])
    height = STANCE_SIGMAS * float(np.sqrt(lever @ covariance @ lever))
    tilt = STANCE_SIGMAS * float(np.sqrt(max(covariance[3, 3], covariance[4, 4])))
    return float(np.hypot(MAX_FLOOR_HEIGHT_M, height)), float(np.hypot(MAX_FLOOR_TILT, tilt))


def _stripe_reasons(lines: FloorLines, stray: Float, on_floor: Mask, rms: float) -> list[str]:
    """Reasons why the stripes do not lie on one plane floor."""
    jump = _jump(lines, stray) if rms > MAX_STRIPE_RMS_M or not on_floor[-1] else None
    if jump is not None:
        return [
            f"from stripe index {jump[0]} on, all points are {1e3 * jump[1]:+.1f} mm off the floor of the earlier "
            "stripes: the mirror missed a step, or the ground itself has a step across the whole width"
        ]
    form, doubt = _form(lines, stray, on_floor)
    worst = int(np.argmax(np.where(on_floor, np.abs(stray), 0.0)))
    alone = abs(stray[worst]) > MAX_STRIPE_M and rms**2 - stray[worst] ** 2 / on_floor.sum() < MAX_STRIPE_RMS_M**2
    if rms > MAX_STRIPE_RMS_M and not alone:
        return [
            f"the stripes deviate by {1e3 * rms:.2f} mm rms from a plane floor "
            f"(limit {1e3 * MAX_STRIPE_RMS_M:.2f} mm): camera, laser or mirror moved"
        ]
    if form > MAX_FORM_M + FORM_SIGMAS * doubt:
        return [
            f"the floor measured by the stripes is bent or twisted by {1e3 * form:.2f} mm rms "
            f"(limit {1e3 * (MAX_FORM_M + FORM_SIGMAS * doubt):.2f} mm): camera, laser or mirror moved"
        ]
    if alone:
        return [
            f"stripe index {lines.index[worst]} is {1e3 * stray[worst]:+.2f} mm off the floor of the other stripes "
            f"(limit {1e3 * MAX_STRIPE_M:.2f} mm): the mirror did not reach its position"
        ]
    return []


def _form(lines: FloorLines, stray: Float, on_floor: Mask) -> tuple[float, float]:
    """Rms of the floor's bend along x and twist [m], and its sigma from the residuals of single stripes [m]."""
    x, offset, ends = lines.x[on_floor], stray[on_floor], HALF_WIDTH_M * lines.slope[on_floor]
    x = (x - x.mean()) / np.ptp(x)
    linear, quadratic = np.vander(x, 2), np.vander(x, 3)
    bend = quadratic @ _fit(quadratic, offset)[0] - linear @ _fit(linear, offset)[0]
    twist = linear @ _fit(linear, ends)[0]
    rest = float(np.var(offset - offset.mean() - bend) + np.var(ends - twist))
    return float(np.hypot(np.std(bend), np.std(twist))), float(np.sqrt(rest / len(x)))


def _jump(lines: FloorLines, stray: Float) -> tuple[int, float] | None:
    """Index of the first stripe after a jump, and the height of the jump [m]; None for no jump."""
    count = len(stray)
    near = np.abs(stray) < HIGHEST_JUMP_M
    terms = np.column_stack((lines.x, np.ones(count)))[near]
    z, entries = stray[near], np.flatnonzero(near)
    whole = max(_fit(terms, z)[1], 1e-30)
    best, found = JUMP_SHARE, None
    for after in range(JUMP_STRIPES, len(z) - JUMP_STRIPES + 1):
        jump = (np.arange(len(z)) >= after).astype(float)
        solved, rest = _fit(np.column_stack((terms, jump)), z)
        explained = 1.0 - rest / whole
        if explained > best and abs(solved[2]) > MAX_STRIPE_M:
            best, found = explained, (int(lines.index[entries[after]]), float(solved[2]))
    return found


def _fit(terms: Float, z: Float) -> tuple[Float, float]:
    """Least-squares coefficients of terms (n, k) for z (n,), and the sum of squared residuals."""
    solved, *_ = np.linalg.lstsq(terms, z, rcond=None)
    return np.asarray(solved, dtype=np.float64), float(np.square(z - terms @ solved).sum())


def _unknown(reason: str, share: float = float("nan")) -> Drift:
    nan = float("nan")
    return Drift(UNKNOWN, (reason,), share, nan, nan, nan, -1, nan)


class DriftWatch:
    """Drift verdict over the pauses of a walk; one scan is not enough for the verdict "drifting".

    Example:
        watch = DriftWatch()
        watch.add(check_drift(points, covariance, soles))
        if watch.verdict == "drifting": ...
    """

    def __init__(self) -> None:
        self._with_floor: deque[Drift] = deque(maxlen=REMEMBERED)
        self._counts: Counter[str] = Counter()

    def add(self, drift: Drift) -> None:
        """Add the outcome of the next pause; an outcome without a floor is counted but does not affect the verdict."""
        self._counts[drift.verdict] += 1
        if drift.verdict != UNKNOWN:
            self._with_floor.append(drift)

    @property
    def verdict(self) -> str:
        """Verdict on the walk: "unknown" before the first scan with a floor.

        Later, it is "drifting" if two or more of the last three scans with a floor show drift, and "holds" otherwise.
        """
        if not self._with_floor:
            return UNKNOWN
        return DRIFTING if sum(drift.verdict == DRIFTING for drift in self._with_floor) >= NEEDED else HOLDS

    @property
    def counts(self) -> dict[str, int]:
        """Number of scans with each verdict."""
        return {verdict: self._counts[verdict] for verdict in (HOLDS, DRIFTING, UNKNOWN)}
