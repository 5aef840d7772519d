"""Detection of faults in plate scans: missed steps, swapped or small plates, a wrong mirror, a mount that slipped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import format_indices
from guara_perception.calibration.calibration_input import Plate
from guara_perception.calibration.laser import LeaveOneOut
from guara_perception.calibration.mirror_model import PARAMETERS
from guara_perception.calibration.plates import LostLine, PlateLine
from guara_perception.calibration.sweep import Sweep
from guara_perception.exceptions import CalibrationRefused

# Least height difference between two plates that together determine a laser plane.
MIN_HEIGHT_DIFFERENCE_M = 0.010
# Largest error of the laser plane's rotation from one stripe to the next, relative to the median error nearby [rad].
# The periodic error of a stepper causes 0.01 to 0.02 degrees; a shift by one stripe of Guara's standard pattern causes
# 0.7 degrees.
MISSED_STEP = float(np.deg2rad(0.10))
# Least share of the stripes on a plate that must be found, and least share of all stripes that must be found on plates
# of two heights.
MIN_LINES = 0.8
# Absolute height below which a plate counts as the floor itself.
BARE_FLOOR_M = 0.001
# Largest number of stripes between the floor beside a plate and the top of the plate: they fall on its front or across
# its edge.
BORDER_STRIPES = 6
# One of four or more plates is named as wrong if the remaining plates agree this many times better than after leaving
# out any other plate.
CLEARLY = 2.0
# Largest deviation of the laser from its nominal mount, in multiples of the prior standard deviations in PARAMETERS.
MAX_DEVIATION = 2.5


@dataclass(frozen=True, slots=True)
class Jump:
    """A jump of the laser plane's angle within one plate scan.

    Attributes:
        plate: number of the plate.
        after: index of the last stripe before the jump.
        angle: additional rotation of the laser plane at all later stripes [rad].
    """

    plate: int
    after: int
    angle: float


def check_heights(plates: Sequence[Plate]) -> None:
    """Refuse a session that does not have plates at two or more heights.

    Raises:
        CalibrationRefused: no two successive heights are MIN_HEIGHT_DIFFERENCE_M or more apart.
    """
    heights = sorted(plate.height for plate in plates)
    if not any(b - a >= MIN_HEIGHT_DIFFERENCE_M for a, b in pairwise(heights)):
        listed = ", ".join(f"{1e3 * h:.0f} mm" for h in heights) or "none"
        raise CalibrationRefused(
            f"plates at two or more heights, two successive ones {1e3 * MIN_HEIGHT_DIFFERENCE_M:.0f} mm or more apart, "
            f"are needed to find the laser planes; heights in the session: {listed}"
        )


def find_jumps(lines: Sequence[PlateLine], points: Sequence[Float], axis: Float) -> list[Jump]:
    """Find jumps of the laser plane relative to the commanded mirror angle.

    The plane's angle about the mirror axis minus twice the mirror angle is a smooth function of the stripe index, even
    if the axis is known only to within centimetres. A missed step is a jump of this function.

    Args:
        lines: lines of all plates.
        points: (n, 3) points of each line in base_footprint.
        axis: (3,) point on the nominal mirror axis, which is parallel to y.
    """
    jumps = []
    for plate in sorted({line.plate for line in lines}):
        of_plate = sorted((line.index, i) for i, line in enumerate(lines) if line.plate == plate)
        angle = np.array([_plane_angle(points[i], axis) - 2 * lines[i].mirror_angle for _, i in of_plate])
        growth = np.diff(angle)
        usual = np.array([np.median(growth[max(k - 4, 0) : k + 5]) for k in range(len(growth))])
        for k in np.flatnonzero(np.abs(growth - usual) > MISSED_STEP):
            jumps.append(Jump(plate, of_plate[k][0], float(growth[k] - usual[k])))
    return jumps


def is_bare_floor(plate: Plate) -> bool:
    """Test whether a plate scan shows the floor without a plate."""
    return abs(plate.height) < BARE_FLOOR_M


def lines_at_borders(jumps: Sequence[Jump], lines: Sequence[PlateLine], lost: Sequence[LostLine]) -> list[PlateLine]:
    """Lines between a jump and the floor beside the plate: stripes on the plate's front or across its edge.

    A missed step rotates all stripes after it, but the border of a plate displaces only a few neighbouring stripes.

    Args:
        jumps: jumps of all plates.
        lines: lines of all plates.
        lost: stripes of the plate scans without a usable line.
    """
    found = []
    for jump in jumps:
        beside = [one.index for one in lost if one.plate == jump.plate and one.is_beside]
        before = [index for index in beside if 0 <= jump.after - index <= BORDER_STRIPES]
        behind = [index for index in beside if 0 < index - jump.after <= BORDER_STRIPES + 1]
        low, high = (max(before), jump.after) if before else (jump.after + 1, min(behind, default=jump.after))
        found += [line for line in lines if line.plate == jump.plate and low <= line.index <= high]
    return found


def check_covered(lines: Sequence[PlateLine], plates: Sequence[Plate]) -> None:
    """Refuse plates that are too small or too few to cover the stripes.

    Raises:
        CalibrationRefused: too few stripes are on plates of two heights.
    """
    heights: dict[int, set[float]] = {stripe.index: set() for plate in plates for stripe in plate.scan.stripes}
    for line in lines:
        heights[line.index].add(line.height)
    bare = [index for index, seen in sorted(heights.items()) if len(seen) < 2]
    if len(bare) > (1 - MIN_LINES) * len(heights):
        raise CalibrationRefused(
            f"plates: {len(heights) - len(bare)} of {len(heights)} stripes lie on plates of two heights "
            f"({100 * MIN_LINES:.0f} % needed); stripes {format_indices(tuple(bare))} do not: scan a small "
            "plate several times, at different places in the scanned area"
        )


def refuse_jumps(jumps: Sequence[Jump], plates: Sequence[Plate], has_floor: bool) -> None:
    """Refuse a session with jumps of the laser plane.

    A jump means that the mirror missed a step, that frames were swapped or, without a scan of the bare floor, that a
    stripe fell beside the plate.

    Raises:
        CalibrationRefused: there are jumps; the message names plate, stripe and angle of the first three.
    """
    if jumps:
        named = [
            f"plate {plates[jump.plate].name}: after stripe index {jump.after} the laser plane is turned by "
            f"{np.rad2deg(jump.angle):+.2f} degrees"
            for jump in jumps[:3]
        ]
        more = f" and {len(jumps) - 3} more" if len(jumps) > 3 else ""
        fallen = "" if has_floor else ", or the stripe fell off the plate (scan the bare floor too, as a plate of 0 m)"
        raise CalibrationRefused(
            f"the mirror missed a step, or frames were swapped{fallen}: {'; '.join(named)}{more}: scan the plate again"
        )


def check_order(lines: Sequence[PlateLine], plates: Sequence[Plate]) -> None:
    """Refuse plates whose heights are swapped, so that their stripes move the wrong way with increasing height.

    The mirror is ahead of the camera, so each stripe appears farther ahead in the image on a higher plate.

    Raises:
        CalibrationRefused: the stripes on a higher plate are not farther ahead than on a lower one.
    """
    rows = {(line.plate, line.index): float(np.median(line.pixels[:, 1])) for line in lines}
    ahead = _direction(lines)
    swapped = []
    for a, b in combinations(range(len(plates)), 2):
        common = [i for p, i in rows if p == a and (b, i) in rows]
        if not common or plates[a].height == plates[b].height:
            continue
        moved = np.median([rows[b, i] - rows[a, i] for i in common]) * ahead
        if moved * (plates[b].height - plates[a].height) <= 0:
            named = [f"{plate.name} ({1e3 * plate.height:.0f} mm)" for plate in (plates[a], plates[b])]
            swapped.append(" and ".join(named))
    if swapped:
        raise CalibrationRefused(
            f"plate heights look swapped: {'; '.join(swapped)}: stripes must be farther ahead on the higher plate"
        )


def check_lines(plate: Plate, found: int, lost: Sequence[LostLine]) -> None:
    """Refuse a plate if too few of the stripes that meet it were found.

    Raises:
        CalibrationRefused: too few stripes were found, or no stripe meets the plate.
    """
    faults = [one for one in lost if not one.is_beside]
    wanted = len(plate.scan.stripes) - (len(lost) - len(faults))
    if not wanted:
        raise CalibrationRefused(f"plate {plate.name}: all stripes are beside it: place it in the scanned area")
    if found < MIN_LINES * wanted:
        example = f"; for example stripe index {faults[0].index}: {faults[0].reason}" if faults else ""
        raise CalibrationRefused(
            f"plate {plate.name}: {found} of {wanted} stripes were found ({100 * MIN_LINES:.0f} % needed)"
            f"{example}: check laser, exposure and the position of the plate"
        )


def check_mirror(sweep: Sweep) -> None:
    """Refuse a laser that deviates too much from its nominal mount in the robot model.

    Raises:
        CalibrationRefused: a parameter of the mirror model deviates too much.
    """
    limits = np.array(list(PARAMETERS.values())) * MAX_DEVIATION
    names = list(PARAMETERS)
    worst = int(np.argmax(np.abs(sweep.parameters) / limits))
    if abs(sweep.parameters[worst]) > limits[worst]:
        raise CalibrationRefused(
            f"the stripes do not fit the nominal mirror: {names[worst]} is {sweep.parameters[worst]:+.4f}, limit "
            f"{limits[worst]:.4f} (lengths in m, angles in rad): check the plate heights, the robot, the steps per "
            "turn of the mirror, and whether a mount came loose"
        )


def suspect_plate(entries: Sequence[LeaveOneOut], plates: Sequence[Plate]) -> str:
    """Message that names the plate contradicted by the others, or two plates if it is uncertain which one is wrong.

    The error of a left-out plate does not identify the wrong one, because a correct plate often has the largest error.
    With four or more plates, the remaining ones fit common laser planes only if the wrong one is left out. With three
    plates, the remaining two always fit, but the fitted mirror turns evenly only if the wrong one is left out.

    Args:
        entries: three or more fits, each of which left out one plate.
        plates: plates of the session.
    """

    def measure(entry: LeaveOneOut) -> float:
        return entry.irregularity if len(entries) < 4 else entry.disagreement

    worst, second = sorted(entries, key=measure)[:2]
    if len(entries) >= 4 and measure(second) < CLEARLY * measure(worst):
        one, other = plates[worst.plate], plates[second.plate]
        return (
            f"plates {one.name} and {other.name} contradict each other or the rest, and it cannot be decided which is "
            f"wrong: measure both again ({1e3 * one.height:.1f} and {1e3 * other.height:.1f} mm were given)"
        )
    plate = plates[worst.plate]
    measured, near, far = (
        # Adding zero turns -0.0 into 0.0.
        f"{round(1e3 * (plate.height + error), 1) + 0.0:.1f}"
        for error in (worst.mean, worst.near, worst.far)
    )
    return (
        f"plate {plate.name} contradicts the others: they put its top at {measured} mm ({near} near, {far} far) "
        f"instead of {1e3 * plate.height:.1f} mm: its height is wrong, or a mount slipped between the scans"
    )


def _direction(lines: Sequence[PlateLine]) -> float:
    """Sign of the change of the image row with distance ahead: +1 for the mount of eq. 5, -1 for an upright camera."""
    first = min(lines, key=lambda line: line.mirror_angle)
    last = max(lines, key=lambda line: line.mirror_angle)
    return float(np.sign(np.median(last.pixels[:, 1]) - np.median(first.pixels[:, 1])) or 1.0)


def _plane_angle(points: Float, axis: Float) -> float:
    """Angle of the centre of a line's points about the mirror axis [rad], 0 straight down, positive forward."""
    centre = points.mean(axis=0)
    return float(np.arctan2(centre[0] - axis[0], axis[2] - centre[2]))
