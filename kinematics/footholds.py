"""Kalman filter of the footholds in `odom`, and the footprint fitted to them at each pause.

A foothold is four numbers: x, y, z of the sole's centre and the sole's pitch, which does not change while the foot
stands. Each foot stands for several pauses, so its foothold is known better than from one reading. At each pause, the
footprint (heading a, position t) is fitted so that the readings p_i of the feet that stayed fall on their footholds
x_i. With R the rotation by a, and index s for the rows or columns of the feet that stayed:

    e_i = x_i - (R p_i + t),   V = P_ss + R C R'          P: covariance of the footholds, C: of the readings
    S = (H' V^-1 H)^-1                                    covariance of the footprint; H: d(R p + t) / d(t, a)
    W = V^-1 - V^-1 H S H' V^-1
    x' = x - P_:s W e,   P' = P - P_:s W P_s:             the footholds, corrected by the residuals of the fit
    cov(footprint, x') = S H' V^-1 P_s:

The foothold of a foot that was set down since the last pause is computed from the footprint, including the
cross-covariance. Noise is therefore neither counted twice nor summed as if pauses were independent, which would double
the sigma of the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kinematics.arrays import Float, read_only

# Huber's limit [sigmas], beyond which the influence of a residual is constant. It costs 7 % of efficiency if no foot
# slips.
HUBER_LIMIT = 1.5

# Noise makes chi-square per degree of freedom exceed 1 + MISFIT_LIMIT / sqrt(degrees of freedom) in about one of 100
# fits or fewer.
MISFIT_LIMIT = 4.6

# A sole whose pitch changed by more than this many standard deviations has rocked.
ROCKED_SIGMAS = 3.0

# From the closed-form start, three iterations converge to 1e-12 m.
ITERATIONS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Footprint of a pause, fitted to footholds.

    Attributes:
        transform_footprint_to_odom: (4, 4), a rotation about z and a translation.
        covariance: (4, 4) covariance of the footprint's x, y, z [m] and heading [rad], from noise alone.
        by_slides: (4, 4) covariance of the footprint's displacement in this motion if other feet stayed.
        residual: rms horizontal distance of the soles that stayed from their footholds [m].
        misfit: chi-square per degree of freedom if noise does not explain the residuals, otherwise 1.
        last_covariance: (4, 4) covariance of the previous footprint's x, y, z and heading.
        with_last: (4, 4) cross-covariance of the previous footprint's x, y, z and heading with those of this one.
    """

    transform_footprint_to_odom: Float
    covariance: Float
    by_slides: Float
    residual: float
    misfit: float
    last_covariance: Float
    with_last: Float


