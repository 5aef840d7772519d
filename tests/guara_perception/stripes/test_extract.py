"""`extract_stripe`: refusals, and reasons for frames that cannot be used."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp

GREY = np.full((40, 60, 3), 30, dtype=np.uint8)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "magic"}, "method is 'magic', allowed: precise, paper"),
        ({"along": "diagonals"}, "along is 'diagonals', allowed: 'columns', 'rows'"),
        ({"band": (10, 12)}, r"band is \(10, 12\), it must be \(first, end\) with 8 lines or more inside 0 ... 40"),
        ({"band": (0, 41)}, "inside 0 ... 40"),
        ({"band": (-1, 30)}, "inside 0 ... 40"),
        ({"band": (0, 10, 40)}, r"band is \(0, 10, 40\)"),
        ({"band": 20}, "band is 20, it must be"),
        ({"band": "ab"}, "band is 'ab', it must be"),
        ({"band": (0, np.nan)}, "band is .*nan"),
        ({"band": (0, np.inf)}, "band is .*inf"),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments: dict, message: str) -> None:
    """The message says what was given and what is allowed."""
    with pytest.raises(gp.InvalidInput, match=message):
        gp.extract_stripe(GREY, **arguments)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ("a.png", "the picture is of type str; it must be a numpy array"),
        (GREY.astype(float), "the picture is float64"),
        (np.zeros((40, 60, 4), np.uint8), r"\(40, 60, 4\)"),
        (np.zeros((4, 60), np.uint8), "8 pixels or more each way"),
        (np.zeros((0, 0), np.uint8), "8 pixels or more each way"),
    ],
)
def test_what_is_no_picture_is_refused(frame: object, message: str) -> None:
    """Not an array, a wrong type, wrong channels, too small."""
    with pytest.raises(gp.InvalidInput, match=message):
        gp.extract_stripe(frame)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["precise", "paper"])
@pytest.mark.parametrize(
    ("on", "off", "message"),
    [
        (np.zeros_like(GREY), GREY, "blank: every pixel is 0"),
        (np.full_like(GREY, 255), GREY, "blank: every pixel is 255"),
        (
            np.where(np.arange(60)[:, None] > 5, 255, GREY).astype(np.uint8),
            GREY,
            "more than half of the searched pixels are white",
        ),
        (GREY + np.arange(60, dtype=np.uint8)[:, None], GREY[:20], "they must have the same type and shape"),
        (
            GREY + np.arange(60, dtype=np.uint8)[:, None],
            GREY.astype(np.uint16),
            "they must have the same type and shape",
        ),
        (GREY + np.arange(60, dtype=np.uint8)[:, None], "off", "laser-off frame is of type str"),
    ],
)
def test_frames_that_cannot_be_used_say_why(method: str, on: np.ndarray, off: object, message: str) -> None:
    """Black, white, another size, another type: FRAME_BAD in every column with the reason."""
    profile = gp.extract_stripe(on, off, method=method)  # type: ignore[arg-type]
    assert message in profile.reason
    assert profile.is_frame_bad
    assert (profile.status == gp.StripeStatus.FRAME_BAD).all()
    assert np.isnan(profile.position_px).all() and np.isnan(profile.sigma_px).all()
    assert profile.position_px.shape == (60,)
