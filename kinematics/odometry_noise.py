"""How the uncertainty of leg odometry grows from pause to pause, exactly to first order.

A sole is read at every pause. Its noise at one pause enters the step to that pause and, with the opposite sign, the
step from it: for a foot that stays, what was lost in one step is won back in the next. Adding the covariances of the
steps as if they were independent makes the result twice too large. So the correlation of the pose with the newest
reading of every sole is carried along:

    e' = F e + sum_i (A_i n'_i + B_i n_i)        e: error of the pose, n_i: noise of sole i, primed: this pause
    C' = F C F' + sum_i (A_i N'_i A_i' + B_i N_i B_i' + F X_i B_i' + B_i X_i' F')
    X'_i = A_i N'_i                              X_i = cov(e, n_i)
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kinematics.footprint import skew
from kinematics.registration import Registration
from kinematics.tree import Array


@dataclass(frozen=True, slots=True, eq=False)
class OdometryNoise:
    """Uncertainty of a footprint in `odom`.

    Attributes:
        covariance: (6, 6), REP-103 order.
        sole_covariances: leg -> (3, 3) of its sole in the newest footprint [m^2].
        correlations: leg -> (6, 3) covariance of the pose with that sole's reading.
    """

    covariance: Array
    sole_covariances: Mapping[str, Array]
    correlations: Mapping[str, Array]

    def after_step(
        self,
        transform_before_to_odom: Array,
        registration: Registration,
        legs: list[str],
        sole_covariances: Mapping[str, Array],
    ) -> "OdometryNoise":
        """The uncertainty one pause later.

        Args:
            transform_before_to_odom: (4, 4) of the footprint of the pause before.
            registration: of the soles that stayed.
            legs: whose soles these are, in the registration's order.
            sole_covariances: leg -> (3, 3) of every sole in the footprint of this pause [m^2].
        """
        rotation = transform_before_to_odom[:3, :3]
        to_odom = np.zeros((6, 6))
        to_odom[:3, :3] = to_odom[3:, 3:] = rotation
        lever = np.eye(6)
        lever[:3, 3:] = -skew(rotation @ registration.transform_now_to_before[:3, 3])
        covariance = lever @ self.covariance @ lever.T
        correlations: dict[str, Array] = {}
        for leg, by_now, by_before in zip(legs, registration.by_now, registration.by_before, strict=True):
            now, before = to_odom @ by_now, to_odom @ by_before
            fresh = now @ sole_covariances[leg] @ now.T + before @ self.sole_covariances[leg] @ before.T
            covariance = covariance + registration.misfit * fresh
            if leg in self.correlations:
                shared = lever @ self.correlations[leg] @ before.T
                covariance += shared + shared.T
            correlations[leg] = now @ sole_covariances[leg]
        return OdometryNoise(covariance, sole_covariances, correlations)
