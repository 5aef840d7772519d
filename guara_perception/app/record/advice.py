"""Advice after a refused calibration on what to correct or record again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from guara_perception.app.record.session_writer import PLAN_FILE
from guara_perception.exceptions import CalibrationRefused

# Advice by a phrase in the text of the error; the first phrase found counts.
ADVICE = (
    ("wrong square size", "measure a square of the board and run `guara calibrate {session} -o {out} --square METRES`"),
    (
        "heights look swapped",
        "exchange the heights in {session}/session.json and run `guara calibrate {session} -o {out}`, or "
        "run `guara record {session} --redo plates`",
    ),
    (
        "plate",
        "run `guara record {session} --redo plates`, or correct a height in {session}/session.json and run "
        "`guara calibrate {session} -o {out}`",
    ),
    ("fiducial", "run `guara record {session} --redo crosses`"),
    ("crosses", "run `guara record {session} --redo crosses`"),
    ("board", "run `guara record {session} --redo board`"),
)


@contextmanager
def with_advice(session: Path) -> Iterator[None]:
    """Add advice to a CalibrationRefused that the block raises, if the session folder contains recording.json.

    Raises:
        CalibrationRefused: the error of the block, with advice if there is any.
    """
    try:
        yield
    except CalibrationRefused as error:
        advice = next((advice for word, advice in ADVICE if word in str(error)), "")
        if not advice or not (session / PLAN_FILE).is_file():
            raise
        remedy = advice.format(session=session, out=session / "calibration.json")
        raise CalibrationRefused(f"{error}; to continue without recording everything again, {remedy}") from None
