"""`Errors`: every error that the public functions and clients raise on purpose, for one `except`."""

from __future__ import annotations

from drivers.errors import DriverError
from guara_perception.exceptions import PerceptionError
from kinematics.exceptions import KinematicsError
from transport.exceptions import TransportError

Errors = (PerceptionError, KinematicsError, TransportError, DriverError)
