"""`Errors`: base classes of the errors of perception, kinematics, transport and drivers, for a single `except`."""

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
