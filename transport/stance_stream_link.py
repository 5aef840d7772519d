"""Stream of joint samples from the gait controller to the perception node: publisher and receiver."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from transport.exceptions import MessageError
from transport.keys import DEFAULT_ROBOT, stance_stream_key
from transport.links.ordered_receiver import OrderedReceiver
from transport.links.publisher import SMALL, Publisher, Sender
from transport.links.session import Session
from transport.messages.stance_stream import (
    MAXIMUM_SAMPLES,
    StanceStream,
    decode_stance_stream,
    encode_stance_stream,
)
from transport.messages.submessages import Point, StanceMessage
from transport.messages.typestore import STANCE_STREAM, cdr

# Duration of a batch [s]. It is short, because the node waits for a sample after its last stripe, but long enough that
# the gait need not send a message per sample.
BATCH_PERIOD = 0.02
# Largest number of batches waiting to be sent. On a blocked link, the oldest are dropped; the receiver detects the gap.
MAXIMUM_WAITING = 64


@dataclass(frozen=True, slots=True)
class _Sample:
    stamp: int
    stance: StanceMessage
    angular_velocity: Point | None

    @property
    def form(self) -> tuple[object, ...]:
        """Properties that must be equal in all samples of a batch."""
        return tuple(self.stance.joint_positions), self.stance.gravity_in_base is None, self.angular_velocity is None


def _or_nan(vector: Point | None) -> Point:
    """Return the vector, or NaN if it was not measured."""
    return (np.nan, np.nan, np.nan) if vector is None else vector


class StanceStreamPublisher(Sender):
    """Publisher that sends joint samples in batches and never waits for a receiver.

    Args:
        session: open session.
        legs: names of the robot's legs; each sample states which legs carry weight.
        robot: instance name.
        epoch: identity of the walk, as in `StancePause`.
    """

    def __init__(self, session: Session, legs: tuple[str, ...], *, robot: str = DEFAULT_ROBOT, epoch: str = "") -> None:
        """Declare the key of the stream."""
        self.epoch = epoch
        self._robot, self._legs = robot, tuple(legs)
        self._publisher = Publisher(
            session, stance_stream_key(robot), latched=False, priority=SMALL, encoding=cdr(STANCE_STREAM)
        )
        self._lock = threading.Lock()
        self._samples: list[_Sample] = []
        self._sequence = 0
        super().__init__(session, self._publisher)

    def add(self, stamp: int, stance: StanceMessage, angular_velocity: Point | None = None) -> None:
        """Queue a sample; returns immediately.

        The batch of the samples queued before is sent first if it is full, if its first sample precedes the new one by
        `BATCH_PERIOD` or more, or if the new sample has other joints or measurements. `flush` sends the rest.

        Args:
            stamp: time of the joint positions, on the clock that stamps the pauses [ns since the epoch].
            stance: joint positions, support feet and, if there is an IMU, gravity.
            angular_velocity: angular velocity of the body in `base_link` [rad/s]; None if not measured.

        Raises:
            MessageError: a support foot is not one of the legs, the stamp is not later than those of the queued
                samples, or the batch to be sent is not valid.
            SessionClosed: the session is closed.
        """
        if unknown := set(stance.support_feet) - set(self._legs):
            raise MessageError(f"support_feet contains {', '.join(sorted(unknown))}; allowed: {', '.join(self._legs)}")
        sample = _Sample(int(stamp), stance, angular_velocity)
        with self._lock:
            if self._samples:
                last = self._samples[-1]
                if sample.stamp <= last.stamp:
                    raise MessageError(f"stamp is {stamp} ns; allowed: later than {last.stamp} ns, the previous stamp")
                is_full = len(self._samples) >= MAXIMUM_SAMPLES or sample.form != last.form
                if is_full or sample.stamp - self._samples[0].stamp >= BATCH_PERIOD * 1e9:
                    self._send()
            self._samples.append(sample)

    def flush(self, timeout: float) -> None:
        """Send the queued samples, and wait until they are sent; ReceiveTimeout if not done within `timeout` [s]."""
        with self._lock:
            self._send()
        super().flush(timeout)

    def _send(self) -> None:
        samples, self._samples = self._samples, []
        if not samples:
            return
        stances = [sample.stance for sample in samples]
        batch = StanceStream(
            robot=self._robot,
            stamp=samples[0].stamp,
            sequence=self._sequence,
            joint_names=tuple(stances[0].joint_positions),
            legs=self._legs,
            times=np.array([sample.stamp - samples[0].stamp for sample in samples]) * 1e-9,
            joint_positions=[list(stance.joint_positions.values()) for stance in stances],
            supports=[[leg in stance.support_feet for leg in self._legs] for stance in stances],
            gravity_in_base=[_or_nan(each.gravity_in_base) for each in stances],
            angular_velocity=[_or_nan(each.angular_velocity) for each in samples],
            epoch=self.epoch,
        )
        self._sequence += 1
        key = f"{self._publisher.key} {self._sequence % MAXIMUM_WAITING}"
        self._outbox.post(key, lambda: self._publisher.put(encode_stance_stream(batch)))


class StanceStreamReceiver(OrderedReceiver[StanceStream]):
    """Receiver of the joint samples of one robot.

    `on_batch` is called with the batches in the order of arrival. If it falls far behind, the oldest waiting batches
    are dropped.
    """

    def __init__(
        self,
        session: Session,
        *,
        robot: str = DEFAULT_ROBOT,
        on_batch: Callable[[StanceStream], None] | None = None,
        on_refused: Callable[[MessageError], None] | None = None,
    ) -> None:
        """Subscribe to the stream.

        Args:
            session: open session.
            robot: instance name.
            on_batch: called with each batch, on a separate thread.
            on_refused: called on that thread with the error when a batch is not valid, once for consecutive invalid
                batches that wait.
        """
        key = stance_stream_key(robot)
        super().__init__(session, key, decode_stance_stream, on_batch, on_refused, latched=False)

    def _is_dispensable(self, message: StanceStream) -> bool:
        return True
