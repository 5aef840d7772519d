"""Exceptions of device drivers, all derived from `DriverError`.

Each error also derives from the builtin that fits (`TimeoutError`, `PermissionError`, ...), so that
callers need not know this package to catch it. Every message says what was given or found,
what is allowed, and what to do.
"""

from __future__ import annotations


class DriverError(Exception):
    """Root of every error raised by the package `drivers`."""


class BoardError(DriverError):
    """Failure between the host and the laser board."""


class NoUsbBackend(BoardError, ImportError):
    """No libusb could be loaded, so no USB device can be reached at all."""


class BoardNotFound(BoardError, ConnectionError):
    """No board with the wanted vendor id, product id and serial number is plugged in."""


class BoardPermissionDenied(BoardError, PermissionError):
    """The board is plugged in, but this user may not open it; the message holds the udev rule to install."""


class BoardInUse(BoardError, ConnectionError):
    """Another process has claimed the board."""


class BoardNotOpen(BoardError, RuntimeError):
    """A command was given to a board that is closed, or whose connection was lost."""


class BoardUnplugged(BoardError, ConnectionError):
    """The board left the bus in the middle of the work."""


class BoardTimeout(BoardError, TimeoutError):
    """The board did not answer a transfer in time, not even when asked again."""


class BoardStalled(BoardError, ConnectionError):
    """The board stalled a transfer, again when asked again: it does not know the request."""


class BoardTransferFailed(BoardError, ConnectionError):
    """A transfer failed for another reason on the bus."""


class BadReply(BoardError, ValueError):
    """The board's answer was too short, damaged or belongs to another request."""


class ProtocolMismatch(BoardError, RuntimeError):
    """Board and driver speak different versions of the protocol."""


class BoardTooOld(BoardError, NotImplementedError):
    """The board's firmware lacks the requested function."""


class LaserRefused(BoardError, RuntimeError):
    """The board refuses to switch the laser on; the message names the fault."""


class LaserStuckOn(BoardError, RuntimeError):
    """The laser is still on after it was switched off: cut its power by hand."""


class LaserDead(BoardError, RuntimeError):
    """The laser is dark although it was switched on."""


class MirrorNotHomed(BoardError, RuntimeError):
    """The mirror was commanded to an angle before its home was found."""


class MirrorOutOfRange(BoardError, ValueError):
    """The wanted mirror angle is outside the board's travel."""


class MirrorTimeout(BoardError, TimeoutError):
    """The mirror did not come to rest in time."""


class HomeNotFound(BoardError, RuntimeError):
    """The board moved through its whole travel and never met the home switch."""


class CameraError(DriverError):
    """Failure of a camera."""


class CameraNotFound(CameraError, FileNotFoundError):
    """The camera, video file or image sequence could not be opened."""


class CameraBackendMissing(CameraError, ValueError):
    """A library of the camera is missing: Aravis, or the backend of OpenCV (FireWire, GStreamer)."""


class CameraNotOpen(CameraError, RuntimeError):
    """A frame was asked of a camera that is closed."""


class CameraNotTriggered(CameraError, ValueError):
    """A sweep was asked for with a camera that does not wait for the board's trigger."""


class CameraTimeout(CameraError, TimeoutError):
    """No frame came in time."""


class CameraEnded(CameraError, EOFError):
    """The camera is gone, or the video file, image sequence or replay has no further frame."""


class CameraSettingRefused(CameraError, ValueError):
    """The camera rejected a setting: the value read back differs from the requested one."""


class AcquisitionError(DriverError):
    """A scan could not be taken, or laser, mirror and frames were not in step."""


class BadFiringOrder(AcquisitionError, ValueError):
    """The list of stripes is empty, repeats an index or holds an angle that is not finite."""


class AcquisitionNotEntered(AcquisitionError, RuntimeError):
    """A scan was iterated outside its `with` block."""


class StripeClipped(AcquisitionError, ValueError):
    """The stripe is too bright for what is to be measured."""


class LaserNotSeen(AcquisitionError, RuntimeError):
    """The camera sees no difference between laser on and laser off."""
