"""Input of a calibration: the images of a session and the known geometry of their targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import CHARUCO, BoardSpec
from guara_perception.calibration.charuco import marker_dictionary
from guara_perception.exceptions import CalibrationMismatch, InvalidInput
from guara_perception.scan import Scan
from kinematics import Stance
from kinematics.arrays import read_only

# Smallest and largest edge of a board's squares [m].
SQUARES = (0.001, 1.0)
# Largest difference of any joint between the stances of a plate scan and of the session [rad] (docs/files.md).
MAX_JOINT_DIFFERENCE = float(np.deg2rad(0.1))


@dataclass(frozen=True, slots=True)
class Fiducials:
    """Crosses at known positions on the floor.

    Attributes:
        image: name of the image that shows the crosses.
        points_in_footprint: (n, 2) centres of the crosses [m], four or more.
        points_px: (n, 2) pixels of the crosses in the same order; None = search for them.
    """

    image: str
    points_in_footprint: Float
    points_px: Float | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points_in_footprint, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 4:
            given = f"{len(points)} points" if points.shape[1:] == (2,) else f"shape {points.shape}"
            raise InvalidInput(f"fiducials.points_in_footprint: {given} given; 4 or more [x, y] are needed")
        object.__setattr__(self, "points_in_footprint", read_only(points))
        if self.points_px is not None:
            pixels = np.asarray(self.points_px, dtype=np.float64)
            if pixels.shape != points.shape:
                raise InvalidInput(
                    f"fiducials.points_px has shape {pixels.shape}, it must have one [u, v] for each of the "
                    f"{len(points)} points_in_footprint"
                )
            object.__setattr__(self, "points_px", read_only(pixels))


@dataclass(frozen=True, slots=True)
class Plate:
    """Scan of a flat plate.

    Attributes:
        name: name of the scan's folder.
        height: height of the plate's top above z = 0 [m].
        scan: the recorded scan.
    """

    name: str
    height: float
    scan: Scan


@dataclass(frozen=True, slots=True)
class CalibrationSession:
    """Input of one calibration (docs/files.md).

    Attributes:
        robot: name of the robot.
        board: the board.
        board_images: names of the images of the board; may be empty if the lens is known.
        ground_board_image: name of the image of the board on the floor, or None.
        fiducials: crosses on the floor.
        plates: scans of flat plates of known heights.
        stance: stance in which all images were taken.
        source: name of the session's file or folder, for messages.
        read_picture: function that returns the image, (h, w) or (h, w, 3), with a given name.
    """

    robot: str
    board: BoardSpec
    board_images: tuple[str, ...]
    ground_board_image: str | None
    fiducials: Fiducials
    plates: tuple[Plate, ...]
    stance: Stance
    source: str
    read_picture: Callable[[str], Image]

    def __post_init__(self) -> None:
        if min(self.board.columns, self.board.rows) < 3 or not SQUARES[0] <= self.board.square <= SQUARES[1]:
            raise InvalidInput(
                f"{self.source}: board has {self.board.columns}x{self.board.rows} inner corners and "
                f"squares of {self.board.square} m; allowed: 3 or more corners each way, squares of 0.001 ... 1 m"
            )
        if self.board.pattern == CHARUCO:
            marker_dictionary(self.board)
        for plate in self.plates:
            if plate.scan.robot != self.robot:
                raise InvalidInput(
                    f"{self.source}: plate {plate.name} was scanned by robot {plate.scan.robot!r}, but the session is "
                    f"from {self.robot!r}: all must come from one robot"
                )
            _check_stance(plate, self.stance, self.source)
        named = Counter(plate.name for plate in self.plates)
        if twice := sorted(name for name, count in named.items() if count > 1):
            raise InvalidInput(f"{self.source}: plates name the same scan twice: {', '.join(twice)}")
        if len(cameras := self._cameras()) > 1:
            raise CalibrationMismatch(
                f"{self.source}: plates were scanned with different cameras: {', '.join(cameras)}; use one"
            )

    @property
    def camera_identity(self) -> str:
        """Identity of the camera according to the plate scans; empty if unknown."""
        return next(iter(self._cameras()), "")

    def _cameras(self) -> list[str]:
        return sorted({plate.scan.camera_identity for plate in self.plates} - {""})


def _check_stance(plate: Plate, stance: Stance, source: str) -> None:
    expected = stance.joint_positions
    for given in (plate.scan.stance, plate.scan.stance_end):
        if given is None:
            continue
        if set(given.joint_positions) != set(expected):
            missing = sorted(set(expected) ^ set(given.joint_positions))
            raise InvalidInput(
                f"{source}: plate {plate.name} names other joints than the session: {', '.join(missing)}"
            )
        differences = {name: abs(given.joint_positions[name] - angle) for name, angle in expected.items()}
        joint, angle = max(differences.items(), key=lambda item: item[1])
        if angle > MAX_JOINT_DIFFERENCE:
            raise InvalidInput(
                f"{source}: plate {plate.name} was scanned with {joint} {np.rad2deg(angle):.2f} degrees away from the "
                f"session's stance (limit {np.rad2deg(MAX_JOINT_DIFFERENCE):.1f} degrees): scan the plate again"
            )


def check_size(picture: Image, size: tuple[int, int], name: str, source: str) -> None:
    """Reject an image whose size differs from that of the other images of the session or of the known camera.

    Raises:
        CalibrationMismatch: the sizes differ.
    """
    if (picture.shape[1], picture.shape[0]) != size:
        raise CalibrationMismatch(
            f"{source}: {name} has {picture.shape[1]}x{picture.shape[0]} px instead of {size[0]}x{size[1]} px: "
            "all pictures of a session must come from one camera with the same settings"
        )