@dataclass(frozen=True, slots=True, eq=False)
class Footholds:
    """Positions of the standing feet in `odom`.

    Attributes:
        legs: names of the legs, one for each foothold.
        positions: (n, 4) sole centres [m] and pitches [rad].
        covariance: (4 n, 4 n) covariance of all positions.
        with_footprint: (4, 4 n) cross-covariance of the last footprint's x, y, z and heading with the positions.
        of_footprint: (4, 4) covariance of the last footprint's x, y, z and heading.
        by_slides: (4, 4) covariance of x, y, z and heading, about the origin of `odom`, of the displacement of the walk
            by slides that the joints cannot show. All footholds share this displacement, so no reading can reduce it.
            As part of `covariance` it would shrink, because a filter that is linearised again at each pause mistakes
            noise for information about the heading.
    """

    legs: tuple[str, ...]
    positions: Float
    covariance: Float
    with_footprint: Float
    of_footprint: Float
    by_slides: Float = field(default_factory=lambda: read_only(np.zeros((4, 4))))

    def after_pause(
        self,
        stayed: tuple[str, ...],
        legs: tuple[str, ...],
        readings: Float,
        covariances: Float,
        *,
        instead: Sequence[tuple[str, ...]] = (),
    ) -> tuple[Fit, Footholds]:
        """Fit the footprint of a new pause; return it with the footholds updated by the pause's readings.

        Args:
            stayed: two or more feet that stayed in place.
            legs: all feet that carry the body now, including those that stayed.
            readings: (n, 4) sole centres and pitches of all these feet in the new footprint [m, rad].
            covariances: (n, 4, 4) covariance of each reading.
            instead: other sets of feet that may have stayed. `Fit.by_slides` contains the displacements of the
                footprint that would keep these feet in place. A single foot determines no rotation.
        """
        now = [legs.index(leg) for leg in stayed]
        kept = np.concatenate([np.arange(4) + 4 * self.legs.index(leg) for leg in stayed])
        prior = self.covariance[np.ix_(kept, kept)]
        known = self.positions.ravel()[kept]
        covariances = _without_rocked(covariances, now, readings[now, 3] - known[3::4], np.diag(prior)[3::4])
        angle, shift = _closed_form(readings[now, :3], known.reshape(-1, 4)[:, :3])
        weights = np.ones(len(now))
        for _ in range(ITERATIONS):
            rotation = _turn(angle)
            by_pose = _by_pose(readings[now] @ rotation.T)
            errors = known - (readings[now] @ rotation.T + shift).ravel()
            noise = _blocks(rotation @ covariances[now] @ rotation.T / weights[:, None, None])
            inverse = np.linalg.inv(prior + noise)
            pose_covariance = np.linalg.inv(by_pose.T @ inverse @ by_pose)
            update = pose_covariance @ by_pose.T @ inverse @ errors
            shift, angle = shift + np.append(update[:3], 0.0), angle + float(update[3])
            weights = _pull(errors, prior + noise)
        unweighted = _blocks(rotation @ covariances[now] @ rotation.T)
        misfit = _misfit(errors, prior + unweighted)
        if misfit > 1.0:
            # Feet slipped in this motion. The noise of this pause's readings, not the drift of the walk so far, is
            # scaled until it explains the residuals.
            growth = misfit
            for _ in range(ITERATIONS):
                growth *= _chi_square(errors, prior + growth * unweighted)
            inverse = np.linalg.inv(prior + growth * noise)
            pose_covariance = np.linalg.inv(by_pose.T @ inverse @ by_pose)
        residual_weight = inverse - inverse @ by_pose @ pose_covariance @ by_pose.T @ inverse
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = _turn(angle)[:3, :3], shift[:3]
        # The residuals do not reveal these displacements, because any of the sets fits.
        by_slides = np.zeros((4, 4))
        for feet in instead:
            there = np.array([self.positions[self.legs.index(leg), :3] for leg in feet])
            here = readings[[legs.index(leg) for leg in feet]] @ rotation.T
            turn, move = _closed_form(here[:, :3], there)
            displaced = np.array([*(move - shift)[:2], 0.0, turn])
            by_slides += np.outer(displaced, displaced)
        fit = Fit(
            transform_footprint_to_odom=read_only(transform),
            covariance=read_only(0.5 * (pose_covariance + pose_covariance.T)),
            by_slides=read_only(by_slides),
            residual=float(np.sqrt(np.mean(np.sum(errors.reshape(-1, 4)[:, :2] ** 2, axis=1)))),
            misfit=misfit,
            last_covariance=self.of_footprint,
            # d(new footprint) / d(old footholds) = S H' V^-1.
            with_last=read_only(self.with_footprint[:, kept] @ (pose_covariance @ by_pose.T @ inverse).T),
        )
        cross_covariance = self.covariance[:, kept]
        posterior = replace(
            self,
            positions=read_only((self.positions.ravel() - cross_covariance @ residual_weight @ errors).reshape(-1, 4)),
            covariance=read_only(self.covariance - cross_covariance @ residual_weight @ cross_covariance.T),
            by_slides=read_only(self.by_slides + (back := _carried(-shift)) @ by_slides @ back.T),
        )
        cross = pose_covariance @ by_pose.T @ inverse @ cross_covariance.T
        # If the fit is poor or there are feet in `instead`, the feet in `stayed` may have slipped. All footholds are
        # then set to where the feet stand now.
        standing = stayed if misfit == 1.0 and not instead else ()
        return fit, posterior._with(fit, cross, standing, legs, readings, covariances)

    def _with(
        self,
        fit: Fit,
        cross: Float,
        stayed: tuple[str, ...],
        legs: tuple[str, ...],
        readings: Float,
        covariances: Float,
    ) -> Footholds:
        """Footholds of `legs`: unchanged for feet that stayed, computed from the fitted footprint for the others."""
        rotation = np.eye(4)
        rotation[:3, :3] = fit.transform_footprint_to_odom[:3, :3]
        shift = np.append(fit.transform_footprint_to_odom[:3, 3], 0.0)
        count, size = len(legs), len(self.positions)
        # Matrix that maps (footprint, old footholds) to the new footholds, and reading noise of feet that were set
        # down.
        source, fresh = np.zeros((4 * count, 4 + 4 * size)), np.zeros((count, 4, 4))
        positions = np.zeros((count, 4))
        for row, leg in enumerate(legs):
            block = slice(4 * row, 4 * row + 4)
            if leg in stayed:
                old = self.legs.index(leg)
                source[block, 4 + 4 * old : 8 + 4 * old] = np.eye(4)
                positions[row] = self.positions[old]
            else:
                source[block, :4] = _by_pose(readings[row : row + 1] @ rotation.T)
                positions[row] = rotation @ readings[row] + shift
                fresh[row] = rotation @ covariances[row] @ rotation.T
        joint = np.empty((4 + 4 * size, 4 + 4 * size))
        joint[:4, :4], joint[:4, 4:] = fit.covariance, cross
        joint[4:, :4], joint[4:, 4:] = cross.T, self.covariance
        covariance = source @ joint @ source.T + _blocks(fresh)
        return Footholds(
            legs,
            read_only(positions),
            read_only(0.5 * (covariance + covariance.T)),
            read_only(joint[:4] @ source.T),
            fit.covariance,
            self.by_slides,
        )

    def slides_at(self, position: Float) -> Float:
        """Covariance (4, 4) of the displacement by slides of a footprint at a position (2,) or longer in `odom`."""
        carried = _carried(position)
        return np.asarray(carried @ self.by_slides @ carried.T)

    @property
    def own_of_footprint(self) -> Float:
        """Covariance (4, 4) of the part of the last footprint's error that is independent of the footholds.

        Later pauses do not inherit this part.
        """
        shared = np.linalg.lstsq(self.covariance, self.with_footprint.T, rcond=1e-9)[0]
        own, directions = np.linalg.eigh(self.of_footprint - self.with_footprint @ shared)
        return np.asarray(directions * np.maximum(own, 0.0) @ directions.T)


