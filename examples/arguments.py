"""Command-line arguments of the other examples; a mistake prints one line and ends with exit code 2."""

import inspect
import sys
from collections.abc import Callable

from drivers import DriverError
from guara_perception import PerceptionError
from kinematics import KinematicsError
from transport import TransportError


def call(main: Callable[..., None]) -> None:
    """Call the main function of an example with the arguments of the command line, one for each parameter.

    Args:
        main: function whose parameters are all strings.

    Raises:
        SystemExit: code 2: the number of arguments is wrong, or a file, robot or value cannot be used.
    """
    names, given = list(inspect.signature(main).parameters), sys.argv[1:]
    try:
        if len(given) != len(names):
            raise ValueError(f"{len(given)} arguments given; usage: python {sys.argv[0]} {' '.join(names).upper()}")
        main(*given)
    except (PerceptionError, KinematicsError, DriverError, TransportError, OSError, ValueError) as error:
        print(f"{sys.argv[0]}: {error}", file=sys.stderr)
        sys.exit(2)
