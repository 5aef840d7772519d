"""Stance pause announced by the gait controller: message in Python, and its CDR payload."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from transport.exceptions import MessageError, UnknownPhase
from transport.keys import check_name
from transport.messages.codec import decode, encode
from transport.messages.ranges import LARGEST_COUNT, check_value
from transport.messages.submessage_codec import from_ros, to_ros
from transport.messages.submessages import GroundPatch, StanceMessage, finite, set_fields
from transport.messages.typestore import STANCE_PAUSE

# [byte] A pause with sixteen patches of known ground has 20 kB.
MAXIMUM_ANNOUNCEMENT = 256 * 1024
# Characters of the identity of a walk.
MAXIMUM_EPOCH = 100


class PausePhase(IntEnum):
    """Event of an announcement: the pause begins, goes on (HOLD), or ends."""

    BEGIN = 1
    END = 2
    HOLD = 3


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StancePause:
    """Announcement that a stance pause begins, goes on or ends.

    Attributes:
        robot: instance name.
        step: number of the pause.
        phase: BEGIN, HOLD or END.
        stamp: [ns] since the epoch; time of the joint state.
        stance: joints, support feet, gravity.
        time_available: [s] from the stamp to the planned end of the pause; 0 when not known.
        known_ground: what the gait declares safe, in `frame_id`.
        frame_id: frame of `known_ground`.
        epoch: identity of the walk, the same in all its pauses; empty when the gait gives none.
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
        """Check.

        Raises:
            UnknownPhase: a phase that this version does not know.
            MessageError: a field is not what the message allows.
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
                f"phase is {self.phase!r}; known: 1 (BEGIN), 2 (END) and 3 (HOLD). An announcement of a later version "
                "changes nothing here"
            ) from error
        available = finite(self.time_available, "time_available")
        check_value(STANCE_PAUSE, "time_available", available)
        set_fields(self, time_available=available, known_ground=tuple(self.known_ground))
        check_value(STANCE_PAUSE, "known_ground", self.known_ground)


def make_stance_pause(pause: StancePause) -> Any:
    """The guara_msgs/StancePause message object."""
    return to_ros(STANCE_PAUSE, pause)


def encode_stance_pause(pause: StancePause) -> bytearray:
    """The CDR payload of one stance pause.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    return encode(make_stance_pause(pause))


def decode_stance_pause(payload: bytes | bytearray | memoryview) -> StancePause:
    """Read and check the CDR payload of a guara_msgs/StancePause, with or without its last field.

    Raises:
        UnknownPhase: the phase is one of a later version.
        MessageError: the payload is damaged, or a field is not what the message allows.
    """
    if len(payload) > MAXIMUM_ANNOUNCEMENT:
        raise MessageError(f"stance pause of {len(payload)} bytes refused; allowed: {MAXIMUM_ANNOUNCEMENT} bytes")
    return from_ros(StancePause, _decoded(payload))


def _decoded(payload: bytes | bytearray | memoryview) -> Any:
    """The message object; a gait that was built before walks had an identity sends no `epoch`, which then is empty."""
    try:
        return decode(payload, STANCE_PAUSE)
    except MessageError as error:
        # Without `epoch` a message ends on a multiple of four bytes, so that one which was cut is not mistaken for it.
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
