"""Text as the message type that ROS 2 knows: std_msgs/String."""

from __future__ import annotations

from typing import Any

from transport.messages.typestore import TEXT, message_class


def text_message(text: str) -> Any:
    """A std_msgs/String message object."""
    return message_class(TEXT)(text)
