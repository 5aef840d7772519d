"""Detection, cleaning and averaging of laser lines on flat plates, one per stripe and plate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.calibration.calibration import CameraModel, floor_pixels, to_floor
from guara_perception.calibration.calibration_input import Plate, check_size
from guara_perception.calibration.mirror_model import MirrorModel
from guara_perception.calibration.row_bands import row_bands
from guara_perception.stripes.band import StripeProfile
from guara_perception.stripes.extract import extract_stripe
from kinematics.arrays import FrozenArrays
from kinematics.transforms import inverse

# Half width of the band searched for a stripe, as a fraction of the image height: errors of the laser mount of 3
# degrees and 20 mm move a stripe by this much.
BAND_SHARE = 0.12
# Number of groups of columns, each averaged into one point of a line.
BINS = 40
# Points farther than this many standard deviations from the straight line are omitted. They show dust, an edge or
# another surface.
OUTLIER_SIGMAS = 3.5
MIN_COLUMNS = 30
# MIN_SPAN: a line must be found in at least this share of its visible length on the plate. MIN_WIDTH: a line whose
# stripe is partly on the floor and that covers less than this share of its visible columns counts as beside the plate.
MIN_SPAN = 0.6
MIN_WIDTH = 0.25
# A column in which the stripe is closer than this to its position on the bare floor shows the floor, not the plate
# (fraction of the image height). A plate of 10 mm moves stripes three times as far. The BORDER_COLUMNS next to such
# columns may show both surfaces.
BESIDE_SHARE = 0.0015
BORDER_COLUMNS = 3
BESIDE = "beside the plate"
IN_PART = "visible on"
SIGMA_FLOOR_M = 2e-5


@dataclass(frozen=True, slots=True)
class PlateLine(FrozenArrays):
    """Line of one stripe on one plate.

    Attributes:
        index, mirror_angle: index and commanded mirror angle [rad] of the stripe.
        plate: number of the plate in the session.
        height: height of the plate [m].
        pixels: (n, 2) points on the line, each the mean of neighbouring columns.
        weights: (n,) number of columns averaged in each point.
        sigma_px: root mean square of the predicted sigmas of the columns.
    """

    index: int
    mirror_angle: float
    plate: int
    height: float
    pixels: Float
    weights: Float
    sigma_px: float


@dataclass(frozen=True, slots=True)
class LostLine:
    """Stripe of a plate scan without a usable line, and the reason."""

    index: int
    plate: int
    reason: str

    @property
    def is_beside(self) -> bool:
        """True for a stripe on the floor beside the plate, which is not a fault."""
        return self.reason == BESIDE


def plate_lines(
    plate: Plate,
    number: int,
    camera: CameraModel,
    transform_camera_to_footprint: Float,
    nominal: MirrorModel,
    on_floor: Mapping[int, PlateLine],
    on_stripe: Callable[[], None],
) -> tuple[list[PlateLine], list[LostLine]]:
    """Find the line of every stripe of a plate scan, without the parts beside the plate.

    Args:
        plate: the scan and the height of the plate.
        number: number of the plate in the session.
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4) pose of the camera.
        nominal: nominal mirror in base_footprint, which roughly predicts the stripes.
        on_floor: stripe index -> line on the bare floor; where the stripe has the same position, it is beside the
            plate. Empty for the scan of the bare floor itself, or if there is no such scan.
        on_stripe: called after each stripe, for a progress bar.

    Returns:
        Lines that were found, and stripes without a usable line.

    Raises:
        CalibrationMismatch: the size of a frame differs from that of the camera.
        MissingFile, FileFormatError: a frame cannot be read.
    """
    mirror = nominal.in_frame(inverse(transform_camera_to_footprint))
    planes = mirror.planes([stripe.mirror_angle for stripe in plate.scan.stripes])
    width, height = camera.size
    bands = row_bands(camera, transform_camera_to_footprint, planes, np.array([plate.height]), int(BAND_SHARE * height))
    lines, lost = [], []
    for (stripe, on, off), band in zip(plate.scan.frames(), bands, strict=True):
        check_size(on, camera.size, f"frame {stripe.on}", plate.scan.source)
        profile = extract_stripe(on, off, band=band if band[1] else None)
        if not _is_good(profile, band, height):
            profile = extract_stripe(on, off)
        reason = profile.reason
        if not reason:
            beside = _beside(profile, on_floor.get(stripe.index), BESIDE_SHARE * height)
            line = _line(profile, beside, camera, transform_camera_to_footprint, plate.height)
            if isinstance(line, str):
                reason = line
            else:
                lines.append(PlateLine(stripe.index, stripe.mirror_angle, number, plate.height, *line))
        if reason:
            lost.append(LostLine(stripe.index, number, reason))
        on_stripe()
    return lines, _with_borders(lost, [stripe.index for stripe in plate.scan.stripes])


def _with_borders(lost: list[LostLine], order: list[int]) -> list[LostLine]:
    """Mark partly visible lines as beside the plate if a neighbouring stripe is beside it."""
    beside = {line.index for line in lost if line.is_beside}
    at_border = {neighbour for pair in pairwise(order) for neighbour in pair if beside & {*pair}}
    is_border = [line.reason.startswith(IN_PART) and line.index in at_border for line in lost]
    return [replace(line, reason=BESIDE) if border else line for line, border in zip(lost, is_border, strict=True)]


def _is_good(profile: StripeProfile, band: tuple[int, int], height: int) -> bool:
    """Test whether the stripe was found in at least half of the columns and well inside the band."""
    found = np.isfinite(profile.position_px)
    if profile.is_frame_bad or found.mean() < 0.5 or not band[1]:
        return False
    median = float(np.median(profile.position_px[found]))
    margin = 0.1 * (band[1] - band[0])
    return (band[0] == 0 or median > band[0] + margin) and (band[1] == height or median < band[1] - margin)


def _beside(profile: StripeProfile, floor: PlateLine | None, tolerance: float) -> Mask:
    """Mask of the columns in which a stripe is at its position on the bare floor."""
    rows = profile.position_px
    if floor is None:
        return np.zeros(len(rows), dtype=bool)
    return np.asarray(np.abs(rows - np.interp(np.arange(len(rows)), *floor.pixels.T)) <= tolerance)


def _line(
    profile: StripeProfile, beside: Mask, camera: CameraModel, transform: Float, height: float
) -> tuple[Float, Float, float] | str:
    """Averaged points [px], weights and sigma [px] of the straight line on a level plane, or a reason to reject it."""
    border = np.convolve(beside, np.ones(2 * BORDER_COLUMNS + 1), mode="same") > 0
    columns = np.flatnonzero(np.isfinite(profile.position_px) & ~border)
    if columns.size < MIN_COLUMNS and beside.sum() > columns.size:
        return BESIDE
    if columns.size < MIN_COLUMNS:
        return f"found in {columns.size} columns; {MIN_COLUMNS} or more are needed"
    pixels = np.column_stack((columns, profile.position_px[columns])).astype(np.float64)
    points = to_floor(camera, transform, pixels, height)
    kept = np.ones(columns.size, dtype=bool)
    for _ in range(8):
        coefficients = np.polyfit(points[kept, 1], points[kept, 0], 1)
        residual = points[:, 0] - np.polyval(coefficients, points[:, 1])
        robust_sigma = max(1.4826 * float(np.median(np.abs(residual[kept]))), SIGMA_FLOOR_M)
        narrower = np.abs(residual) < OUTLIER_SIGMAS * robust_sigma
        if narrower.sum() < MIN_COLUMNS or (narrower == kept).all():
            break
        kept = narrower
    visible = _visible_columns(camera, transform, height, coefficients)
    if beside.any() and kept.sum() < MIN_WIDTH * visible:
        return BESIDE
    span = kept.sum() / max(visible - int(beside.sum()), 1)
    if span < MIN_SPAN:
        return f"{IN_PART} {100 * span:.0f} % of its length; {100 * MIN_SPAN:.0f} % or more is needed"
    group = np.minimum(columns[kept] * BINS // camera.size[0], BINS - 1)
    count = np.bincount(group, minlength=BINS).astype(np.float64)
    used = count > 0
    y = np.bincount(group, points[kept, 1], BINS)[used] / count[used]
    off = np.bincount(group, residual[kept], BINS)[used] / count[used]
    points = np.column_stack((np.polyval(coefficients, y) + off, y))
    sigma = float(np.sqrt(np.mean(profile.sigma_px[columns[kept]] ** 2)))
    return floor_pixels(camera, transform, points, height), count[used], sigma


def _visible_columns(camera: CameraModel, transform: Float, height: float, coefficients: Float) -> int:
    """Number of columns in which the straight line x = polyval(coefficients, y) is inside the image."""
    y = np.linspace(-1.0, 1.0, 201) + transform[1, 3]
    pixels = floor_pixels(camera, transform, np.column_stack((np.polyval(coefficients, y), y)), height)
    pixels = pixels[np.isfinite(pixels[:, 0])]
    pixels = pixels[np.argsort(pixels[:, 0])]
    rows = np.interp(np.arange(camera.size[0]), pixels[:, 0], pixels[:, 1], left=np.nan, right=np.nan)
    return int(((rows > 0) & (rows < camera.size[1] - 1)).sum())
