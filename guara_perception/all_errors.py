"""`Errors`: base classes of all errors that public functions and clients raise deliberately, for one `except`."""

from __future__ import annotations

from guara_perception.exceptions import PerceptionError
from kinematics.exceptions import KinematicsError
from transport.exceptions import TransportError

Errors: tuple[type[Exception], ...] = (PerceptionError, KinematicsError, TransportError)
try:
    from drivers.errors import DriverError
except ModuleNotFoundError:  # The distribution guara-client has no drivers.
    pass
else:
    Errors += (DriverError,)
