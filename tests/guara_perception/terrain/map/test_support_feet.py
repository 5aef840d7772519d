"""Filter that corrects the height of the walk by the soles that stand on the map."""

from __future__ import annotations

import numpy as np
import pytest

from guara_perception.terrain.map.support_feet import HeightAnchor, SoleError


def soles(*residuals: float, sigma: float = 0.001) -> dict[str, SoleError]:
    """Errors of soles, one leg for each residual [m]."""
    return {f"leg{i}": SoleError(residual, sigma**2) for i, residual in enumerate(residuals)}


def test_without_soles_the_variance_is_that_of_odometry() -> None:
    """Nothing is corrected, and cells gain the whole variance of odometry's drift."""
    anchor = HeightAnchor()
    for step in range(1, 6):
        anchor = anchor.after(step * 1e-6, {})
    assert anchor.offset == 0.0
    assert anchor.variance == pytest.approx(5e-6)
    assert anchor.rise == pytest.approx(5e-6)


def test_a_common_error_is_taken_off() -> None:
    """Soles 4 mm above the map, with a much less certain odometry: nearly 4 mm are corrected."""
    anchor = HeightAnchor().after(1e-4, soles(0.004, 0.004, 0.004, 0.004))
    assert anchor.offset == pytest.approx(-0.004, rel=0.01)
    assert anchor.variance == pytest.approx(1 / (1 / 1e-4 + 4 / 1e-6), rel=1e-9)
    assert anchor.rise < 0.01 * 1e-4
    assert anchor.rejected == ()


def test_several_soles_weigh_as_their_mean() -> None:
    """Opposite errors cancel: a tilt of the body is not an error of its height."""
    anchor = HeightAnchor().after(1e-4, soles(0.002, -0.002, 0.002, -0.002))
    assert anchor.offset == pytest.approx(0.0, abs=1e-4)


def test_a_sole_far_off_is_left_out_and_named() -> None:
    """One foot stands on something that is not in the map: only the other three count."""
    anchor = HeightAnchor().after(1e-6, soles(0.001, 0.030, 0.001, 0.001))
    assert anchor.rejected == ("leg1",)
    assert -0.001 < anchor.offset < 0.0


def test_a_random_walk_is_followed() -> None:
    """Odometry drifts by 0.5 mm per pause for 200 pauses, beyond 3 mm; soles keep the error below 0.6 mm."""
    rng = np.random.default_rng(0)
    anchor, drift, errors, raw = HeightAnchor(), 0.0, [], []
    for step in range(1, 201):
        drift += rng.normal(0, 0.0005)
        readings = rng.normal(drift + anchor.offset, 0.001, 4)
        anchor = anchor.after(step * 0.0005**2, soles(*readings))
        errors.append(drift + anchor.offset)
        raw.append(drift)
    assert np.sqrt(np.mean(np.square(errors))) < 0.0006
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.sqrt(anchor.variance), rel=0.4)
    assert np.abs(raw).max() > 0.003


def test_a_shrinking_covariance_is_no_growth() -> None:
    """A decrease of odometry's variance adds nothing; later growth counts from the largest value."""
    anchor = HeightAnchor().after(4e-6, {}).after(1e-6, {}).after(5e-6, {})
    assert anchor.variance == pytest.approx(5e-6)
