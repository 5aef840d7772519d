"""Verification of frames against commands."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import ProofLimits, StripeVerdict
from drivers.sweep.proof import StripeProof, _SampleGrid
from tests.thorough import examples

HEIGHT, WIDTH = 200, 320


@cache
def noise(seed: int) -> np.ndarray:
    """Noise of a frame, drawn once."""
    return np.random.default_rng(seed).normal(0.0, 2.0, (HEIGHT, WIDTH, 3))


def scene(
    row: int | None, *, channel: int = 2, seed: int = 0, columns: slice = slice(None), level: int = 40
) -> np.ndarray:
    image = level + noise(seed)
    if row is not None:
        image[row - 1 : row + 2, columns, channel] += 120
    return image.clip(0, 255).astype(np.uint8)


OFF = scene(None, seed=99)


def judge(proof: StripeProof, angle: float, on: np.ndarray, off: np.ndarray = OFF, **more: object):
    return proof.judge(angle, on, off, reference_is_off=True, **more)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_a_stripe_of_any_colour_is_seen_where_it_is(channel: int) -> None:
    """Lit in every column, at its row, without a leak."""
    verdict, evidence = judge(StripeProof(), 0.0, scene(77, channel=channel))
    assert verdict is StripeVerdict.OK
    assert evidence.lit_fraction == 1.0 and evidence.leak_fraction == 0.0
    assert evidence.row == pytest.approx(77, abs=1.5)
    assert evidence.contrast == pytest.approx(120, abs=15)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("colour", [True, False])
def test_depth_and_colour_of_the_picture_do_not_matter(dtype: type, colour: bool) -> None:
    """8 or 16 bits, colour or grey."""
    on, off = scene(50), OFF
    if not colour:
        on, off = on[:, :, 2], off[:, :, 2]
    factor = 257 if dtype is np.uint16 else 1
    on, off = on.astype(dtype) * dtype(factor), off.astype(dtype) * dtype(factor)
    assert judge(StripeProof(), 0.0, on, off)[0] is StripeVerdict.OK
    assert judge(StripeProof(), 0.0, off, off)[0] is StripeVerdict.DARK


@pytest.mark.parametrize("seed", range(20))
def test_noise_is_never_taken_for_the_laser(seed: int) -> None:
    """Two frames without the laser give DARK, whatever the noise."""
    verdict, evidence = judge(StripeProof(), 0.0, scene(None, seed=seed))
    assert verdict is StripeVerdict.DARK and evidence.lit_fraction == 0.0


def test_strong_noise_raises_the_threshold() -> None:
    """Noise far above the minimum contrast does not count as laser."""
    rng = np.random.default_rng(5)
    on, off = (rng.normal(100, 12, (HEIGHT, WIDTH, 3)).clip(0, 255).astype(np.uint8) for _ in range(2))
    assert judge(StripeProof(), 0.0, on, off)[0] is StripeVerdict.DARK


def test_a_stripe_in_a_few_columns_counts_as_seen() -> None:
    """Most of the ground may absorb the laser."""
    assert judge(StripeProof(), 0.0, scene(60, columns=slice(0, 32)))[0] is StripeVerdict.OK


def test_stripe_in_the_off_frame_is_a_leak() -> None:
    """A laser that is on in the off frame is detected, at another row or in the same columns."""
    assert judge(StripeProof(), 0.0, scene(60), scene(90, seed=3))[0] is StripeVerdict.LEAK
    assert judge(StripeProof(), 0.0, scene(None, seed=2), scene(90, seed=3))[0] is StripeVerdict.LEAK


def test_changed_light_is_reported_but_usable() -> None:
    """A stripe is found although the whole frame became brighter."""
    verdict, evidence = judge(StripeProof(), 0.0, scene(60, level=70))
    assert verdict is StripeVerdict.AMBIENT_CHANGED and verdict.in_step
    assert evidence.offset == pytest.approx(90, abs=3)


@pytest.mark.parametrize(("band", "verdict"), [((70, 90), "OK"), ((100, 150), "OUT_OF_BAND"), ((0, 77), "OUT_OF_BAND")])
def test_band_is_where_the_stripe_must_be(band: tuple[int, int], verdict: str) -> None:
    """A band includes its first row, but not its end."""
    assert judge(StripeProof(), 0.0, scene(80), band=band)[0] is StripeVerdict[verdict]


@pytest.mark.parametrize("direction", [1, -1])
def test_a_frame_one_stripe_late_is_found(direction: int) -> None:
    """A stripe at the place of the previous one has not moved; afterwards the sweep continues."""
    proof = StripeProof()
    verdicts = []
    for turn, seen in enumerate([0, 1, 2, 3, 4, 4, 6, 7]):
        row = 100 + direction * 8 * (seen - 4)
        verdicts.append(judge(proof, 0.01 * turn, scene(row, seed=turn))[0].name)
    assert verdicts == ["OK"] * 5 + ["NOT_MOVED"] + ["OK"] * 2


def test_a_mirror_that_stops_stays_found() -> None:
    """Every stripe after the mirror jammed is out of step, not only the first one."""
    proof = StripeProof()
    names = [judge(proof, 0.01 * turn, scene(40 + 8 * min(turn, 3), seed=turn))[0].name for turn in range(8)]
    assert names == ["OK"] * 4 + ["NOT_MOVED"] * 4


@pytest.mark.parametrize("edges", [(30, 33), (170, 40)])
def test_a_few_columns_that_are_no_stripe_make_no_later_one_look_stuck(edges: tuple[int, int]) -> None:
    """Edges of a moving scene in a dark stripe do no harm; a mirror that stops afterwards is detected."""
    proof, rows = StripeProof(), range(60, 180, 10)
    for number, row in enumerate(rows):
        on = scene(row, seed=number)
        if row == 110:
            on = scene(edges[0], columns=slice(0, 12), seed=number)
            on[edges[1], 12:20] = 255
        verdict = judge(proof, 0.01 * number, on)[0]
        assert row == 110 or verdict is StripeVerdict.OK, row
    assert judge(proof, 0.01 * len(rows), scene(rows[-1]))[0] is StripeVerdict.NOT_MOVED


@pytest.mark.parametrize("columns", [slice(0, 32), slice(None)])
def test_a_mirror_that_stops_on_dark_ground_is_found(columns: slice) -> None:
    """Stripes in a tenth of the columns are compared with each other, not with the last full one."""
    proof = StripeProof()
    for number in range(4):
        assert judge(proof, 0.01 * number, scene(60 + 10 * number))[0] is StripeVerdict.OK
    for number in range(4, 12):
        assert judge(proof, 0.01 * number, scene(60 + 10 * number, columns=columns))[0] is StripeVerdict.OK
    assert judge(proof, 0.12, scene(170, columns=columns))[0] is StripeVerdict.NOT_MOVED


def test_the_sweep_back_to_the_stripes_between_is_in_step() -> None:
    """A jump back of the mirror moves the stripe back, which is no fault."""
    proof = StripeProof()
    for turn, index in enumerate([0, 2, 4, 6, 8, 1, 3, 5, 7]):
        assert judge(proof, 0.01 * index, scene(40 + 6 * index, seed=turn))[0] is StripeVerdict.OK


def test_without_off_frames_the_stripe_before_is_the_reference() -> None:
    """The previous stripe in the reference is no leak."""
    proof = StripeProof()
    frames = [scene(40 + 10 * turn, seed=turn) for turn in range(6)]
    for turn in range(1, 6):
        verdict, evidence = proof.judge(0.01 * turn, frames[turn], frames[turn - 1], reference_is_off=False)
        assert verdict is StripeVerdict.OK and evidence.leak_fraction == 0.0
        assert evidence.row == pytest.approx(40 + 10 * turn, abs=1.5)


def test_limits_can_be_set() -> None:
    """A weak laser needs a lower contrast."""
    weak = scene(None, seed=4)
    weak[80:83, :, 2] += 40
    assert judge(StripeProof(ProofLimits(noise_factor=30.0)), 0.0, weak)[0] is StripeVerdict.DARK
    assert judge(StripeProof(), 0.0, weak)[0] is StripeVerdict.OK


@given(
    st.tuples(st.integers(1, 1100), st.integers(1, 1400)),
    st.sampled_from([np.uint8, np.uint16]),
    st.sampled_from(["colour", "grey", "part of a frame", "read-only"]),
    st.integers(0, 400),
)
@settings(max_examples=examples(40), derandomize=True, deadline=None)
def test_light_is_the_sum_of_the_channels_where_it_is_sampled(
    size: tuple[int, int], dtype: type, kind: str, first: int
) -> None:
    """For images of every size, depth and memory layout."""
    rng = np.random.default_rng(first)
    image = rng.integers(0, np.iinfo(dtype).max, (*size, 3), dtype=dtype, endpoint=True)
    if kind == "grey":
        image = image[..., 1].copy()
    elif kind == "part of a frame":
        image = image[::2, : max(1, size[1] - 3)]
    elif kind == "read-only":
        image.setflags(write=False)
    grid = _SampleGrid.of(image)
    total = image.astype(np.int64) if image.ndim == 2 else image.astype(np.int64).sum(axis=2)
    np.testing.assert_array_equal(grid.light(image), total[:: grid.row_stride, :: grid.column_stride])
    rows = (first // grid.row_stride, (first + 50) // grid.row_stride)
    expected = total[:: grid.row_stride, :: grid.column_stride][rows[0] : rows[1]]
    np.testing.assert_array_equal(grid.light(image, rows), expected)


def band_of(row: int) -> tuple[int, int]:
    return max(row - 25, 0), min(row + 25, HEIGHT)


@pytest.mark.slow
@given(st.lists(st.integers(30, 170), min_size=2, max_size=8), st.integers(0, 10))
@settings(max_examples=examples(25), derandomize=True)
def test_the_band_alone_shows_what_the_whole_frame_shows(rows: list[int], seed: int) -> None:
    """With one off frame, band and whole frame give equal verdict, row, contrast, offset and shift."""
    in_band, whole = StripeProof(), StripeProof()
    for turn, row in enumerate(rows):
        on = scene(row, seed=seed + turn)
        angle = 0.001 * row
        verdict, evidence = judge(in_band, angle, on, band=band_of(row))
        # With a new off frame each time, nothing is known about the off frame.
        expected, of_whole = judge(whole, angle, on, OFF.copy(), band=band_of(row))
        assert verdict is expected
        assert evidence == of_whole


def test_light_in_the_off_frame_is_found_however_late_it_shows() -> None:
    """Hidden behind the first stripe and detected with the second, it counts for all further stripes."""
    off = scene(80, seed=99, columns=slice(0, 150))
    proof, names = StripeProof(), []
    for turn, row in enumerate([80, 90, 150, 160]):
        names.append(judge(proof, 0.01 * turn, scene(row, seed=turn), off, band=band_of(row))[0].name)
    assert names == ["OK", "LEAK", "LEAK", "LEAK"]
    assert judge(proof, 0.05, scene(170, seed=7), OFF, band=band_of(170))[0] is StripeVerdict.OK


@pytest.mark.parametrize(
    ("row", "name"),
    [(None, "DARK"), (30, "OUT_OF_BAND"), (190, "OUT_OF_BAND"), (80, "OUT_OF_BAND"), (118, "NOT_MOVED")],
)
def test_a_stripe_that_is_not_in_its_band_is_looked_for_everywhere(row: int | None, name: str) -> None:
    """It is found at any distance; the next stripe in its band is in step again."""
    proof = StripeProof()
    for turn in range(5):
        seen = 86 + 8 * turn
        assert judge(proof, 0.01 * turn, scene(seen, seed=turn), band=band_of(seen))[0] is StripeVerdict.OK
    assert judge(proof, 0.05, scene(row, seed=8), band=(110, 170))[0].name == name
    assert judge(proof, 0.06, scene(134, seed=9), band=band_of(134))[0] is StripeVerdict.OK


def test_a_stripe_in_few_columns_of_its_band_is_outvoted_by_a_brighter_one_elsewhere() -> None:
    """With few lit columns in the band, the rest of the image is compared too."""
    proof = StripeProof()
    for turn in range(4):
        seen = 86 + 8 * turn
        judge(proof, 0.01 * turn, scene(seen, seed=turn), band=band_of(seen))
    on = scene(118, seed=8, columns=slice(0, 100))
    on[30:33, :, 2] = 250
    assert judge(proof, 0.04, on, band=band_of(118))[0] is StripeVerdict.OUT_OF_BAND
