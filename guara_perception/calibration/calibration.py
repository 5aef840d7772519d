"""The calibration of one rangefinder: camera, its mount on the robot, one laser plane per stripe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.camera import CameraModel
from guara_perception.exceptions import CalibrationMismatch, InvalidInput
from guara_perception.readonly import readonly

VERDICTS = ("good", "usable", "refused", "unknown")


@dataclass(frozen=True, slots=True)
class StripePlane:
    """One laser plane.

    Attributes:
        index: number in the standard pattern (0 ... 69 for the Guara).
        mirror_angle: commanded mirror angle [rad], zero straight down, positive forward.
        plane: (4,) float64, n . X + d = 0 in the camera frame [m], n a unit vector.
    """

    index: int
    mirror_angle: float
    plane: Float

    def __post_init__(self) -> None:
        """Check and freeze; the normal is brought to exactly unit length."""
        plane = np.array(self.plane, dtype=np.float64)
        if plane.shape != (4,) or not np.isfinite(plane).all():
            raise InvalidInput(f"plane of stripe {self.index}: {plane.tolist()} must be 4 finite numbers")
        length = float(np.linalg.norm(plane[:3]))
        if abs(length - 1) > 1e-3:
            raise InvalidInput(f"plane of stripe {self.index}: the normal has length {length:.4f}, it must be 1")
        # Only where it matters: normalising again would change the last bit, and with it the content hash.
        object.__setattr__(self, "plane", readonly(plane / length if abs(length - 1) > 1e-9 else plane))


@dataclass(frozen=True, slots=True)
class Calibration:
    """All that a rangefinder needs to turn pixels into metres (docs/files.md).

    Attributes:
        robot: name of the robot it belongs to.
        camera: intrinsic model.
        transform_camera_to_base: (4, 4) float64, camera_optical_frame to base_link.
        stripes: laser planes, ascending by index.
        mirror: parameters of the mirror model over all stripes, or None.
        paper: the paper's constants (homography, H, nadir, n, d, k per stripe), or None.
        covariance: covariances of the parameters, or None.
        quality: verdict (`good`, `usable`, `refused`, `unknown`) and reasons.
        created: time of making, ISO 8601 text.
        hash: content hash, hexadecimal.
    """

    robot: str
    camera: CameraModel
    transform_camera_to_base: Float
    stripes: tuple[StripePlane, ...]
    mirror: Mapping[str, Any] | None = None
    paper: Mapping[str, Any] | None = None
    covariance: Mapping[str, Any] | None = None
    quality: Mapping[str, Any] = field(default_factory=lambda: {"verdict": "unknown", "reasons": []})
    created: str = ""
    hash: str = ""

    def __post_init__(self) -> None:
        """Check that the parts fit together, and freeze."""
        transform = readonly(np.array(self.transform_camera_to_base, dtype=np.float64))
        check_transform(transform, "transform_camera_to_base")
        stripes = tuple(sorted(self.stripes, key=lambda stripe: stripe.index))
        indices = [stripe.index for stripe in stripes]
        if len(indices) < 2:
            raise InvalidInput(f"calibration holds {len(indices)} stripes, it needs 2 or more")
        if len(set(indices)) != len(indices):
            twice = sorted({i for i in indices if indices.count(i) > 1})
            raise InvalidInput(f"calibration holds stripe index {twice} more than once, each index must be unique")
        if indices[0] < 0:
            raise InvalidInput(f"calibration holds stripe index {indices[0]}, indices start at 0")
        if self.quality.get("verdict") not in VERDICTS:
            raise InvalidInput(f"quality verdict is {self.quality.get('verdict')!r}, allowed: {', '.join(VERDICTS)}")
        object.__setattr__(self, "transform_camera_to_base", transform)
        object.__setattr__(self, "stripes", stripes)

    @property
    def indices(self) -> tuple[int, ...]:
        """Indices of the calibrated stripes, ascending."""
        return tuple(stripe.index for stripe in self.stripes)

    def stripe(self, index: int) -> StripePlane:
        """The stripe of this index.

        Raises:
            CalibrationMismatch: this index was not calibrated.
        """
        for stripe in self.stripes:
            if stripe.index == index:
                return stripe
        raise CalibrationMismatch(
            f"stripe index {index} is not in the calibration, which holds {format_indices(self.indices)}"
        )


def check_transform(transform: Float, name: str) -> None:
    """Refuse what is not a rigid 4x4 transform."""
    if transform.shape != (4, 4) or not np.isfinite(transform).all():
        raise InvalidInput(f"{name} has shape {transform.shape}, it must be 4x4 and finite")
    rotation = transform[:3, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0
    if not rigid or not np.allclose(transform[3], (0, 0, 0, 1)):
        raise InvalidInput(f"{name} is not a rigid transform: rotation orthonormal with det +1, last row 0 0 0 1")


def format_indices(indices: tuple[int, ...]) -> str:
    """Indices as text: `0 ... 69` or `0, 2 ... 68` or the list."""
    strides = set(np.diff(indices).tolist())
    if len(strides) == 1 and len(indices) > 2:
        first = str(indices[0]) if strides == {1} else f"{indices[0]}, {indices[1]}"
        return f"{first} ... {indices[-1]}"
    return ", ".join(map(str, indices))
