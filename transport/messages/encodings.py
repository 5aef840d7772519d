"""Encodings of Zenoh samples, from which tools know the type of a payload.

Receivers of this package go by the payload itself, so that samples of earlier versions without encoding are read too.
"""

from __future__ import annotations


def cdr(type_name: str) -> str:
    """Encoding of CDR with the ROS 2 type as schema: `application/cdr;nav_msgs/msg/OccupancyGrid`."""
    return f"application/cdr;{type_name}"


def compact(type_name: str) -> str:
    """Encoding of CDR that was shuffled by four bytes and compressed (`transport.messages.shuffle`)."""
    return f"application/zstd;shuffle=4;{cdr(type_name)}"
