"""Constants, enumerations, fault texts and checksum of the USB protocol of the laser board; see `PROTOCOL.md`."""

from __future__ import annotations

import binascii
import enum

# 0x1209:0x0001 is reserved by pid.codes for private testing. A production board needs its own id (`BoardConfig`).
VENDOR_ID = 0x1209
PRODUCT_ID = 0x0001
MANUFACTURER = "Guara"
PRODUCT = "Guara laser board"

PROTOCOL_MAJOR = 1
PROTOCOL_MINOR = 2
# First version of the protocol in which sweeps can have dark flashes.
DARKS_SINCE = (1, 2)

INTERFACE = 0
REPORT_ENDPOINT = 0x81
# bmRequestType of every command: direction device-to-host, type vendor, recipient device. The data stage contains the
# reply.
REQUEST_IN = 0xC0

IDENTITY_MAGIC = b"GUAR"
IDENTITY_SIZE = 32
STATUS_SIZE = 26
STRIPE_SIZE = 32
MOTION_SIZE = 32
# Length of a read from the interrupt endpoint [bytes].
REPORT_SIZE = 32

# First byte of a stripe record. A status record on the same endpoint begins with its result, which is always 0 there.
STRIPE_MARK = 0x53
# Largest number of stripes in a sweep, and number of entries in the step table.
SWEEP_STRIPES, SWEEP_PLACES = 256, 512
FLASH_SHORTEST_US = 200
FLASH_LONGEST_US = 20_000
PERIOD_LONGEST_US = 1_000_000
WAIT_UNIT_US = 500
WAIT_UNITS = 127

# bRequest by which Windows reads the Microsoft OS 2.0 descriptors; it must not be a command.
MICROSOFT_REQUEST = 0xF0


class Request(enum.IntEnum):
    """Codes (bRequest) of the commands."""

    IDENTIFY = 0x01
    HELLO = 0x02
    GOODBYE = 0x03
    LASER = 0x10
    HOME = 0x20
    GO_TO = 0x21
    HALT = 0x22
    STATUS = 0x30
    CLEAR_FAULTS = 0x31
    SWEEP_STEP = 0x40
    SWEEP_FLASH = 0x41
    SWEEP_PERIOD = 0x42
    SWEEP_OFF_FRAMES = 0x43
    SWEEP = 0x44
    SWEEP_DARK = 0x45
    MOTION = 0x50
    START_SPEED = 0x51
    TOP_SPEED = 0x52
    ACCELERATION = 0x53
    SETTLE = 0x54


# Request by number; ten times faster than `Request(number)`.
REQUESTS = {int(request): request for request in Request}


class Result(enum.IntEnum):
    """Result of a command."""

    OK = 0
    NO_SESSION = 1
    NOT_HOMED = 2
    OUT_OF_RANGE = 3
    LASER_REFUSED = 4
    BUSY = 5
    VERSION = 6


class BoardFlag(enum.IntFlag):
    """Flags of the board's state."""

    SESSION = 1
    LASER_COMMANDED = 2
    LASER_SENSED = 4
    MOVING = 8
    HOMED = 16
    HAS_SENSOR = 32
    COUNTS_EXPOSURES = 64
    HAS_SWEEP = 128
    SWEEPING = 256


class SweepOffFrames(enum.IntEnum):
    """Laser-off frames that a sweep takes: none, one for all stripes, or one per stripe."""

    NONE = 0
    ONE = 1
    PER_STRIPE = 2


class Shot(enum.IntEnum):
    """Purpose of a camera trigger."""

    OFF = 0
    STRIPE = 1


class BoardFault(enum.IntFlag):
    """Faults of the board. A fault persists until its cause is gone and it is cleared."""

    WATCHDOG = 1
    LASER_TIME = 2
    OVER_TEMPERATURE = 4
    LASER_STUCK_ON = 8
    LASER_DEAD = 16
    LOST_STEPS = 32
    HOME_NOT_FOUND = 64


# Faults that keep the laser off until they are cleared.
BLOCKING = BoardFault.WATCHDOG | BoardFault.LASER_TIME | BoardFault.OVER_TEMPERATURE | BoardFault.LASER_STUCK_ON
FAULT_MEANINGS = {
    BoardFault.WATCHDOG: "the host was silent and the watchdog turned the laser off",
    BoardFault.LASER_TIME: "the laser was on for the longest time allowed",
    BoardFault.OVER_TEMPERATURE: "the board is too hot",
    BoardFault.LASER_STUCK_ON: "the laser is on without a command",
    BoardFault.LASER_DEAD: "the laser is dark although it was switched on",
    BoardFault.LOST_STEPS: "the mirror had lost steps when it was homed",
    BoardFault.HOME_NOT_FOUND: "the home switch was not found",
}


def describe_faults(faults: BoardFault) -> str:
    """Describe faults as text, or return "no fault"."""
    meanings = [meaning for fault, meaning in FAULT_MEANINGS.items() if fault in faults]
    return "; ".join(meanings) if meanings else "no fault"


def checksum(data: bytes) -> int:
    """Compute the CRC-16 of the protocol: CCITT polynomial 0x1021, initial value 0xFFFF."""
    return binascii.crc_hqx(data, 0xFFFF)


def split_argument(argument: int) -> tuple[int, int]:
    """Split a signed 32-bit argument into (wValue, wIndex): its low and its high half."""
    return argument & 0xFFFF, argument >> 16 & 0xFFFF


def join_argument(value: int, index: int) -> int:
    """Join wValue and wIndex into a signed 32-bit argument; inverse of `split_argument`."""
    return signed((index & 0xFFFF) << 16 | (value & 0xFFFF))


def signed(argument: int) -> int:
    """Convert an unsigned 32-bit argument to the signed value with the same bits."""
    return argument - (1 << 32) if argument >= 1 << 31 else argument
