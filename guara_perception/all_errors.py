"""`Errors`: every error that the public functions and clients raise on purpose, for one `except`."""

from __future__ import annotations

from guara_perception.exceptions import PerceptionError
from kinematics.exceptions import KinematicsError
from transport.exceptions import TransportError

Errors: tuple[type[Exception], ...] = (PerceptionError, KinematicsError, TransportError)
try:
    from drivers.errors import DriverError
except ModuleNotFoundError:  # The distribution guara-client has no devices.
    pass
else:
    Errors += (DriverError,)
