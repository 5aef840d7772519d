"""Holds the height of the walk to the map: supporting soles show how far leg odometry has risen or sunk since.

Leg odometry's z is a random walk. A sole that stands on ground which the map knows measures its error against that
ground; a scalar Kalman filter subtracts the error that the soles agree on. Nothing is shifted silently: the correction
of each pause and the sum of all are in the map's metadata, and soles beyond the gate are not used but named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from guara_perception.terrain.map.fuse_heights import GATE_SIGMAS


@dataclass(frozen=True, slots=True)
class SoleError:
    """Height of a sole over the map's ground under it [m], and its variance without the error of odometry [m^2]."""

    residual: float
    variance: float


@dataclass(frozen=True, slots=True)
class HeightAnchor:
    """State of the filter.

    Attributes:
        offset: correction to be added to the z of leg odometry [m].
        variance: variance of the walk's height against the map [m^2].
        rise: variance that cells gain while they are not seen, summed since the start [m^2].
        odometry: variance of z that leg odometry gave last [m^2].
        rejected: legs whose soles stood too far off at this pause.
    """

    offset: float = 0.0
    variance: float = 0.0
    rise: float = 0.0
    odometry: float = 0.0
    rejected: tuple[str, ...] = ()

    def after(self, odometry_variance: float, soles: Mapping[str, SoleError]) -> HeightAnchor:
        """The state one pause later.

        Args:
            odometry_variance: variance of z that leg odometry has gathered since the start [m^2].
            soles: leg -> its error with this anchor's offset already in it.
        """
        growth = max(odometry_variance - self.odometry, 0.0)
        prior = variance = self.variance + growth
        correction = 0.0
        rejected = []
        for leg, sole in soles.items():
            innovation_variance = variance + sole.variance
            if (sole.residual + correction) ** 2 > GATE_SIGMAS**2 * innovation_variance:
                rejected.append(leg)
                continue
            gain = variance / innovation_variance if innovation_variance > 0 else 0.0
            correction -= gain * (sole.residual + correction)
            variance *= 1 - gain
        # Cells keep the share of the growth that the soles did not remove again.
        kept = variance / prior if prior > 0 else 1.0
        return HeightAnchor(
            offset=self.offset + correction,
            variance=variance,
            rise=self.rise + growth * kept,
            odometry=max(odometry_variance, self.odometry),
            rejected=tuple(rejected),
        )
