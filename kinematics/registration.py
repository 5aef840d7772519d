"""Finds the turn about the vertical and the shift that lay the soles of one pause onto those of another.

Both sets stand in gravity-aligned frames, so only heading and translation are unknown: two feet are enough. With p_i
the soles now and q_i before (horizontal parts), R the turn by the angle a and t the shift, it minimises

    sum_i rho(e_i' W_i e_i),   e_i = q_i - R p_i - t,   W_i = (C_qi + R C_pi R')^-1

by Gauss-Newton from the closed-form solution; rho is Huber's function, so that one foot that crept does not pull the
others.
"""

from dataclasses import dataclass

import numpy as np

from kinematics.tree import Array, read_only

_HUBER_LIMIT = 1.5
"""Sigmas beyond which a foot's pull stops growing: costs 5 % of precision where nothing slips."""

_MISFIT_LIMIT = 3.0
"""Chi-square per degree of freedom above which the noise was not the cause: 3 % by chance with three feet."""

_ITERATIONS = 5
"""The start is closed-form and the turn small: it stands still to 1e-12 m after three."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The transform from a pause's footprint to the one before.

    Attributes:
        transform_now_to_before: (4, 4), a turn about z and a shift.
        by_now: (n, 6, 3) d(transform) / d(each sole now), rows in REP-103 order; roll and pitch stay zero.
        by_before: (n, 6, 3) d(transform) / d(each sole before).
        misfit: chi-square per degree of freedom, 1 where noise explains it: how much worse the soles fit than their
            noise says.
        residual: rms horizontal distance of the registered soles [m].
    """

    transform_now_to_before: Array
    by_now: Array
    by_before: Array
    misfit: float
    residual: float


def turn(angle: float) -> Array:
    """Rotation (2, 2) by an angle [rad] in the horizontal plane."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def register_soles(
    soles_now: Array, covariances_now: Array, soles_before: Array, covariances_before: Array
) -> Registration:
    """Register the soles that stayed.

    Args:
        soles_now: (n, 3) in the footprint of this pause [m], n >= 2.
        covariances_now: (n, 3, 3) of the first [m^2].
        soles_before: (n, 3) the same feet in the footprint of the pause before [m].
        covariances_before: (n, 3, 3) of the second [m^2].
    """
    count = len(soles_now)
    angle, shift = _closed_form(soles_now[:, :2], soles_before[:, :2])
    for _ in range(_ITERATIONS):
        rotation = turn(angle)
        turned = soles_now[:, :2] @ rotation.T
        errors = soles_before[:, :2] - turned - shift
        weights = np.linalg.inv(covariances_before[:, :2, :2] + rotation @ covariances_now[:, :2, :2] @ rotation.T)
        distances = np.sqrt(np.einsum("ni,nij,nj->n", errors, weights, errors))
        weights *= np.minimum(1.0, _HUBER_LIMIT / np.maximum(distances, _HUBER_LIMIT))[:, None, None]
        by_unknowns = np.zeros((count, 2, 3))
        by_unknowns[:, :, :2] = np.eye(2)
        by_unknowns[:, 0, 2], by_unknowns[:, 1, 2] = -turned[:, 1], turned[:, 0]
        information = np.einsum("nki,nkl,nlj->ij", by_unknowns, weights, by_unknowns)
        gains = np.linalg.solve(information, np.einsum("nki,nkl->nil", by_unknowns, weights))
        step = np.einsum("nil,nl->i", gains, errors)
        shift, angle = shift + step[:2], angle + step[2]
    rise_weights = 1.0 / (covariances_before[:, 2, 2] + covariances_now[:, 2, 2])
    rise_weights /= rise_weights.sum()
    transform = np.eye(4)
    transform[:2, :2], transform[:2, 3] = turn(angle), shift
    transform[2, 3] = rise_weights @ (soles_before[:, 2] - soles_now[:, 2])
    by_before = np.zeros((count, 6, 3))
    by_before[:, [0, 1, 5], :2] = gains
    by_before[:, 2, 2] = rise_weights
    misfit = float(np.sum(distances**2)) / (2 * count - 3)
    return Registration(
        transform_now_to_before=read_only(transform),
        by_now=read_only(-by_before @ transform[:3, :3]),
        by_before=read_only(by_before),
        misfit=misfit if misfit > _MISFIT_LIMIT else 1.0,
        residual=float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
    )


def _closed_form(now: Array, before: Array) -> tuple[float, Array]:
    """Unweighted least squares: the angle between the centred sets, then the shift between their centres."""
    p, q = now - now.mean(axis=0), before - before.mean(axis=0)
    angle = float(np.arctan2(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p * q)))
    return angle, before.mean(axis=0) - turn(angle) @ now.mean(axis=0)
