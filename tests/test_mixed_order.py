"""The order of the tests for several workers: none is lost, and some workers begin with those that wait."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.mixed_order import TESTS, mixed

FOLDERS = {"drivers": 30, "guara_perception/app": 30, "guara_perception/terrain": 60, "kinematics": 40, "transport": 20}


def some_tests() -> list[Any]:
    """Ten tests to a file."""
    return [
        SimpleNamespace(path=TESTS / folder / f"test_{number // 10}.py", number=number)
        for folder, count in FOLDERS.items()
        for number in range(count)
    ]


def folder_of(test: Any) -> str:
    """The folder that a worker would find the test in."""
    return Path(test.path).parent.relative_to(TESTS).as_posix()


@pytest.mark.parametrize("workers", [1, 2, 5, 6])
def test_no_test_is_lost_or_run_twice(workers: int) -> None:
    """Whatever the number of workers."""
    tests = some_tests()
    ordered = mixed(list(tests), workers)
    assert sorted(map(id, ordered)) == sorted(map(id, tests))


def test_half_of_the_workers_begin_with_tests_that_wait() -> None:
    """Of six workers with 30 tests each three begin so, those that wait most first; the others compute."""
    ordered = mixed(some_tests(), 6)
    shares = [[folder_of(test) for test in ordered[begin : begin + 30]] for begin in range(0, 180, 30)]
    assert all(set(share) <= {"kinematics", "guara_perception/terrain"} for share in shares[:3])
    assert [share[0] for share in shares[3:]] == ["transport", "transport", "drivers"]
    assert {folder for share in shares[3:] for folder in share} >= {"transport", "drivers", "guara_perception/app"}


def test_one_worker_and_one_folder_keep_their_order() -> None:
    """There is nothing to mix."""
    tests = some_tests()
    assert mixed(tests, 1) is tests
    waiting = [test for test in tests if folder_of(test) == "transport"]
    assert mixed(waiting, 6) is waiting
