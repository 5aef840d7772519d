"""Transforms as the message type that ROS 2 knows: tf2_msgs/TFMessage."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from transport.exceptions import MessageError
from transport.messages.codec import make_header
from transport.messages.submessage_codec import make_transform
from transport.messages.submessages import TransformMessage
from transport.messages.typestore import FRAMES, message_class


def frames_message(transforms: Iterable[TransformMessage], stamp: int) -> Any:
    """A tf2_msgs/TFMessage message object.

    A transform takes coordinates of its source to its destination, so that in ROS's words the destination is the
    parent (`header.frame_id`) and the source the child.

    Args:
        transforms: a forest: each source stands once.
        stamp: [ns] since the epoch, of all.

    Raises:
        MessageError: a source stands twice.
    """
    stamped: Any = message_class("geometry_msgs/msg/TransformStamped")
    given = list(transforms)
    sources = [item.source_frame for item in given]
    twice = sorted({name for name in sources if sources.count(name) > 1})
    if twice:
        raise MessageError(f"transforms of {', '.join(twice)} stand twice; a frame has one parent")
    return message_class(FRAMES)(
        [
            stamped(make_header(stamp, item.destination_frame), item.source_frame, make_transform(item).transform)
            for item in given
        ]
    )
