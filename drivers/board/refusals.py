"""Turns what the board refuses, and a version that does not fit, into typed errors that say what to do."""

from __future__ import annotations

from drivers.board.board_records import BoardIdentity, BoardStatus
from drivers.board.protocol import PROTOCOL_MAJOR, PROTOCOL_MINOR, Result, describe_faults
from drivers.errors import (
    BoardNotOpen,
    LaserRefused,
    MirrorNotHomed,
    MirrorOutOfRange,
    MirrorTimeout,
    ProtocolMismatch,
)


def raise_refusal(status: BoardStatus, argument: int, identity: BoardIdentity | None) -> None:
    """Raise the error that belongs to the result of a command; do nothing when it is OK.

    Args:
        status: the answer.
        argument: what was asked for (the step of a GO_TO).
        identity: identity of the board, for the travel in the message; None when unknown.
    """
    match status.result:
        case Result.OK:
            return
        case Result.LASER_REFUSED:
            raise LaserRefused(
                f"the board refuses to switch the laser on: {describe_faults(status.faults)}; "
                "ensure_ready() clears what can be cleared"
            )
        case Result.NOT_HOMED:
            raise MirrorNotHomed("the mirror's home is unknown: call home() or ensure_ready() first")
        case Result.OUT_OF_RANGE:
            travel = f"{identity.min_step} ... {identity.max_step}" if identity else "unknown"
            raise MirrorOutOfRange(f"step {argument}, the board's travel is {travel}")
        case Result.BUSY:
            raise MirrorTimeout("the mirror is still on its way home: wait_until_still() first")
        case Result.NO_SESSION:
            raise BoardNotOpen("the board has forgotten this session (it was reset): reconnect()")
        case Result.VERSION:
            raise ProtocolMismatch(
                f"the board refuses protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}: update this software"
            )


def check_version(identity: BoardIdentity) -> None:
    """Refuse a board whose protocol does not fit this driver.

    Raises:
        ProtocolMismatch: another major version.
    """
    major, minor = identity.protocol
    if major == PROTOCOL_MAJOR:
        return
    too_old = major < PROTOCOL_MAJOR
    advice = "flash a newer firmware to the board" if too_old else "update this software"
    firmware = f"{identity.firmware[0]}.{identity.firmware[1]}"
    raise ProtocolMismatch(
        f"the board speaks protocol {major}.{minor} (firmware {firmware}), "
        f"this driver speaks {PROTOCOL_MAJOR}.{PROTOCOL_MINOR} and works with any {PROTOCOL_MAJOR}.x: {advice}"
    )
