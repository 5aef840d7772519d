"""Identity and status records of a laser board, and their encoding as defined in `PROTOCOL.md`."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.board.protocol import (
    IDENTITY_MAGIC,
    IDENTITY_SIZE,
    STATUS_SIZE,
    BoardFault,
    BoardFlag,
    Result,
    checksum,
)
from drivers.errors import BadReply

IDENTITY = struct.Struct("<4sBBHIiiiHHHH")
STATUS = struct.Struct("<BBHHHiHhhHIH")


@dataclass(frozen=True, slots=True)
class BoardIdentity:
    """Identity of a laser board, from the handshake.

    Attributes:
        protocol: (major, minor) version of the protocol.
        firmware: (major, minor) version of the firmware.
        step_angle: rotation of the mirror per step [rad].
        min_step: lowest step that may be commanded, counted from the home switch.
        max_step: highest step that may be commanded, counted from the home switch.
        zero_step: step at which the mirror angle is zero.
        watchdog: time without a command from the host after which the board turns the laser off [s].
        laser_limit: longest time for which the laser may be on without a rest [s].
        laser_rest: length of a rest after which the laser may be on for `laser_limit` again [s].
    """

    protocol: tuple[int, int]
    firmware: tuple[int, int]
    step_angle: float
    min_step: int
    max_step: int
    zero_step: int
    watchdog: float
    laser_limit: float
    laser_rest: float

    def angle_of(self, step: int) -> float:
        """Return the mirror angle at `step` [rad]."""
        return (step - self.zero_step) * self.step_angle

    def step_of(self, angle: float) -> int:
        """Return the step nearest to a mirror angle [rad], even if the step is outside the travel."""
        return self.zero_step + round(angle / self.step_angle)

    def pack(self) -> bytes:
        """Encode the record as bytes."""
        head = IDENTITY.pack(
            IDENTITY_MAGIC,
            *self.protocol,
            self.firmware[0] << 8 | self.firmware[1],
            round(self.step_angle * 1e9),
            self.min_step,
            self.max_step,
            self.zero_step,
            round(self.watchdog * 1e3),
            round(self.laser_limit * 1e3),
            round(self.laser_rest * 1e3),
            0,
        )
        return seal(head)

    @classmethod
    def unpack(cls, data: bytes) -> BoardIdentity:
        """Decode a record.

        Raises:
            BadReply: length, magic or checksum is wrong, or the step angle is 0.
        """
        magic, *values = IDENTITY.unpack(checked(data, IDENTITY_SIZE, "identity"))
        if magic != IDENTITY_MAGIC:
            raise BadReply(
                f"the identity begins with {magic!r} instead of {IDENTITY_MAGIC!r}: another device uses this vendor "
                "and product id; give the board's serial number"
            )
        major, minor, firmware, step_angle, *steps = values[:7]
        if step_angle == 0:
            raise BadReply(
                "the identity has a step angle of 0 nrad, but it must be above 0: flash firmware configured for the "
                "motor"
            )
        times = (milliseconds * 1e-3 for milliseconds in values[7:10])
        return cls((major, minor), (firmware >> 8, firmware & 0xFF), step_angle * 1e-9, *steps, *times)


@dataclass(frozen=True, slots=True)
class BoardStatus:
    """Status of a laser board, from a reply to a command or a report on the interrupt endpoint.

    A driver of a board with another protocol sets only `flags`, `faults` and `step`.

    Attributes:
        result: result of the command.
        request: command to which the status is the reply; 0 in a report.
        sequence: number of requests answered by a status since power-up, modulo 65536.
        flags: state of the board.
        faults: faults that are set.
        step: position of the mirror according to the firmware [steps from the home switch].
        motion: number of motions started since power-up, modulo 65536.
        temperature: temperature of the board [degrees Celsius].
        home_error: error of the step count when the home switch was last found [steps].
        laser_time: time that counts towards the board's `laser_limit` [s]; 0 while the laser is off.
        device_time: time since power-up on the board's clock [s], modulo 2^32 ms.
    """

    result: Result = Result.OK
    request: int = 0
    sequence: int = 0
    flags: BoardFlag = BoardFlag(0)
    faults: BoardFault = BoardFault(0)
    step: int = 0
    motion: int = 0
    temperature: float = 0.0
    home_error: int = 0
    laser_time: float = 0.0
    device_time: float = 0.0

    @property
    def laser_commanded(self) -> bool:
        """True if the board drives the laser."""
        return BoardFlag.LASER_COMMANDED in self.flags

    @property
    def laser_sensed(self) -> bool:
        """True if the photodiode detects the laser; on a board without a sensor, True if the board drives the laser."""
        wanted = BoardFlag.LASER_SENSED if BoardFlag.HAS_SENSOR in self.flags else BoardFlag.LASER_COMMANDED
        return wanted in self.flags

    @property
    def moving(self) -> bool:
        """True while the mirror moves or settles."""
        return BoardFlag.MOVING in self.flags

    @property
    def homed(self) -> bool:
        """True if the home position is known."""
        return BoardFlag.HOMED in self.flags

    def pack(self) -> bytes:
        """Encode the record as bytes."""
        head = STATUS.pack(
            self.result,
            self.request,
            self.sequence & 0xFFFF,
            self.flags,
            self.faults,
            self.step,
            self.motion & 0xFFFF,
            round(self.temperature * 10),
            max(-32768, min(32767, self.home_error)),
            min(65535, round(self.laser_time * 1e3)),
            round(self.device_time * 1e3) & 0xFFFFFFFF,
            0,
        )
        return seal(head)

    @classmethod
    def unpack(cls, data: bytes) -> BoardStatus:
        """Decode a record.

        Raises:
            BadReply: length or checksum is wrong, or the result is unknown.
        """
        code, request, sequence, flags, faults, step, motion, temperature, home_error, lit, clock, _ = STATUS.unpack(
            checked(data, STATUS_SIZE, "status")
        )
        try:
            result = Result(code)
        except ValueError:
            raise BadReply(f"the status has result {code}; allowed: 0 ... {max(Result)}: update the driver") from None
        measured = temperature / 10, home_error, lit * 1e-3, clock * 1e-3
        return cls(result, request, sequence, BoardFlag(flags), BoardFault(faults), step, motion, *measured)


def seal(record: bytes) -> bytes:
    """Replace the last two bytes of a record with its checksum."""
    body = record[:-2]
    return body + checksum(body).to_bytes(2, "little")


def checked(data: bytes, size: int, what: str) -> bytes:
    """Check length and checksum of a record, and return the record.

    Raises:
        BadReply: length or checksum is wrong; the error message names the record by `what`.
    """
    if len(data) != size:
        raise BadReply(f"the {what} has {len(data)} bytes; allowed: {size}: check cable and firmware")
    if int.from_bytes(data[-2:], "little") != checksum(data[:-2]):
        raise BadReply(f"the {what} is damaged (its checksum is wrong): check cable and firmware")
    return data
