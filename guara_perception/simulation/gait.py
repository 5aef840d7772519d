"""The wave gait: which leg swings next, where its foot should land, and where the feet stand at the start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.exceptions import InvalidInput

if TYPE_CHECKING:
    from kinematics import RobotModel

# Walking speeds of the paper's robot [m/s], 450 ... 800 mm/min.
SLOWEST_M_S, FASTEST_M_S = 0.45 / 60, 0.80 / 60


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveGait:
    """A wave gait: one leg swings at a time, rear to front on the right side, then on the left.

    Attributes:
        lift_order: legs in the order in which they swing.
        hips: (x, y) of each sole in base_link halfway between its landing and its lift, by leg [m].
        cycle_length: advance of the body in one cycle, all legs once [m].
        speed: mean speed without pauses [m/s].
        hip_height: height of the body's origin over the plane of the soles [m].
    """

    lift_order: tuple[str, ...]
    hips: dict[str, tuple[float, float]]
    cycle_length: float = 0.140
    speed: float = 0.60 / 60
    hip_height: float = 0.360

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidInput: a speed that the robot does not walk, a cycle without length.
        """
        if not SLOWEST_M_S - 1e-9 <= self.speed <= FASTEST_M_S + 1e-9:
            raise InvalidInput(
                f"speed is {self.speed * 60e3:.0f} mm/min, it must be {SLOWEST_M_S * 60e3:.0f} ... "
                f"{FASTEST_M_S * 60e3:.0f}"
            )
        if not 0 < self.cycle_length <= 0.5:
            raise InvalidInput(f"cycle_length is {self.cycle_length} m, it must be above 0 and at most 0.5")

    @staticmethod
    def of(robot: RobotModel, *, cycle_length: float = 0.140, speed: float = 0.60 / 60) -> WaveGait:
        """The gait of a robot in its scan posture; RH, RF, LH, LF for a robot with four legs."""
        # The soles of the scan posture: on most robots they lie beside the first joint of the leg, not below it.
        state = robot.state(robot.posture(robot.config.scan_posture))
        soles = state.soles_in_base()
        hips = {leg: np.round(sole, 6) for leg, sole in zip(robot.legs, soles, strict=True)}
        order = sorted(hips, key=lambda leg: (hips[leg][1] > 0, hips[leg][0]))
        return WaveGait(
            lift_order=tuple(order),
            hips={leg: (float(hip[0]), float(hip[1])) for leg, hip in hips.items()},
            cycle_length=cycle_length,
            speed=speed,
            hip_height=round(-float(soles[:, 2].mean()), 6),
        )

    @property
    def advance(self) -> float:
        """Advance of the body between two swings [m]."""
        return self.cycle_length / len(self.lift_order)

    @property
    def swing_time(self) -> float:
        """Time from one pause to the next: body forward, then one swing [s]."""
        return self.advance / self.speed

    def leg_of_swing(self, number: int) -> str:
        """The leg of the swing after pause `number`."""
        return self.lift_order[number % len(self.lift_order)]

    def landing(self, leg: str) -> tuple[float, float]:
        """Where a foot lands, in base_link's x and y after the body has advanced: half a cycle ahead of its hip [m]."""
        x, y = self.hips[leg]
        return x + self.cycle_length / 2, y

    def first_stance(self) -> dict[str, tuple[float, float]]:
        """Where the feet stand at pause 0, in base_link's x and y [m]: as if the robot had walked before."""
        stance = {}
        for order, leg in enumerate(self.lift_order):
            x, y = self.hips[leg]
            stance[leg] = (x - self.cycle_length / 2 + (order + 1) * self.advance, y)
        return stance

    def support_polygon(self, margin: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Corners (4, 2) of the rectangle around all feet of the first stance, with a margin [m]."""
        feet = np.array(list(self.first_stance().values()))
        low, high = feet.min(axis=0) - margin, feet.max(axis=0) + margin
        return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
