"""Configuration of the emulated board."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from drivers.board.board_records import BoardIdentity
from drivers.board.protocol import PROTOCOL_MAJOR, PROTOCOL_MINOR

# Microstep (1/256 step) of a 1.8 degree stepper motor that drives the mirror directly: 0.00703 degrees.
# The default travel is -15 ... 25 degrees, which includes the scan of Guara (-6.3 ... 18.6 degrees).
STEP_NANORAD = 122718
STEP = STEP_NANORAD * 1e-9


def _default_identity() -> BoardIdentity:
    min_step = 64
    return BoardIdentity(
        protocol=(PROTOCOL_MAJOR, PROTOCOL_MINOR),
        firmware=(1, 0),
        step_angle=STEP,
        min_step=min_step,
        max_step=min_step + round(math.radians(40.0) / STEP),
        zero_step=min_step + round(math.radians(15.0) / STEP),
        watchdog=0.4,
        laser_limit=10.0,
        laser_rest=0.05,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatorConfig:
    """Configuration of an `EmulatedBoard`.

    Attributes:
        identity: identity that the board reports, with the limits that it enforces. An `EmulatedBoard` always reports
            protocol 1.0.
        serial: serial number of the board.
        mirror_speed: speed of the mirror [rad/s]; 7 rad/s is about 220 full steps per second, slow for a stepper.
        settle: settling time of the mirror after a motion [s].
        overshoot: number of steps by which a downward motion passes its target, to take up backlash.
        temperature: temperature of the board [degrees Celsius].
    """

    identity: BoardIdentity = field(default_factory=_default_identity)
    serial: str = "EMU0001"
    mirror_speed: float = 7.0
    settle: float = 0.003
    overshoot: int = 32
    temperature: float = 30.0

    @classmethod
    def reaching(cls, angles: Iterable[float]) -> EmulatorConfig:
        """Configuration of a board whose travel is the default one, extended to include mirror angles [rad]."""
        identity = _default_identity()
        steps = [identity.step_of(angle) for angle in angles]
        below = max(0, identity.min_step - min(steps))
        above = max(0, max(steps) - identity.max_step)
        return cls(
            identity=replace(identity, zero_step=identity.zero_step + below, max_step=identity.max_step + below + above)
        )
