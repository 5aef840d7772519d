"""Exceptions of device drivers, all derived from `DriverError`.

Each specific error also derives from a built-in exception (`TimeoutError`, `PermissionError`, ...), so that callers can
catch it without importing this package.
"""

from __future__ import annotations


class DriverError(Exception):
    """Base class of the errors in this module; invalid arguments may raise a plain ValueError instead."""


class BoardError(DriverError, RuntimeError):
    """Failure of the laser board or of its connection."""


class NoUsbBackend(BoardError, ImportError):
    """libusb could not be loaded, so no USB device can be reached."""


class BoardNotFound(BoardError, ConnectionError):
    """No board with the configured USB ids and serial number is plugged in, or the choice is ambiguous."""


class BoardPermissionDenied(BoardError, PermissionError):
    """The board is plugged in, but this user may not open it; the error message contains the udev rule to install."""


class BoardInUse(BoardError, ConnectionError):
    """The board is already claimed, usually by another process."""


class BoardNotOpen(BoardError, RuntimeError):
    """The board is not open, or was reset and has forgotten its session."""


class BoardUnplugged(BoardError, ConnectionError):
    """The board was unplugged during an operation."""


class BoardTimeout(BoardError, TimeoutError):
    """The board did not reply in time."""


class BoardStalled(BoardError, ConnectionError):
    """The board stalled a transfer, as it does for an unknown command."""


class BoardTransferFailed(BoardError, ConnectionError):
    """A transfer failed on the bus for a reason that has no error class of its own."""


class BadReply(BoardError, ValueError):
    """A reply, report or descriptor of the board is damaged or invalid, or a reply belongs to another request."""


class ProtocolMismatch(BoardError, RuntimeError):
    """Board and driver use incompatible protocol versions."""


class BoardTooOld(BoardError, NotImplementedError):
    """The board or its firmware lacks the requested function."""


class LaserRefused(BoardError, RuntimeError):
    """The board has a fault that prevents a scan or keeps the laser off; the error message names it."""


class LaserStuckOn(BoardError, RuntimeError):
    """The laser did not go off on command: cut its power by hand, unless the board has already done so."""


class LaserDead(BoardError, RuntimeError):
    """The laser is dark although it was switched on."""


class MirrorNotHomed(BoardError, RuntimeError):
    """The mirror was commanded to move before homing."""


class MirrorOutOfRange(BoardError, ValueError):
    """A mirror angle or step is outside the board's travel."""


class MirrorTimeout(BoardError, TimeoutError):
    """The mirror did not come to rest in time, or was commanded during homing or a sweep."""


class HomeNotFound(BoardError, RuntimeError):
    """The board did not find the home switch over the whole travel."""


class CameraError(DriverError, RuntimeError):
    """Failure of a camera."""


class CameraNotFound(CameraError, FileNotFoundError):
    """The camera, video file or image sequence could not be opened."""


class CameraBackendMissing(CameraError, ValueError):
    """A library for the camera is missing: Aravis, linuxpy, or an OpenCV backend such as GStreamer."""


class CameraNotOpen(CameraError, RuntimeError):
    """The camera is not open."""


class CameraNotTriggered(CameraError, ValueError):
    """A sweep was requested, but the camera is not triggered by the board."""


class CameraTimeout(CameraError, TimeoutError):
    """No frame arrived in time."""


class CameraEnded(CameraError, EOFError):
    """The camera was disconnected, or the video file, image sequence or replay has no more frames."""


class CameraSettingRefused(CameraError, ValueError):
    """The camera lacks a setting, format or size, does not allow a value, or reports a different one."""


class AcquisitionError(DriverError, RuntimeError):
    """Failure of a scan, or of the measurement of a camera's lag or exposure."""


class BadFiringOrder(AcquisitionError, ValueError):
    """The firing order is empty, has a repeated or negative index, or contains an angle that is not finite."""


class AcquisitionNotEntered(AcquisitionError, RuntimeError):
    """A scan was iterated before its `with` block was entered."""


class StripeClipped(AcquisitionError, ValueError):
    """The stripe is too bright for the measurement."""


class LaserNotSeen(AcquisitionError, RuntimeError):
    """Images with the laser on and off do not differ as expected."""
