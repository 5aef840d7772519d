"""Readings of standing soles, and the feet that stayed in place between two pauses.

Feet that stay keep their distances from each other however the body moves. The largest set of feet whose mutual
distances did not change is therefore taken as the feet that stayed; of equally large sets, the one with the smallest
changes. The other sets of this size remain possible, because a foot that slides perpendicular to the line to another
foot keeps its distance from it. A swing past another foot can preserve a distance by chance. The line between two feet
must therefore not have rotated by more than the body can turn.

A flat sole that carries the body keeps its pitch to within a degree or two. Its measured pitch also contains the noise
of the leg's joints, which displaces the measured sole too; the covariance of pitch and position relates the two. A
round foot has no meaningful pitch. Legs of fewer than four joints are assumed to have round feet, since they cannot
keep a flat sole level.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from kinematics.arrays import Float
from kinematics.stance_pose import StanceNoise, StancePose
from kinematics.transforms import transform_points

# Variance of the unknown pitch of a round foot [rad^2].
NOTHING_KNOWN = 1.0
# Minimum sigma of a flat sole's pitch from pause to pause [rad]. Soles on stiff ankles rock on their edges by 1 to 2
# degrees, all in the same direction. Treated as joint noise, this rocking biased odometry by 5 % of the distance in
# MuJoCo.
ROCK_SIGMA = 0.02


def find_stayed_feet(
    soles_now: Float,
    covariances_now: Float,
    soles_before: Float,
    covariances_before: Float,
    *,
    slip_sigmas: float,
    turn_limit: float,
) -> list[tuple[int, ...]]:
    """Find the sets of feet that may have stayed, the likeliest first; empty if no two feet stayed.

    All sets are of the same size; each contains the rows of its feet in ascending order.

    Args:
        soles_now: (n, 3) sole centres at this pause, in a frame fixed to the body [m].
        covariances_now: (n, 3, 3) covariances of `soles_now` [m^2].
        soles_before: (n, 3) the same soles at the previous pause, in the same frame [m].
        covariances_before: (n, 3, 3) covariances of `soles_before` [m^2].
        slip_sigmas: change of a distance, in standard deviations, above which a foot has moved.
        turn_limit: largest rotation of the body between two pauses [rad].
    """
    count = len(soles_now)
    change = np.zeros((count, count))
    for i, j in combinations(range(count), 2):
        change[i, j] = _distance_change(
            soles_now[[i, j]],
            soles_before[[i, j]],
            (covariances_now[i] + covariances_now[j], covariances_before[i] + covariances_before[j]),
            turn_limit,
        )
    for size in range(count, 1, -1):
        held = [
            (sum(change[i, j] for i, j in combinations(rows, 2)), rows)
            for rows in combinations(range(count), size)
            if all(change[i, j] <= slip_sigmas for i, j in combinations(rows, 2))
        ]
        if held:
            return [rows for _, rows in sorted(held)]
    return []


def _distance_change(now: Float, before: Float, covariances: tuple[Float, Float], turn_limit: float) -> float:
    """Change of the distance between two feet in standard deviations; infinite if their line turned too far."""
    line_now, line_before = now[1] - now[0], before[1] - before[0]
    length_now, length_before = np.linalg.norm(line_now), np.linalg.norm(line_before)
    along_now, along_before = line_now / length_now, line_before / length_before
    sigma = np.sqrt(along_now @ covariances[0] @ along_now + along_before @ covariances[1] @ along_before)
    if along_now @ along_before < np.cos(turn_limit):
        return float("inf")
    return float(abs(length_now - length_before) / sigma)


def sole_readings(pose: StancePose, legs: Sequence[str], noise: StanceNoise) -> tuple[Float, Float]:
    """Positions and pitches of soles in the footprint, with covariances.

    Args:
        pose: the stance pose.
        legs: names of the legs.
        noise: standard deviations.

    Returns:
        Readings (n, 4): x, y, z of the centre [m] and pitch of the sole relative to the horizontal [rad]; and their
        covariances (n, 4, 4). These include errors of encoders, contact, sole pitch and, for the pitch, the vertical,
        but not the shift common to all soles that an error of the vertical causes. The pitch of a round foot has the
        variance `NOTHING_KNOWN`.
    """
    rotation = pose.transform_base_to_footprint[:3, :3]
    tree, state = pose.state.tree, pose.state
    centres = transform_points(pose.transform_base_to_footprint, state.soles_in_base(legs))
    readings, covariances = np.zeros((len(centres), 4)), np.zeros((len(centres), 4, 4))
    vertical_variance = float(np.mean(np.diag(pose.covariance)[3:5]))
    for row, leg in enumerate(legs):
        config = tree.leg(leg)
        x, y, z = rotation @ state.transform_to_base(config.sole)[:3, 0]
        horizontal = np.hypot(x, y)
        readings[row] = *centres[row], np.arctan2(-z, horizontal)
        jacobian = state.noise_jacobian(config.sole)
        pitch_axis = np.array([-y, x, 0.0]) / horizontal
        by_joints = np.vstack([rotation @ jacobian[:3], pitch_axis @ rotation @ jacobian[3:]])
        covariances[row] = noise.encoder_sigma**2 * by_joints @ by_joints.T
        pitch_variance = max(noise.sole_pitch_sigma, ROCK_SIGMA) ** 2 + vertical_variance
        covariances[row] += np.diag([noise.contact_sigma**2] * 3 + [pitch_variance])
        if len(config.joints) < 4:
            covariances[row, 3] = covariances[row, :, 3] = 0.0
            covariances[row, 3, 3] = NOTHING_KNOWN
    return readings, covariances
