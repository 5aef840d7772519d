"""Ways to break a good session, picture by picture."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from guara_perception.calibration.calibration_input import CalibrationSession, Plate

Picture = np.ndarray[Any, Any]
Change = Callable[[Picture], Picture]


def with_pictures(session: CalibrationSession, change: Callable[[str, Picture], Picture]) -> CalibrationSession:
    """The session with its still pictures changed as they are read."""
    return dataclasses.replace(session, read_picture=lambda name: change(name, session.read_picture(name)))


def with_plate(session: CalibrationSession, number: int, **changes: Any) -> CalibrationSession:
    """The session with fields of one plate's scan changed."""
    plates = list(session.plates)
    scan = dataclasses.replace(plates[number].scan, **changes)
    plates[number] = Plate(plates[number].name, plates[number].height, scan)
    return dataclasses.replace(session, plates=tuple(plates))


def with_frames(session: CalibrationSession, number: int, change: Change) -> CalibrationSession:
    """The session with every frame of one plate changed as it is read."""
    scan = session.plates[number].scan
    return with_plate(session, number, read_frame=lambda name: change(scan.read_frame(name)))


def missed_step(session: CalibrationSession, number: int, first: int) -> CalibrationSession:
    """The mirror stood still once: from the stripe at index `first` on, each frame shows the stripe before."""
    stripes = session.plates[number].scan.stripes
    late = tuple(
        dataclasses.replace(stripe, on=stripes[index - 1].on if index >= first else stripe.on)
        for index, stripe in enumerate(stripes)
    )
    return with_plate(session, number, stripes=late)
