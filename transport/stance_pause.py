"""The stance pause that the gait controller announces: message in Python, and its CDR payload."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from transport.codec import decode, encode, make_header, read_time
from transport.exceptions import MessageError, TransportError
from transport.keys import check_name
from transport.submessage_codec import make_ground, make_stance, read_ground, read_stance
from transport.submessages import GroundPatch, StanceMessage, finite
from transport.typestore import STANCE_PAUSE, message_class


class PausePhase(IntEnum):
    """Which end of a stance pause a message announces."""

    BEGIN = 1
    END = 2


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StancePause:
    """A stance pause begins or ends.

    Attributes:
        robot: instance name.
        step: number of the pause.
        phase: BEGIN or END.
        stamp: [ns] since the epoch; time of the joint state.
        stance: joints, support feet, gravity.
        time_available: [s] from the stamp to the planned end of the pause; 0 when not known.
        known_ground: what the gait declares safe, in `frame_id`.
        frame_id: frame of `known_ground`.
    """

    robot: str
    step: int
    phase: PausePhase
    stamp: int
    stance: StanceMessage
    time_available: float = 0.0
    known_ground: tuple[GroundPatch, ...] = ()
    frame_id: str = "base_footprint"

    def __post_init__(self) -> None:
        """Check.

        Raises:
            MessageError: a field is not what the message allows.
            KeyNameError: the robot's name cannot be part of a key.
        """
        check_name(self.robot)
        try:
            object.__setattr__(self, "phase", PausePhase(self.phase))
        except ValueError as error:
            raise MessageError(f"phase is {self.phase!r}; allowed: 1 (BEGIN) and 2 (END)") from error
        available = finite(self.time_available, "time_available")
        if available < 0.0:
            raise MessageError(f"time_available is {available} s; allowed: 0 or more")
        object.__setattr__(self, "time_available", available)
        object.__setattr__(self, "known_ground", tuple(self.known_ground))


def make_stance_pause(pause: StancePause) -> Any:
    """The guara_msgs/StancePause message object."""
    return message_class(STANCE_PAUSE)(
        header=make_header(pause.stamp, pause.frame_id),
        robot=pause.robot,
        step=pause.step,
        phase=int(pause.phase),
        stance=make_stance(pause.stance),
        time_available=pause.time_available,
        known_ground=[make_ground(patch) for patch in pause.known_ground],
    )


def encode_stance_pause(pause: StancePause) -> bytearray:
    """The CDR payload of one stance pause.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    return encode(make_stance_pause(pause))


def decode_stance_pause(payload: bytes | bytearray | memoryview) -> StancePause:
    """Read and check the CDR payload of a guara_msgs/StancePause.

    Raises:
        MessageError: the payload is damaged, or a field is not what the message allows.
    """
    message = decode(payload, STANCE_PAUSE)
    try:
        return StancePause(
            robot=message.robot,
            step=message.step,
            phase=PausePhase(message.phase),
            stamp=read_time(message.header.stamp),
            stance=read_stance(message.stance),
            time_available=message.time_available,
            known_ground=tuple(read_ground(patch) for patch in message.known_ground),
            frame_id=message.header.frame_id,
        )
    except MessageError:
        raise
    except (TransportError, ValueError, OverflowError) as error:
        raise MessageError(f"stance pause refused: {error}") from error
