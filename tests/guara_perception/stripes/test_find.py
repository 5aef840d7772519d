"""Search for stripes by their highest peaks: the kernel and a slow reference on small bands."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.stripes import precise
from guara_perception.stripes.band import Band, is_clipped
from guara_perception.stripes.kernel.library import memory
from tests.guara_perception.stripes.plain_light import (
    noise_gain,
    noise_of_columns,
    robust_sigma,
    sigma_of_filter,
    smooth_bins,
    smooth_light,
)

KINDS = [np.uint8, np.uint16]


def pair(
    kind: type, shape: tuple[int, ...], level: float = 120.0, sigma: float = 1.7, seed: int = 0
) -> list[np.ndarray]:
    """A slanting stripe, brightest in the last channel, on noise; and the same without it [levels of 8 bits]."""
    random = np.random.default_rng(seed)
    rows, columns = shape[:2]
    channels = shape[2] if len(shape) == 3 else 1
    distance = np.arange(rows)[:, None] - 0.4 * rows - 0.1 * np.arange(columns)
    light = level * np.exp(-0.5 * (distance / sigma) ** 2)[:, :, None] * np.linspace(0.25, 1, channels + 2)[2:]
    off = 30 + random.normal(0, 1, (rows, columns, channels))
    scale = np.iinfo(kind).max / 255
    on = off + light + random.normal(0, 1, off.shape)
    return [(scale * picture).clip(0, 255 * scale).astype(kind).reshape(shape) for picture in (on, off)]


def plain_light(on: np.ndarray, off: np.ndarray, is_fused: bool) -> np.ndarray:
    """The laser's light in its channel, the last one; or in all, weighted by headroom, signal and noise."""
    full = float(np.iinfo(on.dtype).max)
    light = on.astype(np.float64) - off
    if not is_fused:
        one = light.reshape(*light.shape[:2], -1)[:, :, -1]
        some = one[::3, :: max(one.shape[1] // 16, 1)].ravel()
        middle = np.sort(some)[some.size // 2]
        return (one - middle * (abs(middle) > full / 256)).astype(np.int16 if on.dtype == np.uint8 else np.float32)
    some = light[::8, ::24].reshape(-1, 3)
    offset = np.sort(some, axis=0)[len(some) // 2]
    deviation = np.sort(np.abs(some - offset), axis=0)[len(some) // 2]
    noise = np.maximum(1.4826 * deviation, full / 512)
    columns = np.arange(0, on.shape[1], 16)
    smooth = cv2.GaussianBlur(np.ascontiguousarray(light[:, columns, 2]), (1, 5), 0)
    columns, top = (a[smooth.max(axis=0) > 5 * noise[2]] for a in (columns, smooth.argmax(axis=0)))
    headroom = np.maximum(1 - is_clipped(on[top, columns]).mean(axis=0), 0.3)
    gain = np.maximum(np.sort(light[top, columns], axis=0)[top.size // 2] - offset - noise, 0)
    weight = headroom**2 * gain / noise**2
    share = weight * gain.max() / (weight @ gain)
    return ((light - offset) @ share).astype(np.float32)


@pytest.fixture(autouse=True)
def _highest_peaks_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable the search in any light for stripes in doubt."""
    monkeypatch.setattr(precise, "extract_in_any_light", lambda *_: pytest.fail("the band is in doubt"))


def found_in(on: np.ndarray, off: np.ndarray) -> precise.ClearStripe:
    """Stripe that the kernel found in a pair, in memory that the next pair overwrites."""
    precise.extract_precise(Band(on, off))
    return precise.ClearStripe(memory(0), on.shape[1])


def check(stripe: precise.ClearStripe, light: np.ndarray) -> None:
    """Compare rows, heights, threshold, noise and width with those of plain array operations."""
    found_sigma, found_noise = stripe.figures[5:7]
    is_peak, _, is_unsure = stripe.masks
    smooth = smooth_light(light)
    sigma = plain_sigma(smooth)
    # Once found, a wide stripe is measured again, without the light beside it.
    assert found_sigma == sigma or (sigma > 2.5 and found_sigma == pytest.approx(sigma, abs=0.6))
    searched, every = smooth, np.arange(light.shape[1])
    height = searched.max(axis=0)
    if sigma <= 2.5:
        np.testing.assert_allclose(stripe.height, height, rtol=1e-5, atol=0.01)
        np.testing.assert_allclose(searched[stripe.top, every], height, rtol=1e-5, atol=0.01)
        noise = max(robust_sigma(searched[::8, ::24]), 2.7)
    else:
        # A wide stripe is searched for in means of four rows, and measured at the highest light near the result.
        searched = smooth_bins(light, sigma)
        height, noise = searched.max(axis=0), max(robust_sigma(searched[:, ::24]), 2.7)
        assert (np.abs(stripe.top - 4 * searched.argmax(axis=0) - 2) <= 4).all()
    strong = np.sort(height[height > 5 * noise])
    threshold = max(5 * noise, 0.05 * strong[strong.size // 2])
    np.testing.assert_array_equal(is_peak, height > threshold)
    noise = noise_of_columns(light) * noise_gain(sigma_of_filter(found_sigma), 3)
    # Levels of 8 bits are whole numbers, and so are the medians of deviations.
    assert found_noise == pytest.approx(noise, rel=1e-5) or (sigma > 2.5 and 0.4 < found_noise / noise < 2.5)
    assert not is_unsure.any()


def plain_sigma(smooth: np.ndarray) -> float:
    """Width of the stripe by counting rows above half the peak, in every 32nd column."""
    widths = []
    noise = max(robust_sigma(smooth[::8, ::24]), 2.7)
    for column in np.flatnonzero(smooth.max(axis=0) > 5 * noise)[::32]:
        line = smooth[:, column].astype(float)
        top = low = up = int(line.argmax())
        while min(low, len(line) - 1) - top < 19 and line[min(low, len(line) - 1)] > line[top] / 2 and low < top + 19:
            low += 1
        while up > top - 19 and line[max(up, 0)] > line[top] / 2:
            up -= 1
        widths.append(low - up - 1)
    width = sorted(widths)[len(widths) // 2] / 2.3548
    return round(float(np.clip(np.sqrt(max(width**2 - 2 / 3, 0)), 1, 8)), 1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [(500, 90), (501, 90, 1), (600, 131, 3), (444, 40, 3)])
@pytest.mark.parametrize("sigma", [1.7, 4.0])
def test_stripes_are_those_of_plain_array_operations(kind: type, shape: tuple[int, ...], sigma: float) -> None:
    """Thin and wide ones, of one and three channels, of 8 and 16 bits."""
    on, off = pair(kind, shape, sigma=sigma)
    stripe = found_in(on, off)
    check(stripe, plain_light(on, off, is_fused=False))
    assert not stripe.masks[1].any()


def with_reflection(share: float, sigma: float) -> list[np.ndarray]:
    """A stripe and, 40 rows below it, a reflection with this fraction of its brightness."""
    (on, off), (other, dark) = (
        pair(np.uint8, (200, 240, 3), level, sigma, seed) for level, seed in ((150, 1), (150 * share, 2))
    )
    light = np.roll(other.astype(int) - dark, 40, axis=0)
    return [(on + light).clip(0, 255).astype(np.uint8), off]


def test_a_weak_reflection_all_along_is_no_doubt() -> None:
    """The highest peaks form one line, which is the stripe."""
    on, off = with_reflection(0.45, 1.5)
    rows = gp.extract_stripe(on, off).position_px
    np.testing.assert_allclose(rows, 80 + 0.1 * np.arange(240), atol=0.6)


@pytest.mark.parametrize("sigma", [1.5, 5.0])
def test_a_reflection_that_is_nearly_as_bright_is_in_doubt(sigma: float) -> None:
    """Its light rises again beside the other peak, however wide both are."""
    with pytest.raises(pytest.fail.Exception, match="in doubt"):
        gp.extract_stripe(*with_reflection(0.9, sigma))


@pytest.mark.parametrize("kind", KINDS)
def test_clipped_stripes_are_found_in_all_channels_together(kind: type) -> None:
    """Each channel counts by its headroom, signal and noise."""
    on, off = pair(kind, (400, 120, 3), level=330.0, sigma=1.5)
    stripe = found_in(on, off)
    assert stripe.masks[1].all()
    check(stripe, plain_light(on, off, is_fused=True))


@pytest.mark.parametrize("kind", KINDS)
def test_an_offset_of_the_exposure_is_subtracted(kind: type) -> None:
    """Slightly brighter surroundings are not light of the laser."""
    on, off = pair(kind, (60, 90, 3))
    brighter = (off + 6 * (np.iinfo(kind).max // 255)).astype(kind)
    check(found_in(on, brighter), plain_light(on, brighter, is_fused=False))


@pytest.mark.parametrize("kind", KINDS)
def test_noise_of_the_sensor_alone_is_no_doubt(kind: type) -> None:
    """In a pair without a stripe and with one grey level of noise, no other search is needed."""
    stripe = found_in(*pair(kind, (80, 300, 3), level=0.0))
    assert stripe.masks[0].mean() < 0.05


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("channels", [0, 1, 3])
@pytest.mark.parametrize("level", [120.0, 330.0])
def test_strides_change_nothing(kind: type, channels: int, level: float) -> None:
    """Pictures cut out of wider ones, flipped, turned, every second pixel, in one piece: the same bits."""
    shape = (400, 90) + ((channels,) if channels else ())
    expected = gp.extract_stripe(*pair(kind, shape, level))
    assert (expected.status != gp.StripeStatus.DROPOUT).all()
    for form in range(4):
        given = []
        for picture in pair(kind, shape, level):
            if form == 0:
                wide = np.full((410, 200, *shape[2:]), 99, kind)
                wide[5:405, 7:97] = picture
                given.append(wide[5:405, 7:97])
            elif form == 1:
                given.append(np.ascontiguousarray(picture[::-1, ::-1])[::-1, ::-1])
            elif form == 2:
                given.append(np.ascontiguousarray(picture.swapaxes(0, 1)).swapaxes(0, 1))
            else:
                given.append(np.repeat(picture, 2, axis=1)[:, ::2])
        found = gp.extract_stripe(*given)
        for name in ("position_px", "sigma_px", "status", "peak", "doubtful_px"):
            assert getattr(found, name).tobytes() == getattr(expected, name).tobytes(), (form, name)


@pytest.mark.parametrize("rows", [5, 9])
@pytest.mark.parametrize("columns", [1, 2, 3, 40])
def test_bands_of_few_rows_and_columns(rows: int, columns: int) -> None:
    """Light is mirrored at the edges of the band, down to a single column."""
    off = np.full((rows, columns), 20, np.uint8)
    on = off.copy()
    on[rows // 2] = 200
    stripe = found_in(on, off)
    np.testing.assert_array_equal(stripe.height, 3 * 180)
    np.testing.assert_array_equal(stripe.top, rows // 2 - 1)
