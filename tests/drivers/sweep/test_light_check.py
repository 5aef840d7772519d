"""Clipped or dark light in the first frames of a scan."""

from __future__ import annotations

import numpy as np
import pytest

from drivers import Image, LightCheck, StripeCapture, StripeVerdict

HEIGHT, WIDTH = 240, 320


def capture(on: Image | None, off: Image | None) -> StripeCapture:
    return StripeCapture(
        index=0,
        mirror_angle=0.0,
        mirror_angle_reached=0.0,
        on=on,
        off=off,
        on_stamp=0.0,
        off_stamp=0.0,
        verdict=StripeVerdict.OK,
        evidence=None,
    )


def stripe(level: float, background: float = 40.0, clipped_columns: float = 0.0) -> StripeCapture:
    """Stripe of this grey level in the middle of the image."""
    rng = np.random.default_rng(1)
    off = np.clip(background + rng.normal(0, 1.0, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)
    on = off.copy()
    on[118:122, :, 2] = level
    on[118:122, : round(clipped_columns * WIDTH), 2] = 255
    return capture(on, off)


def problems(*captures: StripeCapture) -> tuple[str, ...]:
    check = LightCheck()
    for each in captures:
        check.look(each, (80, 160))
    return check.problems


@pytest.mark.parametrize("good", [stripe(180.0), stripe(60.0), stripe(200.0, clipped_columns=0.7), stripe(40.0, 5.0)])
def test_usable_light_is_not_reported(good: StripeCapture) -> None:
    assert problems(good, good) == ()


@pytest.mark.parametrize(
    ("bad", "expected_text"),
    [
        (stripe(255.0), "light: 100 % of the stripe is clipped: expose less or close the iris (`guara record` meters"),
        (stripe(20.0, 3.0), "light: the stripe is at 8 % of the full scale, too dark: expose longer, open the iris"),
    ],
)
def test_a_clipped_and_a_dark_stripe_are_reported_once(bad: StripeCapture, expected_text: str) -> None:
    (reported,) = problems(bad, bad, bad)
    assert reported.startswith(expected_text) and "writes it to devices.toml" in reported


def test_a_picture_that_is_clipped_without_the_laser_is_reported() -> None:
    """A window over a fifth of the image is reported, a lamp over a hundredth is not; in `off` or `on`."""
    good = stripe(180.0)
    for of_rows, is_reported in ((HEIGHT // 5, True), (HEIGHT // 100, False)):
        on, off = good.on.copy(), good.off.copy()
        on[:of_rows] = off[:of_rows] = 255
        for seen in (capture(on, off), capture(on, None)):
            reported = problems(seen)
            assert len(reported) == is_reported
            assert not reported or reported[0].startswith("light: 20 % of the picture is clipped without the laser")


def test_a_stripe_that_shows_no_laser_is_passed_over() -> None:
    """A hole, a lost frame, and a band outside the image give no result; the next stripe is examined."""
    hole = capture(stripe(180.0).off, stripe(180.0).off)
    assert problems(capture(None, None), hole, stripe(255.0)) != ()
    assert problems(hole, hole, hole) == ()
    check = LightCheck()
    check.look(stripe(255.0), (0, 0))
    assert check.problems == ()
    check.look(stripe(255.0), (80, 160))
    assert check.problems != ()


def test_later_stripes_are_not_looked_at() -> None:
    assert problems(stripe(180.0), stripe(255.0)) == ()
