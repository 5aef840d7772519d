"""Ends of runs of returns: columns beside a gap or a jump, and those that fade towards one, are not used."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.ranging.run_ends import (
    END_COLUMNS,
    FADED_OF_LEVEL,
    LEVEL_COLUMNS,
    SHORT_RUN_COLUMNS,
    run_breaks,
    run_ends,
)
from tests.thorough import examples


def ends_of(height: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Columns of one stripe that are left out."""
    return run_ends(height[None], strength[None])[0]


def test_ends_of_a_run_are_left_out() -> None:
    """Beside a gap and on both sides of a jump columns are dropped; at the picture's border none is."""
    height = np.zeros(60)
    height[20:30] = np.nan
    height[45:] = 0.02
    ends = ends_of(height, np.full(60, 100.0))
    expected = np.zeros(60, bool)
    for begin in (20 - END_COLUMNS, 30, 45 - END_COLUMNS, 45):
        expected[begin : begin + END_COLUMNS] = True
    np.testing.assert_array_equal(ends, expected)
    assert run_breaks(height[None])[0, 44]


def test_fading_end_of_a_run_is_left_out() -> None:
    """A shadow's edge weakens a stripe column by column: none is used before the strength is 0.6 of what follows."""
    height = np.zeros(60)
    height[:10] = np.nan
    strength = np.full(60, 100.0)
    strength[10:18] = [5, 8, 12, 20, 30, 40, 52, 58]
    ends = ends_of(height, strength)
    assert ends[10:16].all()
    assert not ends[20:].any()


def test_short_weak_run_is_left_out() -> None:
    """A few weak columns between gaps are left out; as strong as the others they are used."""
    height = np.zeros(80)
    height[20:30] = height[38:48] = np.nan
    strength = np.full(80, 100.0)
    strength[30:38] = 30.0
    assert ends_of(height, strength)[30:38].all()
    strength[30:38] = 100.0
    assert not ends_of(height, strength)[32:36].any()


def plainly_faded(run: list[float]) -> int:
    """Number of columns before two in a row reach 0.6 of the mean of the next twelve, by a plain loop."""
    holds = []
    for index, value in enumerate(run):
        following = run[index + 1 : index + 1 + LEVEL_COLUMNS]
        holds.append(not following or value >= FADED_OF_LEVEL * sum(following) / len(following))
    for index in range(len(run)):
        if holds[index] and (index + 1 == len(run) or holds[index + 1]):
            return index
    return len(run)


@given(data=st.data())
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_fades_of_any_length_are_found(data: st.DataObject) -> None:
    """Runs of any length, smooth or speckled: at each end those columns are left out that a plain loop finds."""
    random = np.random.default_rng(data.draw(st.integers(0, 10_000)))
    gap = 5
    runs = [random.integers(1, 256, size).astype(float) for size in random.integers(SHORT_RUN_COLUMNS, 300, 3)]
    for run in runs:
        run[:] *= np.linspace(0.0, 1.0, run.size) ** random.choice([0, 1, 4, 9])
    height, strength, expected = [np.full(gap, np.nan)], [np.zeros(gap)], [np.zeros(gap, bool)]
    for run in (np.round(run) for run in runs):
        left, right = plainly_faded(run.tolist()), plainly_faded(run[::-1].tolist())
        index = np.arange(run.size)
        expected += [
            (index < max(left, END_COLUMNS)) | (index >= run.size - max(right, END_COLUMNS)), np.zeros(gap, bool)
        ]  # fmt: skip
        height += [np.zeros(run.size), np.full(gap, np.nan)]
        strength += [run, np.zeros(gap)]
    np.testing.assert_array_equal(ends_of(np.concatenate(height), np.concatenate(strength)), np.concatenate(expected))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=examples(40), deadline=None, derandomize=True)
def test_runs_of_one_stripe_do_not_touch_the_next(seed: int) -> None:
    """Stripes with gaps, jumps and fades up to the picture's borders: together each gives what it gives alone."""
    random = np.random.default_rng(seed)
    height = np.repeat(random.choice([0.0, 0.003, 0.02, np.nan], (5, 12)), 7, axis=1)
    strength = random.choice([10.0, 40.0, 100.0], (5, 12)).repeat(7, axis=1) * random.uniform(0.5, 1, height.shape)
    height[2], height[3] = 0.0, np.nan
    for ends, *each in zip(run_ends(height, strength), height, strength, strict=True):
        np.testing.assert_array_equal(ends, ends_of(*each))
