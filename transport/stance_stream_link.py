"""Stream of joint samples from the gait controller to the perception node: publisher and receiver."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
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


# Vector that was not measured.
NOT_MEASURED = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class JointSample:
    """Sample of a stance stream.

    Attributes:
        stamp: time of the sample, on the clock that stamps the pauses [ns since the Unix epoch].
        joint_positions: position of each joint by name [rad].
        support_feet: names of the legs that carry weight.
        gravity_in_base: direction of gravity in `base_link`, pointing down, or `NOT_MEASURED`.
        angular_velocity: angular velocity of the body in `base_link` [rad/s], or `NOT_MEASURED`.
    """

    stamp: int
    joint_positions: Mapping[str, float]
    support_feet: Sequence[str]
    gravity_in_base: Sequence[float]
    angular_velocity: Sequence[float]

    @property
    def form(self) -> tuple[object, ...]:
        """Properties that must be equal in all samples of a batch."""
        measured = (math.isnan(vector[0]) for vector in (self.gravity_in_base, self.angular_velocity))
        return tuple(self.joint_positions), *measured


class Batcher:
    """Joint samples that wait to be sent, and the batches made of them."""

    def __init__(self, robot: str, legs: Sequence[str]) -> None:
        """Start without samples; `robot` is the instance name, and `legs` are the names of the robot's legs."""
        self._robot, self._legs = robot, tuple(legs)
        self._samples: list[JointSample] = []
        self._sequence = 0

    def add(self, sample: JointSample, epoch: str) -> StanceStream | None:
        """Add a sample; if the earlier samples form a complete batch, return it, otherwise None.

        `epoch` is the walk of the batch. A batch is complete if it is full, if its first sample precedes the new one by
        `BATCH_PERIOD` or more, or if the new sample has other joints or measurements.

        Raises:
            MessageError: the stamp is not later than the previous one, or the batch is not valid.
        """
        if self._samples:
            first, last = self._samples[0], self._samples[-1]
            if sample.stamp <= last.stamp:
                raise MessageError(f"stamp is {sample.stamp} ns; allowed: later than the previous one, {last.stamp} ns")
            is_full = len(self._samples) >= MAXIMUM_SAMPLES or sample.form != last.form
            if is_full or sample.stamp - first.stamp >= BATCH_PERIOD * 1e9:
                return self.take(epoch, [sample])
        self._samples.append(sample)
        return None

    def take(self, epoch: str, rest: list[JointSample]) -> StanceStream | None:
        """Return a batch of all waiting samples, or None if there are none; `rest` begins the next batch.

        Raises:
            MessageError: the batch is not valid.
        """
        samples, self._samples = self._samples, rest
        if not samples:
            return None
        batch = StanceStream(
            robot=self._robot,
            stamp=samples[0].stamp,
            sequence=self._sequence,
            joint_names=tuple(samples[0].joint_positions),
            legs=self._legs,
            times=np.array([each.stamp - samples[0].stamp for each in samples]) * 1e-9,
            joint_positions=[list(each.joint_positions.values()) for each in samples],
            supports=[[leg in each.support_feet for leg in self._legs] for each in samples],
            gravity_in_base=[each.gravity_in_base for each in samples],
            angular_velocity=[each.angular_velocity for each in samples],
            epoch=epoch,
        )
        self._sequence += 1
        return batch


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
        self._legs, self._batcher = tuple(legs), Batcher(robot, legs)
        self._publisher = Publisher(
            session, stance_stream_key(robot), latched=False, priority=SMALL, encoding=cdr(STANCE_STREAM)
        )
        self._lock = threading.Lock()
        super().__init__(session, self._publisher)

    def add(self, stamp: int, stance: StanceMessage, angular_velocity: Point | None = None) -> None:
        """Queue a sample; returns immediately.

        A complete batch of earlier samples is sent (see `Batcher.add`); `flush` sends the rest.

        Args:
            stamp: time of the joint positions, on the clock that stamps the pauses [ns since the Unix epoch].
            stance: joint positions, support feet and, if there is an IMU, gravity.
            angular_velocity: angular velocity of the body in `base_link` [rad/s]; None if not measured.

        Raises:
            MessageError: a support foot is not one of the legs, the stamp is not later than those of the queued
                samples, or the batch to be sent is not valid.
            SessionClosed: the session is closed.
        """
        if unknown := set(stance.support_feet) - set(self._legs):
            raise MessageError(f"support_feet contains {', '.join(sorted(unknown))}; allowed: {', '.join(self._legs)}")
        gravity = NOT_MEASURED if stance.gravity_in_base is None else stance.gravity_in_base
        turning = NOT_MEASURED if angular_velocity is None else angular_velocity
        sample = JointSample(int(stamp), stance.joint_positions, stance.support_feet, gravity, turning)
        with self._lock:
            self._send(self._batcher.add(sample, self.epoch))

    def flush(self, timeout: float) -> None:
        """Send the queued samples, and wait until they are sent; ReceiveTimeout if not done within `timeout` [s]."""
        with self._lock:
            self._send(self._batcher.take(self.epoch, []))
        super().flush(timeout)

    def _send(self, batch: StanceStream | None) -> None:
        if batch is not None:
            key = f"{self._publisher.key} {batch.sequence % MAXIMUM_WAITING}"
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
            on_refused: called on that thread with the error of an invalid batch, once for consecutive waiting batches
                with the same type of error.
        """
        key = stance_stream_key(robot)
        super().__init__(session, key, decode_stance_stream, on_batch, on_refused, latched=False)

    def _is_dispensable(self, message: StanceStream) -> bool:
        return True
