"""Exceptions of the package `transport`, all derived from `TransportError`, and conversion of other errors to them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager


class TransportError(Exception):
    """Base class of all errors raised by the package `transport`."""


class MessageError(TransportError, ValueError):
    """A payload or message does not fit its type: a length, type, shape, name or value is wrong."""


class VersionError(MessageError):
    """A message has a major version that this package does not support."""


class UnknownPhase(MessageError):
    """A stance pause message has a phase that only later versions know; the message is ignored."""


class KeyNameError(TransportError, ValueError):
    """A name, extent or encoding cannot be part of a key."""


class ConfigurationError(TransportError, ValueError):
    """Settings are not valid, contradict each other, or are not safe, such as an open port without security."""


class NameTaken(TransportError, ConnectionError):
    """Another node with this instance name is running on the router."""


class OperationFailed(TransportError, RuntimeError):
    """Zenoh or the node refused an operation for a reason that has no error class of its own."""


class SessionClosed(TransportError, RuntimeError):
    """The session, or an object that belongs to it, was used after being closed."""


class ScannerUnavailable(TransportError, ConnectionError):
    """No scanner replies: none with this version of the messages is running, or this client lacks permission."""


class ConnectionFailed(ScannerUnavailable):
    """The session could not be opened; the error message lists what to check."""


class ScannerGone(ScannerUnavailable):
    """The scanner disappeared: its process ended or hung, or the link to it was lost."""


class StaleTerrain(TransportError, LookupError):
    """No usable grid: none is published yet, or the newest one may not be used.

    A grid may not be used if it is too old in seconds or pauses, comes from another walk or run of the node, was
    withdrawn, is not currently confirmed by a live node, was followed by a grid that has not arrived, or is provisional
    although a confirmed grid is required.

    Attributes:
        is_final: False if waiting may remove all reasons why the newest grid may not be used.
    """

    def __init__(self, message: str = "", *, is_final: bool = True) -> None:
        super().__init__(message)
        self.is_final = is_final


class ReceiveTimeout(TransportError, TimeoutError):
    """A message did not arrive, or could not be sent, in time."""


class ScanBusy(TransportError, RuntimeError):
    """The scanner is working on another request."""


class ScanFailed(TransportError, RuntimeError):
    """The scanner refused the request or could not complete the scan; `code` is a short name of the cause."""

    def __init__(self, message: str, code: str = "failed") -> None:
        super().__init__(message)
        self.code = code


class ScanTimeout(TransportError, TimeoutError):
    """The scan was not completed before the deadline of the request."""


class RecordingError(TransportError, ValueError):
    """A recording cannot be read or written as requested."""


class SecurityError(TransportError, ValueError):
    """A security folder is incomplete or unreadable, or does not permit the requested operation."""


@contextmanager
def errors_as(kind: type[TransportError], what: str, *causes: type[Exception]) -> Iterator[None]:
    """Convert errors to errors of class `kind`, whose message consists of `what` and the cause.

    Args:
        kind: class of the new error.
        what: beginning of its message.
        causes: classes of the errors to convert; none = OSError, of which only the text without the path is used.
    """
    converted = causes or (OSError,)
    try:
        yield
    except converted as error:
        text = str(error) if causes else getattr(error, "strerror", None)
        raise kind(f"{what}: {text or error}") from error


def check_choice(what: str, given: object, allowed: Collection[str], kind: type[TransportError] = MessageError) -> None:
    """Check that a value is one of the allowed names.

    Args:
        what: name of the value in the error message.
        given: the value.
        allowed: allowed names.
        kind: class of the error.

    Raises:
        TransportError: the value is not allowed; an error of class `kind`.
    """
    if given not in allowed:
        raise kind(f"{what} is {given!r}; allowed: {', '.join(map(repr, allowed))}")
