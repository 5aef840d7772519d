"""The matrix of mirrored and turned sessions and scans."""

import re

import pytest

import guara_perception as gp
from benchmarks.mirrored import outcomes
from benchmarks.misplaced_crosses import DATA
from guara_perception.app.files.calibration_session import open_session
from kinematics import load_robot

SCANS = {
    "left-right": "grid degraded: .*mirrored left to right",
    "up-down": "grid degraded: .*frames are flipped top to bottom",
    "both axes": "grid degraded: .*frames are turned by 180 degrees",
    "turn 90": "refused: .*frames are turned by 90 degrees",
}
# By whether the colours of the board are known.
SESSIONS = {
    "left-right": ("calibration usable.*look the same in mirrored pictures", "refused: .*pictures are mirrored"),
    "up-down": ("refused: .*rolled by 180 degrees.*bottom-up", "refused: .*pictures are mirrored"),
    "both axes": ("refused: .*rolled by 180 degrees.*upside down", "calibration usable.*rolled by 180 degrees"),
    "turn 90": ("refused: .*crosses is turned by 90 degrees",) * 2,
}


@pytest.mark.heavy
def test_no_mirrored_grid_is_called_good() -> None:
    """Each case is told by name, and no grid of any of them is called good."""
    session, scan = open_session(DATA / "calibration"), gp.open_scan(DATA / "scans" / "paper")
    made = {outcome.case: outcome for outcome in outcomes(session, scan, load_robot("guara"))}
    assert not any(outcome.is_called_good for outcome in made.values())
    for known, kind in enumerate(("", ", first square white")):
        for change, expected in SCANS.items():
            assert re.search(expected, made.pop(f"scan {change}{kind}").said), change
        for change, both in SESSIONS.items():
            assert re.search(both[known], made[f"session {change}{kind}"].said), change
    assert {case for case, outcome in made.items() if outcome.is_mirrored} == {"session left-right", "both left-right"}
