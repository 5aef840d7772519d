"""Places of camera and body at the flashes of a scan's stripes, for a body that sways."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from guara_perception.arrays import Float
from guara_perception.ranging.scan_geometry import StripePlace
from guara_perception.ranging.surface import Key
from guara_perception.stripes.band import FramePair
from kinematics import BodyTrack, SelfFilter, StancePose
from kinematics.body_track import HALF_WINDOW, LONGEST_GAP
from kinematics.transforms import inverse, transform_points

NO_PLACE = "where the body was at its flash is not known: samples are missing, feet moved, or it has no instant"
# Two neighbouring stripes are joined only if the body moved the ground between their flashes by less than this, along
# the ground or up: half the distance of two coarse stripes, so that none lies where another should.
MOST_BETWEEN_M = 0.006
# ... and if the heights of the one and the other agree with this standard deviation at the most.
MOST_SIGMA_M = 0.0015


class StripePlaces:
    """Places of the stripes by index, found as the samples come.

    Attributes:
        flashes: instants of the flashes by the clock of the track, and their standard deviations [s].
        places: those known so far.
        left: reason why the track is not followed; empty if it is.
    """

    def __init__(self, track: BodyTrack, pose: StancePose, transform_camera_to_base: Float) -> None:
        """Start without stripes.

        Args:
            track: where the body is, relative to the stance of `pose`.
            pose: pose of the body at that stance.
            transform_camera_to_base: (4, 4) calibrated placement of the camera.
        """
        self._track, self._pose = track, pose
        self._camera_to_base = transform_camera_to_base
        self.flashes: dict[int, tuple[float, float]] = {}
        self.places: dict[int, StripePlace] = {}
        self.left = ""
        # Covered by the samples, and yet without a place: more of them do not help.
        self._lost: set[int] = set()

    def expect(self, pairs: Collection[FramePair]) -> None:
        """Take the instants of stripes; one that is not known is left out."""
        self.flashes.update({p.index: (p.instant, p.instant_sigma) for p in pairs if math.isfinite(p.instant)})

    @property
    def missing(self) -> str:
        """Gap or end of the stream of joints at these flashes; empty if it covers them."""
        if not self.flashes:
            return ""
        instants = [instant for instant, _ in self.flashes.values()]
        gap = self._track.longest_gap(min(instants), max(instants))
        if gap <= LONGEST_GAP:
            return ""
        what = f"has a gap of {gap:.2f} s" if math.isfinite(gap) else "begins or ends"
        return f"the stream of joints {what} within the scan, which counts as one without a stream: check the gait"

    def update(self) -> int:
        """Place the stripes that the samples cover by now; return how many are placed or lost.

        No place is found before its last sample has come, so that a recorded scan has the same.
        """
        for index, (instant, sigma) in self.flashes.items():
            if index in self.places or index in self._lost or not self._track.covers(instant):
                continue
            place = self._at(instant, sigma)
            if place is None:
                self._lost.add(index)
            else:
                self.places[index] = place
        return len(self.places) + len(self._lost)

    def now(self) -> StripePlace | None:
        """Latest place that the samples tell; None without one."""
        return self._at(self._track.latest - HALF_WINDOW)

    def _at(self, instant: float, sigma: float = 0.0) -> StripePlace | None:
        place = self._track.at(instant, sigma)
        if place is None:
            return None
        to_footprint = self._pose.transform_base_to_footprint @ place.transform_base_to_begin
        # The covariance is along the axes of base_link.
        turn = np.kron(np.eye(2), self._pose.transform_base_to_footprint[:3, :3])
        body = SelfFilter(place.state, transform_base_to_frame=to_footprint)
        return StripePlace(to_footprint @ self._camera_to_base, body, turn @ place.covariance @ turn.T)


def parted_pairs(places: Mapping[int, StripePlace], stride: int, ends: Sequence[tuple[float, float]]) -> frozenset[Key]:
    """Neighbouring stripes between whose flashes the body moved too far, or not known how far.

    Args:
        places: places by index.
        stride: distance of neighbours in the pattern.
        ends: corners of the scanned area (x, y) in base_footprint [m].
    """
    ground = np.array([(x, y, 0.0) for x, y in ends])
    return frozenset(
        (index, index + stride)
        for index, place in places.items()
        if (other := places.get(index + stride)) is not None and not _agree(place, other, ground)
    )


def _agree(one: StripePlace, other: StripePlace, ground: Float) -> bool:
    # Where the second stripe's camera would see the ground if it had stayed at the first one's place.
    change = other.transform_camera_to_footprint @ inverse(one.transform_camera_to_footprint)
    moved = np.linalg.norm(transform_points(change, ground) - ground, axis=1).max()
    variance = one.height_variance(ground.T) + other.height_variance(ground.T)
    return bool(moved <= MOST_BETWEEN_M and variance.max() <= MOST_SIGMA_M**2)
