"""Scan policy: coarse scans until an obstacle is found, then the stripes in between, and one grid of both scans."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import RobotLike, Settings, robot_model
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK, Hazard, names
from guara_perception.terrain.map.fuse_scan import scan_flags

# Consecutive clear pauses before coarse scans resume: one cycle, in which every foot swings once.
CLEAR_PAUSES = 4
# Margin of the corridor beside the tracks of the soles, because swinging feet sway and may hit boxes from the side.
CORRIDOR_MARGIN_M = 0.03


@dataclass(frozen=True, slots=True)
class ScanDecision:
    """Decision after the coarse stripes of a pause.

    Attributes:
        mode: "coarse" (the scan is done) or "standard" (fire `stripes` too).
        stripes: indices still to be fired, ascending; if time is short, those that cross the most obstacle cells. Empty
            for "coarse".
        is_whole: True if `stripes` complete the standard pattern.
        reasons: obstacles found at this pause, and lack of time if not even one further stripe fits; may be empty.
    """

    mode: str
    stripes: tuple[int, ...]
    is_whole: bool
    reasons: tuple[str, ...]


class ScanPolicy:
    """Choice of the stripes to fire at each pause, from obstacles found at this pause and at recent ones.

    Example:
        processor = ScanProcessor(calibration, robot, stance, mode="coarse")
        ...                                              # add the stripes of policy.first_stripes
        coarse = processor.finish()
        decision = policy.decide(coarse, processor.pairs, time_left=1.5, stripe_time=1 / 30)
        if decision.mode == "standard":
            processor = processor.extended()
            ...                                          # add decision.stripes
            terrain = refined(coarse, processor.finish())
    """

    def __init__(self, robot: RobotLike, *, height_limit: float | None = None) -> None:
        """Start with a clear path.

        Args:
            robot: model, name or folder; its soles define the corridor, and its robot.toml defines patterns and limits.
            height_limit: distance from the support plane above which a cell is an obstacle [m]; None = half of the
                drop limit.

        Raises:
            InvalidInput: the height limit is not a finite number above 0.
            kinematics.KinematicsError: the robot cannot be loaded.
        """
        robot = robot_model(robot)
        self._settings = Settings.of(robot)
        limits = self._settings.limits
        self._height_limit = limits.drop / 2 if height_limit is None else float(height_limit)
        if not (np.isfinite(self._height_limit) and self._height_limit > 0):
            raise InvalidInput(f"height_limit is {height_limit}; it must be above 0 m")
        state = robot.state(robot.posture(robot.config.scan_posture))
        tracks = np.abs(state.soles_in_base()[:, 1]).max()
        self._half_width = float(tracks) + limits.sole_width / 2 + CORRIDOR_MARGIN_M
        self._clear = CLEAR_PAUSES

    @property
    def mode(self) -> str:
        """Mode called for by the obstacles of recent pauses, even if no time was left for it; "coarse" at first."""
        return "coarse" if self._clear >= CLEAR_PAUSES else "standard"

    @property
    def first_stripes(self) -> tuple[int, ...]:
        """Indices of the coarse pattern, fired first at every pause."""
        return tuple(self._settings.pattern("coarse"))

    def decide(
        self,
        coarse: TerrainGrid,
        pairs: Index,
        *,
        time_left: float | None = None,
        stripe_time: float = 1 / 30,
    ) -> ScanDecision:
        """Decide which further stripes to fire, from the coarse scan of a pause; call once per pause.

        Args:
            coarse: grid of the coarse stripes.
            pairs: `ScanProcessor.pairs` of that scan.
            time_left: remaining time of the pause [s]; None = unlimited.
            stripe_time: time for one stripe [s].

        Raises:
            InvalidInput: the grid is not a scan, `pairs` does not have its shape, `time_left` is not finite, or
                `stripe_time` is not above 0.
        """
        if coarse.extent != "footprint" or pairs.shape != coarse.shape:
            raise InvalidInput(
                f"given: a grid of extent {coarse.extent!r} and shape {coarse.shape}, pairs of shape {pairs.shape}; "
                "allowed: the grid of a scan (extent 'footprint') and its pairs"
            )
        if not stripe_time > 0 or (time_left is not None and not np.isfinite(time_left)):
            raise InvalidInput(
                f"time_left is {time_left}, stripe_time is {stripe_time}, allowed: finite, stripe_time above 0 [s]"
            )
        found, reasons = self._obstacles(coarse)
        self._clear = 0 if reasons else min(self._clear + 1, CLEAR_PAUSES)
        if self.mode == "coarse":
            return ScanDecision("coarse", (), False, ())
        between = self._between(pairs, found)
        most = len(between) if time_left is None else max(int(time_left / stripe_time), 0)
        # The most important stripes, in the order in which the mirror passes them.
        chosen = tuple(sorted(between[:most]))
        if not chosen:
            return ScanDecision("coarse", (), False, (*reasons, "no time is left for the stripes in between"))
        return ScanDecision("standard", chosen, len(chosen) == len(between), tuple(reasons))

    def _obstacles(self, coarse: TerrainGrid) -> tuple[Mask, list[str]]:
        """Mask of the obstacle cells in the corridor, and a list of texts that describe them."""
        _, y = coarse.geometry.centres()
        corridor = np.repeat((np.abs(y) <= self._half_width)[:, None], coarse.shape[1], axis=1)
        flags = scan_flags(coarse) & ALL_BUT_EDGE
        # Unscanned cells beyond the known ends of each row do not count, because no stripe of this mode reaches them.
        known = np.isfinite(coarse.elevation)
        inside = np.logical_or.accumulate(known, axis=1) & np.logical_or.accumulate(known[:, ::-1], axis=1)[:, ::-1]
        hazardous = corridor & (flags != 0) & (inside | (flags != np.uint16(Hazard.UNSCANNED)))
        high = corridor & (np.abs(np.nan_to_num(coarse.elevation)) > self._height_limit)
        reasons = []
        if hazardous.any():
            found = names(int(np.bitwise_or.reduce(flags[hazardous])))
            reasons.append(f"{int(hazardous.sum())} hazardous cells in the corridor: {', '.join(found)}")
        if high.any():
            limit_mm = self._height_limit * 1e3
            reasons.append(f"{int(high.sum())} cells in the corridor are over {limit_mm:.0f} mm off the support plane")
        return hazardous | high, reasons

    def _between(self, pairs: Index, found: Mask) -> tuple[int, ...]:
        """Stripes missing from a coarse scan, those that cross the most obstacle cells first, then by index."""
        lacking = sorted(set(self._settings.pattern("standard")) - set(self._settings.pattern("coarse")))
        every = self._settings.coarse_every
        passed = {index: int(((pairs == index - index % every) & found).sum()) for index in lacking}
        return tuple(sorted(lacking, key=lambda index: (-passed[index], index)))


def refined(coarse: TerrainGrid, standard: TerrainGrid) -> TerrainGrid:
    """Combine a coarse scan with a standard scan of which only some stripes were fired.

    Cells that the standard scan observed, known or not, are taken from it; cells of stripes that were not fired are
    taken from the coarse scan. A stripe that was fired and lost leaves its cells unknown.

    Args:
        coarse: grid of the coarse stripes.
        standard: grid of `ScanProcessor.extended()` after stripes in between were added.

    Raises:
        InvalidInput: the grids do not belong to one scan, or the metadata of `standard` lacks limits.
    """
    if coarse.geometry != standard.geometry or coarse.step != standard.step:
        raise InvalidInput("the coarse and the standard grid do not belong to one scan: geometry or step differ")
    flags = scan_flags(standard) & UNKNOWN_MASK
    takes_coarse = flags == np.uint16(Hazard.UNSCANNED)
    if not takes_coarse.any():
        return standard
    flags = np.where(takes_coarse, coarse.hazard & UNKNOWN_MASK, flags).astype(np.uint16)

    def either(name: str) -> Float:
        return np.where(takes_coarse, coarse.layers[name], standard.layers[name]).astype(np.float64)

    raster = Raster(*(either(name) for name in ("elevation", "variance_local", "elevation_min", "elevation_max")))
    layers = assess_layers(
        raster,
        flags,
        coarse.resolution,
        standard.record.required_limits,
        shared=either("variance") - raster.variance,
        slope_sigma=standard.record.checked_attitude_sigma,
    )
    known = float(np.isfinite(layers["elevation"]).mean())
    return dataclasses.replace(standard, layers=layers, record=dataclasses.replace(standard.record, known=known))
