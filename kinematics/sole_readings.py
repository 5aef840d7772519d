"""What the joints say of the standing soles at one pause: where each centre is, and how far each sole is pitched.

The pitch is read because a flat sole that carries the body keeps it: what it seems to change between two pauses is
noise of the leg's joints, and the same noise displaces the sole. Their covariance tells by how much. A round foot (a
leg of fewer than four joints cannot hold a flat one level) has no meaningful pitch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinematics.arrays import Float
from kinematics.stance_pose import StanceNoise, StancePose
from kinematics.transforms import transform_points

# Variance of the pitch of a round foot [rad^2]: no information.
NOTHING_KNOWN = 1.0


def sole_readings(pose: StancePose, legs: Sequence[str], noise: StanceNoise) -> tuple[Float, Float]:
    """Readings of the soles in the footprint.

    Args:
        pose: the stance pose.
        legs: names of the legs whose soles are read.
        noise: standard deviations.

    Returns:
        Readings (n, 4): x, y, z of the centre [m] and pitch of the sole against the horizontal [rad]; and covariances
        (n, 4, 4) of these by encoders and contact, without the shift that a wrong vertical gives all of them alike.
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
        jacobian = state.jacobian(config.sole)
        pitch_axis = np.array([-y, x, 0.0]) / horizontal
        by_joints = np.vstack([rotation @ jacobian[:3], pitch_axis @ rotation @ jacobian[3:]])
        covariances[row] = noise.encoder_sigma**2 * by_joints @ by_joints.T
        covariances[row] += np.diag([noise.contact_sigma**2] * 3 + [noise.sole_pitch_sigma**2 + vertical_variance])
        if len(config.joints) < 4:
            covariances[row, 3] = covariances[row, :, 3] = 0.0
            covariances[row, 3, 3] = NOTHING_KNOWN
    return readings, covariances
