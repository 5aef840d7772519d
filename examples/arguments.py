"""How the other examples take their arguments: a mistake ends in one line and exit code 2."""

import inspect
import sys
from collections.abc import Callable

from drivers import DriverError
from guara_perception import PerceptionError
from kinematics import KinematicsError
from transport import TransportError


def call(main: Callable[..., None]) -> None:
    """Call the main function of an example with one argument of the command line for each parameter.

    Args:
        main: a function whose parameters are all text.

    Raises:
        SystemExit: with exit code 2: wrong number of arguments, or a file, robot or value that cannot be used.
    """
    names, given = list(inspect.signature(main).parameters), sys.argv[1:]
    try:
        if len(given) != len(names):
            raise ValueError(f"{len(given)} arguments given; usage: python {sys.argv[0]} {' '.join(names).upper()}")
        main(*given)
    except (PerceptionError, KinematicsError, DriverError, TransportError, OSError, ValueError) as error:
        print(f"{sys.argv[0]}: {error}", file=sys.stderr)
        sys.exit(2)
