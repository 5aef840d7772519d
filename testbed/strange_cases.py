"""Cases of foreign light and of frames from another instant, and their effect on a scan's grid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from drivers import AcquireOptions, OffFrames
from guara_perception.app.node.published_scans import with_problems
from guara_perception.arrays import Float32
from guara_perception.terrain.layers.record import Health
from testbed.grid_truth import figures, made_up
from testbed.scenes import ScanInMemory
from testbed.strange_light import Fault, Scene, beside, blob, ghost, take


@dataclass(frozen=True, slots=True)
class Case:
    """Scan with a fault.

    Attributes:
        group: group of the fault in tables.
        fault: the fault.
        triggered: True = the board triggers the camera.
        options: options of the acquisition; None = as in the node.
    """

    group: str
    fault: Fault
    triggered: bool = True
    options: AcquireOptions | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """Figures of one case.

    Attributes:
        free: number of free cells.
        unsafe: number of free cells that are dark or unseen in truth.
        wrong: number of free cells whose heights are off by more than 5 mm.
        known: share of the interior cells that are known [%].
        seconds: duration of the sweep [s].
        health: level and reasons of the health, shortened.
    """

    free: int
    unsafe: int
    wrong: int
    known: float
    seconds: float
    health: str


def cases(scene: Scene) -> Iterator[Case]:
    """Yield all cases, beginning with those without a fault."""
    nothing = Fault("clean")
    yield Case("clean", nothing)
    yield Case("clean", nothing, triggered=False)
    per_stripe = AcquireOptions(off=OffFrames.PER_STRIPE, together=16)
    yield Case("clean, off per stripe", nothing, triggered=False, options=per_stripe)
    for triggered in (True, False):
        for pitches, gain in ((-1, 1.6), (-0.5, 1.6), (0.5, 0.6), (0.5, 1.6), (1, 1.6), (3, 0.6), (3, 1.6)):
            fault = Fault(f"{pitches:+g} stripes aside, {gain:g} as bright", extra=beside(pitches, gain))
            yield Case("foreign sweep", fault, triggered)
        for pitches in (-0.5, 1, 3):
            yield Case(
                "own laser dead", Fault(f"foreign {pitches:+g}", gain=0.0, extra=beside(pitches, 1.0)), triggered
            )
        for pitches in (-1, 0.5, 2):
            yield Case(
                "own laser weak", Fault(f"foreign {pitches:+g}", gain=0.25, extra=beside(pitches, 1.0)), triggered
            )
    count = len(scene.order)
    # All first frames are within the scan; otherwise, the foreign line would be in no frame.
    for first in (0, count // 5, 2 * count // 5, 4 * count // 5):
        yield Case("for 8 frames", Fault(f"from {first}", extra=beside(0.5, 1.6, range(first, first + 8))))
    yield from short_lines(count)
    for pitches in (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75):
        for gain in (0.4, 0.8, 1.3):
            yield Case("ghost", Fault(f"{pitches:+g}, {gain:g} as bright", extra=ghost(pitches, gain)))
    for name, mask in spots(scene):
        yield Case("static light", Fault(name, extra=blob(scene, mask)))
    yield Case("ambient", Fault("flicker of 3 %", ambient=lambda at: 1 + 0.03 * np.sin(2.1 * at.shot)))
    yield Case("ambient", Fault("sun comes at frame 30", ambient=lambda at: 1.0 if at.shot < 30 else 1.15))
    yield Case("frames", Fault("each holds the pixels before", late=1))
    yield Case("frames", Fault("the same from frame 20 on", late=1, first=20))
    for first in (count // 4, 2 * count // 3):
        for gaps in (-3, -2, -1, 1, 2):
            yield Case("clock jumps", Fault(f"by {gaps:+d} gaps at {first}", gaps=gaps, first=first))
    yield Case("frames", Fault("one stripe late", late=1), triggered=False)
    yield Case("frames", Fault("one stripe late, off per stripe", late=2), triggered=False, options=per_stripe)
    yield Case("frames", Fault("one stripe late from frame 20 on", late=1, first=20), triggered=False)


def short_lines(count: int) -> Iterator[Case]:
    """Yield cases with a foreign line in a few frames, most of which contain no dark flash; the own laser is on."""
    for pitches in (-6, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 4, 6):
        for gain, frames, first in ((0.8, 6, count // 3), (1.6, 6, count // 3), (1.6, 3, count // 2), (3.0, 10, 3)):
            name = f"{pitches:+g} stripes aside, {gain:g} as bright, {frames} frames from {first}"
            yield Case("short line", Fault(name, extra=beside(pitches, gain, range(first, first + frames))))


def spots(scene: Scene) -> Iterator[tuple[str, Float32]]:
    """Yield names and masks (h, w): a spot of 400 px on absorbing ground, and a line over ground that is not seen."""
    truth = scene.scan.truth
    assert truth is not None
    for name, cells in (("spot of 400 px on dark ground", truth.dark), ("trace over unseen ground", truth.unseen)):
        count, labels, stats, _ = cv2.connectedComponentsWithStats(cells.astype(np.uint8))
        if count < 2:
            continue
        largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        iy, ix = np.nonzero(labels == largest)
        u, v = _pixel(scene.scan, float(ix.mean()), float(iy.mean()))
        mask = np.zeros(scene.dark.shape[:2], np.float32)
        if name.startswith("spot"):
            cv2.ellipse(mask, (round(u), round(v)), (18, 7), 0, 0, 360, 1.0, -1)
        else:
            cv2.line(mask, (round(u) - 60, round(v)), (round(u) + 60, round(v)), 1.0, 3)
        yield name, np.asarray(cv2.GaussianBlur(mask, (0, 0), 1.2), np.float32)


def _pixel(scan: ScanInMemory, ix: float, iy: float) -> tuple[float, float]:
    processor = scan.processor()
    grid = processor.grid
    point = np.array(
        [grid.origin[0] + (ix + 0.5) * grid.resolution, grid.origin[1] + (iy + 0.5) * grid.resolution, 0, 1]
    )
    in_camera = np.linalg.inv(processor.transform_camera_to_footprint) @ point
    camera = scan.calibration.camera
    found, _ = cv2.projectPoints(in_camera[None, :3], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    return float(found[0, 0, 0]), float(found[0, 0, 1])


def measure(scene: Scene, case: Case) -> Outcome:
    """Acquire the scan with its fault, and compare the grid with the truth."""
    processor, taken = take(scene, case.fault, triggered=case.triggered, options=case.options)
    terrain = with_problems(processor.finish(), taken)
    truth = scene.scan.truth
    assert truth is not None
    health = terrain.record.health or Health()
    free = np.asarray(terrain.traversability) > 0
    return Outcome(
        int(free.sum()),
        int((free & (truth.unseen | truth.dark)).sum()),
        made_up(terrain, truth),
        figures(terrain, truth).known,
        (taken.end - taken.start) * 1e-9,
        f"{health.level}: {'; '.join(health.reasons)[:90]}",
    )
