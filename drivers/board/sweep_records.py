"""Stripe and motion records of protocol 1.1, and their decoding as defined in `PROTOCOL.md`."""

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
    """Report that the board sends after each frame of a sweep.

    Attributes:
        shot: purpose of the trigger.
        motion: motion number of the sweep (number of motions started since power-up), modulo 65536.
        place: index of the stripe in the step table.
        left: number of stripes that remain after this frame.
        clock: time of the trigger on the board's clock [s], modulo 2^32 us.
        exposures: number of exposures until the next trigger. Without the camera's exposure signal, `exposures`,
            `delay` and `exposure` are 0.
        delay: time from the trigger to the start of the exposure [s].
        exposure: duration of the exposure [s].
        lit: time for which the laser was on [s].
        faults: faults that were set.
        step: position of the mirror [steps from the home switch].
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
        """Decode a record.

        Raises:
            BadReply: length or checksum is wrong, or the record is not a stripe record.
        """
        mark, shot, motion, place, left, clock, exposures, delay, exposure, lit, faults, step, _, _ = STRIPE.unpack(
            checked(data, STRIPE_SIZE, "stripe record")
        )
        if mark != STRIPE_MARK or shot not in (Shot.OFF, Shot.STRIPE):
            raise BadReply(f"unknown stripe record (first bytes {data[:2].hex()}): update the driver")
        clock, delay, exposure, lit = (microseconds * 1e-6 for microseconds in (clock, delay, exposure, lit))
        faults = BoardFault(faults)
        return cls(Shot(shot), motion, place, left, clock, exposures, delay, exposure, lit, faults, step)


@dataclass(frozen=True, slots=True)
class MotionProfile:
    """Speeds, acceleration and settling time of the motor, as reported by the board.

    Attributes:
        start_speed: speed at the beginning and at the end of a motion [steps/s].
        top_speed: highest speed [steps/s].
        acceleration: acceleration between the two speeds [steps/s^2].
        settle: settling time of the mirror after a motion [s].
        overshoot: number of steps by which a downward motion passes its target before it returns.
    """

    start_speed: float
    top_speed: float
    acceleration: float
    settle: float
    overshoot: int

    @classmethod
    def unpack(cls, data: bytes) -> MotionProfile:
        """Decode a record.

        Raises:
            BadReply: length or checksum is wrong.
        """
        start, top, acceleration, settle, overshoot, _ = MOTION.unpack(checked(data, MOTION_SIZE, "motion record"))
        return cls(start, top, acceleration, settle * 1e-6, overshoot)

    def time(self, steps: int) -> float:
        """Compute the duration of a motion [s], without settling.

        Args:
            steps: signed number of steps; a negative, downward motion includes overshoot and return.
        """
        if steps < 0:
            return self._one_way(self.overshoot - steps) + self._one_way(self.overshoot)
        return self._one_way(steps)

    def _one_way(self, steps: int) -> float:
        # Sum of the step intervals, with constant acceleration at the start and equal deceleration at the end.
        squared = self.start_speed**2
        ramp = round(min(max(0.0, (self.top_speed**2 - squared) / (2 * self.acceleration)), steps))
        half = min(ramp + 1, steps // 2)
        total = 0.0
        for step in range(half):
            total += 2 / min(self.top_speed, math.sqrt(squared + 2 * self.acceleration * step))
        peak_speed = min(self.top_speed, math.sqrt(squared + 2 * self.acceleration * half))
        return total + (steps - 2 * half) / peak_speed
