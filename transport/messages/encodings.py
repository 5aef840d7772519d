"""What Zenoh's samples say of their payloads, so that a tool knows them without knowing the key.

Receivers of this package judge by the payload: a sample without any of this, as earlier versions send it, is read too.
"""

from __future__ import annotations


def cdr(type_name: str) -> str:
    """Zenoh's own name for CDR, with the ROS 2 type as schema: `application/cdr;nav_msgs/msg/OccupancyGrid`."""
    return f"application/cdr;{type_name}"


def compact(type_name: str) -> str:
    """CDR whose bytes were shuffled by four and compressed (`transport.messages.shuffle`)."""
    return f"application/zstd;shuffle=4;{cdr(type_name)}"
