"""Stripe and motion records of protocol 1.1 and their encoding, as defined in `PROTOCOL.md`."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from drivers.board.board_records import checked
from drivers.board.protocol import MOTION_SIZE, STRIPE_MARK, STRIPE_SIZE, BoardFault, Shot
from drivers.errors import BadReply

STRIPE = struct.Struct("<BBHHHIHHHHHiIH")
MOTION = struct.Struct("<IIIIH12xH")


@dataclass(frozen=True, slots=True)
class StripeRecord:
    """Report of the board after each frame of a sweep.

    Attributes:
        shot: purpose of the trigger.
        motion: number of motions at the start of the sweep.
        place: place of the stripe in the step table.
        left: number of remaining stripes.
        clock: the board's clock at the trigger [s], modulo 2^32 us.
        exposures: number of exposures until the next trigger; 0 if they are not counted.
        delay: time from the trigger to the exposure [s].
        exposure: duration of the exposure [s].
        lit: time for which the laser was on [s].
        faults: faults that were set.
        step: motor step of the mirror.
    """

    shot: Shot
    motion: int
    place: int
    left: int
    clock: float
    exposures: int
    delay: float
    exposure: float
    lit: float
    faults: BoardFault
    step: int

    @classmethod
    def unpack(cls, data: bytes) -> StripeRecord:
        """Read the record.

        Raises:
            BadReply: wrong length, wrong checksum, or not a stripe record.
        """
        mark, shot, motion, place, left, clock, exposures, delay, exposure, lit, faults, step, _, _ = STRIPE.unpack(
            checked(data, STRIPE_SIZE, "stripe record")
        )
        if mark != STRIPE_MARK or shot not in (Shot.OFF, Shot.STRIPE):
            raise BadReply(f"unknown stripe record, its first bytes are {data[:2].hex()}: update the driver")
        clock, delay, exposure, lit = (microseconds * 1e-6 for microseconds in (clock, delay, exposure, lit))
        faults = BoardFault(faults)
        return cls(Shot(shot), motion, place, left, clock, exposures, delay, exposure, lit, faults, step)


@dataclass(frozen=True, slots=True)
class MotionProfile:
    """Speeds, acceleration and settling time of the motor, as reported by the board.

    Attributes:
        start_speed: speed at the start and at the end of a motion [steps/s].
        top_speed: highest speed [steps/s].
        acceleration: acceleration between the two speeds [steps/s^2].
        settle: settling time of the mirror after a motion [s].
        overshoot: number of steps by which a downward motion overshoots its target before it returns.
    """

    start_speed: float
    top_speed: float
    acceleration: float
    settle: float
    overshoot: int

    @classmethod
    def unpack(cls, data: bytes) -> MotionProfile:
        """Read the record.

        Raises:
            BadReply: wrong length or checksum.
        """
        start, top, acceleration, settle, overshoot, _ = MOTION.unpack(checked(data, MOTION_SIZE, "motion record"))
        return cls(start, top, acceleration, settle * 1e-6, overshoot)

    def time(self, steps: int) -> float:
        """Duration of a motion, without settling [s].

        Args:
            steps: signed number of steps; negative = downward, including overshoot and return.
        """
        if steps < 0:
            return self._one_way(self.overshoot - steps) + self._one_way(self.overshoot)
        return self._one_way(steps)

    def _one_way(self, steps: int) -> float:
        # Sum of the step intervals, with constant acceleration from both ends.
        squared = self.start_speed**2
        ramp = round(min(max(0.0, (self.top_speed**2 - squared) / (2 * self.acceleration)), steps))
        half = min(ramp + 1, steps // 2)
        total = 0.0
        for step in range(half):
            total += 2 / min(self.top_speed, math.sqrt(squared + 2 * self.acceleration * step))
        peak_speed = min(self.top_speed, math.sqrt(squared + 2 * self.acceleration * half))
        return total + (steps - 2 * half) / peak_speed
