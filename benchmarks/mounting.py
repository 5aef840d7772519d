"""What a mount that moves after calibration costs: heights of one scan, worked out with a calibration slightly wrong.

`python -m benchmarks.mounting`. Calibration measures the mount as it was built, so a constant error costs nothing; what
counts is what changes afterwards: a screw that gives, a home switch that shifts, a mirror that has not settled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import guara_perception as gp
from tests import scenes

SCAN = Path(__file__).resolve().parents[1] / "tests" / "data" / "scans" / "paper"
# The mirror's axis in base_link [m], parallel to y.
AXIS = np.array([0.600, 0.0, 0.110])
STEP = 490874e-9


@dataclass(frozen=True, slots=True)
class Change:
    """A change of the mount: of every laser plane, and of the camera.

    Attributes:
        name: in words.
        sheet: turn of the laser planes about the mirror's axis [rad].
        tilt: turn of the planes about x [rad].
        shift: of the planes in base_link [m].
        pitch: turn of camera and laser planes together about y [rad].
        camera_shift: of the camera alone, upwards [m].
    """

    name: str
    sheet: float = 0.0
    tilt: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch: float = 0.0
    camera_shift: float = 0.0


CHANGES = (
    Change("home switch off by one step", sheet=2 * STEP),
    Change("mirror not settled by a tenth of a stripe", sheet=2 * 0.00068),
    Change("mirror axis tilted by 0.1 degrees", tilt=np.radians(0.1)),
    Change("laser and mirror 0.2 mm forward", shift=(0.0002, 0.0, 0.0)),
    Change("laser and mirror 0.2 mm up", shift=(0.0, 0.0, 0.0002)),
    Change("camera 0.2 mm up, laser not", camera_shift=0.0002),
    Change("whole head pitched by 0.1 degrees", pitch=np.radians(0.1)),
)


def _turn(axis: int, angle: float) -> np.ndarray:
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
    return turn


def _moved(turn: np.ndarray, about: np.ndarray, shift: np.ndarray) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = turn
    transform[:3, 3] = about - turn @ about + shift
    return transform


def changed(calibration: gp.Calibration, change: Change) -> gp.Calibration:
    """Return the calibration of a mount that has changed so; its planes and its camera, as they would be now."""
    camera = calibration.transform_camera_to_base
    lift = np.eye(4)
    lift[2, 3] = change.camera_shift
    head = _moved(_turn(1, change.pitch), camera[:3, 3], np.zeros(3))
    laser = _moved(_turn(0, change.tilt) @ _turn(1, -change.sheet), AXIS, np.array(change.shift))
    # A plane in the camera's frame transforms by the inverse transpose; the laser moves against the camera.
    moved_camera = lift @ camera
    points = np.linalg.inv(moved_camera) @ laser @ camera
    stripes = tuple(
        replace(stripe, plane=_plane(stripe.plane @ np.linalg.inv(points))) for stripe in calibration.stripes
    )
    return replace(calibration, transform_camera_to_base=head @ moved_camera, stripes=stripes)


def _plane(plane: np.ndarray) -> np.ndarray:
    result = plane / np.linalg.norm(plane[:3])
    result.setflags(write=False)
    return result


def heights(recording: scenes.Recording, calibration: gp.Calibration) -> np.ndarray:
    """The elevation that the frames of a recording give with a calibration [m]."""
    processor = replace(recording, calibration=calibration).processor()
    processor.add_all([gp.FramePair(*frames) for frames in recording.frames])
    return processor.finish().elevation


def measure(recording: scenes.Recording) -> list[tuple[str, float, float]]:
    """Rows: the change, by how much heights are wrong on average, and their scatter (1.48 x median deviation) [m]."""
    right = heights(recording, recording.calibration)
    rows = []
    for change in CHANGES:
        error = heights(recording, changed(recording.calibration, change)) - right
        known = error[np.isfinite(error)]
        middle = float(np.median(known))
        rows.append((change.name, middle, 1.4826 * float(np.median(np.abs(known - middle)))))
    return rows


def main() -> None:
    """Print the table."""
    print(f"{'change after calibration':45s} {'heights off by':>15s} {'scatter':>10s}")
    for name, offset, scatter in measure(scenes.recorded(SCAN)):
        print(f"{name:45s} {1e3 * offset:+12.2f} mm {1e3 * scatter:7.2f} mm")


if __name__ == "__main__":
    main()
