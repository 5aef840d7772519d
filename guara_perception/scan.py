"""Recorded scan: stripes, stance, and frames that are read one by one."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

from guara_perception.arrays import Float, Image
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import MODES
from guara_perception.stripes.band import FramePair
from kinematics import BodyTrack, RobotModel, Stance


@dataclass(frozen=True, slots=True)
class ScanStripe:
    """Stripe of a recorded scan.

    Attributes:
        index: index in the standard pattern, to which the calibration assigns a laser plane.
        mirror_angle: commanded mirror angle [rad].
        on: name of the frame with the laser on.
        off: name of the frame with the laser off, which several stripes may share; None without one.
        stamp: time of the laser-on frame [ns since the Unix epoch]; None if unknown.
        dark: name of the frame of the dark flash (with the laser off) after the stripe; None without one.
        instant: time of the laser-on frame on the clock of the scan's track [s]; NaN if unknown.
        instant_sigma: standard deviation of `instant` [s].
    """

    index: int
    mirror_angle: float
    on: str
    off: str | None
    stamp: int | None = None
    dark: str | None = None
    instant: float = math.nan
    instant_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Scan:
    """Recorded scan (docs/files.md).

    Attributes:
        robot: name of the robot.
        mode: "coarse" or "standard".
        stamp: beginning of the scan [ns since the Unix epoch].
        step: number of the stance pause.
        stripes: stripes in the order of recording.
        stance: stance at the beginning of the scan.
        stance_end: stance at the end of the scan; None if it was not recorded.
        calibration_hash: hash of the calibration that was in use; None if unknown.
        source: file or folder from which the scan was read, for messages.
        read_frame: function that returns the image, (h, w) or (h, w, 3), of the frame with a given name.
        withdrawn: recorded reason why the node withdrew the grid of this scan; empty if the grid was not withdrawn.
        dark_after: indices of the stripes after which the sweep had a dark flash; empty without dark flashes.
        camera_identity: maker, model and serial number reported by the camera; empty if unknown.
        read_track: function that computes the body's motion during the scan from the joint stream, given the robot
            model and the calibrated transform_camera_to_base; None if no flash times were recorded.
        epoch: recorded identity of the walk; empty if unknown.
    """

    robot: str
    mode: str
    stamp: int
    step: int
    stripes: tuple[ScanStripe, ...]
    stance: Stance
    stance_end: Stance | None
    calibration_hash: str | None
    source: str
    read_frame: Callable[[str], Image]
    withdrawn: str = ""
    dark_after: tuple[int, ...] = ()
    camera_identity: str = ""
    read_track: Callable[[RobotModel, Float], BodyTrack] | None = None
    epoch: str = ""

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InvalidInput(f"{self.source}: mode is {self.mode!r}, allowed: {', '.join(MODES)}")
        if not self.stripes:
            raise InvalidInput(f"{self.source}: the scan has no stripe")
        index, count = Counter(stripe.index for stripe in self.stripes).most_common(1)[0]
        if count > 1:
            raise InvalidInput(f"{self.source}: stripe index {index} is listed {count} times; each may be listed once")

    def refuse_withdrawn(self) -> None:
        """Refuse a scan whose grid was withdrawn by the node.

        Raises:
            InvalidInput: the grid was withdrawn; the message gives the reason.
        """
        if self.withdrawn:
            raise InvalidInput(
                f"{self.source}: its grid was withdrawn on the robot ({self.withdrawn}); the scan is not processed"
            )

    @property
    def end(self) -> int:
        """Latest of `stamp` and the stamps of the stripes [ns since the Unix epoch]."""
        return max(self.stamp, *(stripe.stamp or 0 for stripe in self.stripes))

    def frames(self) -> Iterator[tuple[ScanStripe, Image, Image | None]]:
        """Iterate over (stripe, laser-on image, laser-off image or None).

        A laser-off frame that successive stripes share is read only once.

        Raises:
            MissingFile, FileFormatError: a frame cannot be read; the message names it.
        """
        read = frame_reader(self)
        for stripe in self.stripes:
            pair = read(stripe)
            yield stripe, pair.on, pair.off


def frame_reader(scan: Scan) -> Callable[[ScanStripe], FramePair]:
    """Return a function that reads the images of a stripe.

    A laser-off frame that successive stripes share is read only once. The function raises MissingFile or
    FileFormatError, with the name of the frame, if a frame cannot be read.
    """
    read_off = lru_cache(maxsize=1)(scan.read_frame)

    def read(stripe: ScanStripe) -> FramePair:
        off = None if stripe.off is None else read_off(stripe.off)
        dark = None if stripe.dark is None else scan.read_frame(stripe.dark)
        return FramePair(stripe.index, scan.read_frame(stripe.on), off, dark, stripe.instant, stripe.instant_sigma)

    return read
