"""Announcement of a stance pause by the gait controller, and its CDR payload."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from transport.exceptions import MessageError, UnknownPhase
from transport.keys import check_name
from transport.messages.codec import decode, encode, from_ros, to_ros
from transport.messages.submessages import GroundPatch, StanceMessage, finite, set_fields
from transport.messages.typestore import LARGEST_COUNT, STANCE_PAUSE, check_value

# [byte] A pause with sixteen patches of known ground has 20 kB.
MAXIMUM_ANNOUNCEMENT = 256 * 1024
# Longest identity of a walk [characters].
MAXIMUM_EPOCH = 100


class PausePhase(IntEnum):
    """Event that is announced: the pause begins, continues (HOLD) or ends."""

    BEGIN = 1
    END = 2
    HOLD = 3


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StancePause:
    """Announcement that a stance pause begins, continues or ends.

    Attributes:
        robot: instance name.
        step: number of the pause.
        phase: BEGIN, HOLD or END.
        stamp: time of the joint state [ns since the epoch].
        stance: joints, support feet, gravity.
        time_available: time from the stamp to the planned end of the pause [s]; 0 if unknown.
        known_ground: ground that the gait declares safe, in `frame_id`.
        frame_id: frame of `known_ground`.
        epoch: identity of the walk, the same in all its pauses; empty if the gait gives none.
    """

    robot: str
    step: int
    phase: PausePhase
    stamp: int
    stance: StanceMessage
    time_available: float = 0.0
    known_ground: tuple[GroundPatch, ...] = ()
    frame_id: str = "base_footprint"
    epoch: str = ""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            UnknownPhase: a phase that this version does not know.
            MessageError: a value is not allowed.
            KeyNameError: the robot's name cannot be part of a key.
        """
        check_name(self.robot)
        if abs(self.step) > LARGEST_COUNT:
            raise MessageError(f"step is {self.step}; allowed: -2^53 to 2^53")
        if not isinstance(self.epoch, str) or len(self.epoch) > MAXIMUM_EPOCH:
            raise MessageError(f"epoch is {self.epoch!r}; allowed: text of up to {MAXIMUM_EPOCH} characters")
        try:
            set_fields(self, phase=PausePhase(self.phase))
        except ValueError as error:
            raise UnknownPhase(
                f"phase is {self.phase!r}; known: 1 (BEGIN), 2 (END) and 3 (HOLD). Unknown phases of later versions "
                "are ignored"
            ) from error
        available = finite(self.time_available, "time_available")
        check_value(STANCE_PAUSE, "time_available", available)
        set_fields(self, time_available=available, known_ground=tuple(self.known_ground))
        check_value(STANCE_PAUSE, "known_ground", self.known_ground)


def make_stance_pause(pause: StancePause) -> Any:
    """Make the guara_msgs/StancePause message object."""
    return to_ros(STANCE_PAUSE, pause)


def encode_stance_pause(pause: StancePause) -> bytearray:
    """CDR payload of a stance pause.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    return encode(make_stance_pause(pause))


def decode_stance_pause(payload: bytes | bytearray | memoryview) -> StancePause:
    """Decode and check the CDR payload of a guara_msgs/StancePause, with or without its last field.

    Raises:
        UnknownPhase: the phase is not known to this version.
        MessageError: the payload is damaged, or a value is not allowed.
    """
    if len(payload) > MAXIMUM_ANNOUNCEMENT:
        raise MessageError(f"stance pause of {len(payload)} bytes refused; allowed: {MAXIMUM_ANNOUNCEMENT} bytes")
    return from_ros(StancePause, _decoded(payload))


def _decoded(payload: bytes | bytearray | memoryview) -> Any:
    """Decode the message object; gait controllers of earlier versions send no `epoch`, which then is empty."""
    try:
        return decode(payload, STANCE_PAUSE)
    except MessageError as error:
        # Without `epoch` the length is a multiple of four bytes; any other payload was truncated.
        if len(payload) < 8 or len(payload) % 4 != 0:
            raise
        length = (1).to_bytes(4, "little" if payload[1] else "big")
        try:
            message = decode(bytes(payload) + length + b"\0", STANCE_PAUSE)
        except MessageError:
            raise error from None
        if message.epoch:
            raise
        return message
