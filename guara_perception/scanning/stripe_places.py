"""Poses of camera and body at the flash of each stripe, for a body that sways."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np

from guara_perception.arrays import Float
from guara_perception.ranging.scan_geometry import StripePlace
from guara_perception.ranging.surface import Key
from guara_perception.stripes.band import FramePair
from kinematics import BodyTrack, SelfFilter, StancePose
from kinematics.body_track import HALF_WINDOW, LONGEST_GAP
from kinematics.transforms import inverse, transform_points

NO_PLACE = (
    "the body's pose at the flash is unknown: joint samples are missing or irregular, feet moved or lifted, or the "
    "time of the flash is unknown or uncertain"
)
# Largest displacement of the scanned ground relative to the camera, in any direction, between the flashes of two
# neighbouring stripes that are joined. It is about the smallest spacing of stripes, so that joined stripes keep their
# order.
MOST_BETWEEN_M = 0.006
# Largest standard deviation, due to the body's poses, of the height difference between two stripes that are joined.
MOST_SIGMA_M = 0.0015


class StripePlaces:
    """Poses of camera and body at the stripes' flashes, found as samples of the track arrive.

    Attributes:
        flashes: instants of the flashes on the clock of the track, and their standard deviations [s], by stripe index.
        places: poses known so far, by stripe index.
        left: reason why the track is ignored; empty if it is used.
    """

    def __init__(self, track: BodyTrack, pose: StancePose, transform_camera_to_base: Float) -> None:
        """Start without stripes.

        Args:
            track: poses of the body relative to the stance of `pose`.
            pose: pose of the body at that stance.
            transform_camera_to_base: (4, 4) calibrated pose of the camera.
        """
        self._track, self._pose = track, pose
        self._camera_to_base = transform_camera_to_base
        self.flashes: dict[int, tuple[float, float]] = {}
        self.places: dict[int, StripePlace] = {}
        self.left = ""
        # Stripes without a pose although the samples cover them. Later samples cannot change that.
        self._lost: set[int] = set()

    def expect(self, pairs: Collection[FramePair]) -> None:
        """Add the instants of stripes; stripes without a known instant are ignored."""
        self.flashes.update({p.index: (p.instant, p.instant_sigma) for p in pairs if math.isfinite(p.instant)})

    @property
    def missing(self) -> str:
        """Description of a gap in the joint stream around the flashes, or of a stream that starts late or ends early.

        Empty if the stream covers all flashes, or if no flash is known.
        """
        if not self.flashes:
            return ""
        instants = [instant for instant, _ in self.flashes.values()]
        gap = self._track.longest_gap(min(instants), max(instants))
        if gap <= LONGEST_GAP:
            return ""
        what = f"has a gap of {gap:.2f} s" if math.isfinite(gap) else "begins or ends"
        return f"the joint stream {what} during the scan and is ignored: check the gait"

    def update(self) -> int:
        """Compute the poses of the stripes that the samples now cover.

        A pose is computed only when all samples that affect it have arrived, so that a recorded scan yields the same
        poses.

        Returns:
            Number of stripes whose pose is known or cannot be determined.
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
        """Latest pose that later samples cannot change; None if it cannot be determined."""
        return self._at(self._track.latest - HALF_WINDOW)

    def _at(self, instant: float, sigma: float = 0.0) -> StripePlace | None:
        place = self._track.at(instant, sigma)
        if place is None:
            return None
        to_footprint = self._pose.transform_base_to_footprint @ place.transform_base_to_begin
        # The covariance is given in the axes of base_link, and is rotated to those of base_footprint.
        turn = np.kron(np.eye(2), self._pose.transform_base_to_footprint[:3, :3])
        body = SelfFilter(place.state, transform_base_to_frame=to_footprint)
        return StripePlace(to_footprint @ self._camera_to_base, body, turn @ place.covariance @ turn.T)


def parted_pairs(places: Mapping[int, StripePlace], stride: int, ground: Float) -> frozenset[Key]:
    """Pairs of neighbouring stripes that must not be joined: the body moved too far, or its pose is too uncertain.

    Args:
        places: poses by index.
        stride: index difference of neighbours in the pattern.
        ground: (n, 3) corners of the scanned area in base_footprint.
    """
    return frozenset(
        (index, index + stride)
        for index, place in places.items()
        if (other := places.get(index + stride)) is not None and not _agree(place, other, ground)
    )


def _agree(one: StripePlace, other: StripePlace, ground: Float) -> bool:
    # Displacement of the ground if the first stripe were computed with the camera pose of the second.
    change = other.transform_camera_to_footprint @ inverse(one.transform_camera_to_footprint)
    moved = np.linalg.norm(transform_points(change, ground) - ground, axis=1).max()
    variance = one.height_variance(ground.T) + other.height_variance(ground.T)
    return bool(moved <= MOST_BETWEEN_M and variance.max() <= MOST_SIGMA_M**2)