def first_footholds(legs: tuple[str, ...], readings: Float, covariances: Float) -> Footholds:
    """Footholds of the first pause, whose footprint is `odom`, from readings (n, 4) and covariances (n, 4, 4)."""
    exact = read_only(np.zeros((4, 4)))
    return Footholds(
        legs, read_only(readings), read_only(_blocks(covariances)), read_only(np.zeros((4, readings.size))), exact
    )


def _without_rocked(covariances: Float, rows: list[int], rotated: Float, prior: Float) -> Float:
    """Make the pitch uninformative in the covariances (n, 4, 4) of soles that rocked, as on an edge or a pebble."""
    result = covariances.copy()
    for row, angle, variance in zip(rows, rotated, prior, strict=True):
        if angle**2 > ROCKED_SIGMAS**2 * (variance + covariances[row, 3, 3]):
            result[row, 3] = result[row, :, 3] = 0.0
            result[row, 3, 3] = 1.0
    return result


def _turn(angle: float) -> Float:
    """Rotation (4, 4) of (x, y, z, pitch) about z; the pitch is unchanged, as its axis turns too little to matter."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.eye(4)
    turn[:2, :2] = [[cosine, -sine], [sine, cosine]]
    return turn


def _by_pose(rotated: Float) -> Float:
    """Matrix H (4 n, 4): d(footholds) / d(x, y, z, heading) for readings (n, 4) already rotated by the heading."""
    derivative = np.zeros((len(rotated), 4, 4))
    derivative[:, :3, :3] = np.eye(3)
    derivative[:, 0, 3], derivative[:, 1, 3] = -rotated[:, 1], rotated[:, 0]
    return derivative.reshape(-1, 4)


def _carried(way: Float) -> Float:
    """Matrix (4, 4) that converts a small motion about a point to one about a point at an offset (2,) or longer."""
    matrix = np.eye(4)
    matrix[:2, 3] = -way[1], way[0]
    return matrix


def _blocks(covariances: Float) -> Float:
    """Arrange covariances (n, 4, 4) in one block-diagonal matrix (4 n, 4 n)."""
    count = len(covariances)
    return np.asarray(np.einsum("ij,ikl->ikjl", np.eye(count), covariances).reshape(4 * count, 4 * count))


def _pull(errors: Float, covariance: Float) -> Float:
    """Huber weight (n,) of each foot, from the foot's error and the covariance of that error."""
    own, foot = errors.reshape(-1, 4), np.arange(errors.size // 4)
    its_covariance = covariance.reshape(foot.size, 4, foot.size, 4)[foot, :, foot]
    distances = np.sqrt(np.vecdot(own, np.linalg.solve(its_covariance, own[..., None])[..., 0]))
    return np.asarray(np.minimum(1.0, HUBER_LIMIT / np.maximum(distances, HUBER_LIMIT)))


def _chi_square(errors: Float, covariance: Float) -> float:
    """Chi-square per degree of freedom of the residuals of a fit."""
    return float(errors @ np.linalg.solve(covariance, errors)) / (len(errors) - 4)


def _misfit(errors: Float, covariance: Float) -> float:
    """Chi-square per degree of freedom of the residuals, or 1 if noise explains them."""
    misfit = _chi_square(errors, covariance)
    return misfit if misfit > 1.0 + MISFIT_LIMIT / np.sqrt(len(errors) - 4) else 1.0


def _closed_form(soles: Float, positions: Float) -> tuple[float, Float]:
    """Heading and translation (4,) that map soles to positions, by unweighted least squares in closed form."""
    p, q = soles - soles.mean(axis=0), positions - positions.mean(axis=0)
    angle = float(np.arctan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p[:, :2] * q[:, :2])))
    shift = positions.mean(axis=0) - _turn(angle)[:3, :3] @ soles.mean(axis=0)
    return angle, np.append(shift, 0.0)
