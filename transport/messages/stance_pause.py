"""Announcement of a stance pause by the gait controller, and its CDR payload."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from transport.exceptions import MessageError, UnknownPhase
from transport.keys import check_name
from transport.messages.codec import decode, encode, from_ros, to_ros
from transport.messages.submessages import GroundPatch, StanceMessage, finite, set_fields
from transport.messages.typestore import LARGEST_COUNT, STANCE_PAUSE, check_value

# Largest payload [bytes]; an announcement with sixteen patches of 48 corners each takes 20 kB.
MAXIMUM_ANNOUNCEMENT = 256 * 1024
# Longest identity of a walk [characters].
MAXIMUM_EPOCH = 100


class PausePhase(IntEnum):
    """Announced event: the pause begins (BEGIN), continues (HOLD) or ends (END)."""

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
        stamp: time of the joint state [ns since the Unix epoch].
        stance: joint positions, support feet and gravity.
        time_available: time from `stamp` to the planned end of the pause [s]; 0 if unknown.
        known_ground: ground that the gait controller declares safe, in `frame_id`.
        frame_id: frame of `known_ground`.
        epoch: identity of the walk, equal in all its pauses; empty if the gait controller sends none.
        standing_pauses: for each support foot, number of earlier pauses since it was set down (0 = it was set down
            after the previous pause); empty if unknown.
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
    standing_pauses: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            UnknownPhase: this version does not know the phase.
            MessageError: a value is not allowed.
            KeyNameError: the robot's name cannot be part of a key.
        """
        check_name(self.robot)
        if abs(self.step) > LARGEST_COUNT:
            raise MessageError(f"step is {self.step}; allowed: -2^53 to 2^53")
        if not isinstance(self.epoch, str) or len(self.epoch) > MAXIMUM_EPOCH:
            raise MessageError(f"epoch is {self.epoch!r}; allowed: text of up to {MAXIMUM_EPOCH} characters")
        try:
            standing = np.asarray(self.standing_pauses, np.uint32)
        except (OverflowError, TypeError, ValueError) as error:
            raise MessageError(f"standing_pauses is {self.standing_pauses!r}; allowed: integers from 0") from error
        if standing.shape not in ((0,), (len(self.stance.support_feet),)):
            raise MessageError(
                f"standing_pauses has {standing.size} entries; allowed: none, or one for each of the "
                f"{len(self.stance.support_feet)} support_feet"
            )
        try:
            phase = PausePhase(self.phase)
        except ValueError as error:
            raise UnknownPhase(
                f"phase is {self.phase!r}; known: 1 (BEGIN), 2 (END) and 3 (HOLD). Unknown phases of later versions "
                "are ignored"
            ) from error
        available = finite(self.time_available, "time_available")
        check_value(STANCE_PAUSE, "time_available", available)
        check_value(STANCE_PAUSE, "known_ground", self.known_ground)
        ground = tuple(self.known_ground)
        set_fields(
            self, phase=phase, time_available=available, known_ground=ground, standing_pauses=tuple(standing.tolist())
        )


def make_stance_pause(pause: StancePause) -> Any:
    """Convert an announcement to a guara_msgs/StancePause message object."""
    return to_ros(STANCE_PAUSE, pause, standing_pauses=np.array(pause.standing_pauses, np.uint32))


def encode_stance_pause(pause: StancePause) -> bytearray:
    """Encode an announcement as CDR.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    return encode(make_stance_pause(pause))


def decode_stance_pause(payload: bytes | bytearray | memoryview) -> StancePause:
    """Decode and check the CDR payload of a guara_msgs/StancePause; its last one or two fields may be missing.

    Raises:
        UnknownPhase: this version does not know the phase.
        MessageError: the payload is damaged, or a value is not allowed.
    """
    if len(payload) > MAXIMUM_ANNOUNCEMENT:
        raise MessageError(f"stance pause of {len(payload)} bytes refused; allowed: up to {MAXIMUM_ANNOUNCEMENT} bytes")
    return from_ros(StancePause, _decoded(payload))


def _decoded(payload: bytes | bytearray | memoryview) -> Any:
    """Decode the message object. Older gait controllers omit `standing_pauses`, and the oldest also omit `epoch`."""
    try:
        return decode(payload, STANCE_PAUSE)
    except MessageError as error:
        if len(payload) < 8:
            raise
        # If `standing_pauses` is missing, the payload ends with the zero byte that terminates `epoch`. If `epoch` is
        # missing too, it ends at a multiple of four bytes. Any other payload was truncated.
        fill, one, nothing = bytes(-len(payload) % 4), (1).to_bytes(4, "little" if payload[1] else "big"), bytes(4)
        for is_earlier, missing in ((payload[-1] == 0, fill + nothing), (not fill, one + nothing + nothing)):
            if not is_earlier:
                continue
            try:
                message = decode(bytes(payload) + missing, STANCE_PAUSE)
            except MessageError:
                continue
            if not len(message.standing_pauses) and not (missing.startswith(one) and message.epoch):
                return message
        raise error
