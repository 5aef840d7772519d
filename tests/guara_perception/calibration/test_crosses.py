"""Crosses are fitted by exact derivatives; texture of a floor is no cross, and costs no search without end."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.app.record.simulated import SimulatedWorkshop
from guara_perception.app.targets.drawings import cross_points
from guara_perception.calibration.board import to_grey
from guara_perception.calibration.crosses import MOST_FITS, _cross_derivatives, _cross_model, find_crosses
from tests.thorough import examples

POSITIONS = np.random.default_rng(0).uniform(-1.4, 1.4, (300, 2))
SMALL = st.floats(-0.3, 0.3)


@settings(max_examples=examples(30))
@given(
    centre=st.tuples(SMALL, SMALL),
    angles=st.tuples(SMALL, SMALL),
    size=st.tuples(st.floats(0.6, 1.5), st.floats(0.05, 0.3)),
    blur=st.floats(0.05, 0.3).flatmap(lambda blur: st.sampled_from([blur, -blur])),
    light=st.tuples(st.floats(-50, 200), st.floats(0, 255), st.floats(-20, 20), st.floats(-20, 20)),
)
def test_derivatives_agree_with_finite_differences(centre, angles, size, blur, light) -> None:
    """By each of the eleven parameters."""
    p = np.array([*centre, *angles, *size, blur, *light])
    step = 1e-6 * np.eye(11)
    wanted = [(_cross_model(p + s, POSITIONS) - _cross_model(p - s, POSITIONS)) / 2e-6 for s in step]
    np.testing.assert_allclose(_cross_derivatives(p, POSITIONS), np.transpose(wanted), atol=1e-4 * max(1.0, light[0]))


@pytest.mark.slow
def test_texture_of_a_floor_is_no_cross(monkeypatch: pytest.MonkeyPatch) -> None:
    """On soil a fit to something like a cross may never converge: it is ended, and counts as no cross."""
    workshop, fits = SimulatedWorkshop(), []
    real = scipy.optimize.least_squares
    monkeypatch.setattr(scipy.optimize, "least_squares", lambda *a, **k: fits.append(real(*a, **k)) or fits[-1])
    with workshop.rangefinder as rangefinder:
        picture = rangefinder.camera.grab(60.0).image
    where = np.asarray(cross_points(workshop.robot))
    to_footprint = workshop.robot.stance_pose(workshop.stance).transform_base_to_footprint
    transform = to_footprint @ workshop.truth.transform_camera_to_base
    marks = find_crosses(to_grey(np.asarray(picture)), workshop.truth.camera, transform, where)
    endless = [fit for fit in fits if not fit.success]
    assert endless and all(fit.nfev <= MOST_FITS for fit in fits)
    assert sum(mark is not None for mark in marks) <= len(fits) - len(endless)
