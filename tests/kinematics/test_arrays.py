"""Read-only arrays cannot be written through any reference to their memory."""

from __future__ import annotations

import numpy as np
import pytest

from kinematics.arrays import read_only


def test_result_cannot_be_written():
    """Writing to the result raises an error."""
    frozen = read_only(np.zeros(3))
    with pytest.raises(ValueError, match="read-only"):
        frozen[0] = 1


def test_the_callers_array_stays_writable_and_apart():
    """Neither the given array nor an earlier view of it can change the result."""
    given = np.zeros(4)
    view = given[1:]
    frozen = read_only(given)
    given[0] = 1
    view[0] = 2
    np.testing.assert_array_equal(frozen, 0)


def test_read_only_view_of_writable_memory_is_copied():
    """A read-only view of writable memory is copied."""
    memory = np.zeros(4)
    view = memory[:]
    view.setflags(write=False)
    frozen = read_only(view)
    memory[0] = 1
    np.testing.assert_array_equal(frozen, 0)


def test_frozen_arrays_are_not_copied_again():
    """A frozen array is not copied again, nor is an array over bytes."""
    frozen = read_only(np.zeros(4))
    assert read_only(frozen) is frozen
    assert read_only(frozen[1:]).base is frozen
    over_bytes = np.frombuffer(b"\x01\x02", dtype=np.uint8)
    assert read_only(over_bytes) is over_bytes


def test_array_over_a_bytearray_is_copied():
    """Memory that other objects can write does not count as frozen."""
    memory = bytearray(2)
    over = np.frombuffer(memory, dtype=np.uint8)
    over.setflags(write=False)
    frozen = read_only(over)
    memory[0] = 9
    np.testing.assert_array_equal(frozen, 0)


@pytest.mark.parametrize("dtype", [np.float32, np.uint16, np.uint8, np.bool_])
def test_type_shape_and_values_stay(dtype: type):
    """Freezing preserves type, shape and values."""
    given = np.arange(6).reshape(2, 3).astype(dtype)
    frozen = read_only(given.T)
    assert frozen.dtype == dtype
    np.testing.assert_array_equal(frozen, given.T)
