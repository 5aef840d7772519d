"""Errors of the transport, all derived from TransportError."""

from __future__ import annotations


class TransportError(Exception):
    """Root of all errors of this package."""


class MessageError(TransportError, ValueError):
    """A payload or message violates its type: wrong length, type, shape, name or number."""


class VersionError(MessageError):
    """A message of another major version than the one this package speaks."""


class UnknownPhase(MessageError):
    """A stance pause of a phase that only later versions know; it has no effect."""


class KeyNameError(TransportError, ValueError):
    """A robot or role name that cannot be part of a key."""


class ConfigurationError(TransportError, ValueError):
    """Settings that contradict one another or are not safe, such as an open port without security."""


class NameTaken(TransportError, ConnectionError):
    """Another node of the same instance name lives on this router."""


class SessionClosed(TransportError, RuntimeError):
    """The session was used after it had been closed."""


class ScannerUnavailable(TransportError, ConnectionError):
    """No scanner answers: none is running, or this side lacks the permission to read or trigger it."""


class ConnectionFailed(ScannerUnavailable):
    """The session could not be opened: nobody listens there; the message lists what to check."""


class ScannerGone(TransportError, ConnectionError):
    """The scanner has disappeared: its process died, hung, or lost its link."""


class StaleTerrain(TransportError, LookupError):
    """The newest grid may not be used: too old, of another pause or walk, withdrawn, or without a living node.

    Attributes:
        is_final: whether no later message can make this grid usable again.
    """

    def __init__(self, message: str = "", *, is_final: bool = True) -> None:
        """Keep whether it may be asked for again."""
        super().__init__(message)
        self.is_final = is_final


class ReceiveTimeout(TransportError, TimeoutError):
    """The awaited message did not come within the time allowed."""


class ScanBusy(TransportError, RuntimeError):
    """The scanner works on another request."""


class ScanFailed(TransportError, RuntimeError):
    """The scanner refused the request or could not finish the scan; `code` is the short name of the cause."""

    def __init__(self, message: str, code: str = "failed") -> None:
        """Keep the short name of the cause beside the message."""
        super().__init__(message)
        self.code = code


class ScanTimeout(TransportError, TimeoutError):
    """The scan was not finished by the deadline of the request."""


class RecordingError(TransportError, ValueError):
    """A recording that cannot be read or written as asked."""


class SecurityError(TransportError, ValueError):
    """A security folder that is incomplete, or must not be overwritten."""
