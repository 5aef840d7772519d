"""An order of the tests in which some workers begin with those that wait, while the others compute.

A worker of xdist begins with an equal share of the tests in their order, and takes from others when it has done its
own. In the order of folders all tests that wait would come last, and the cores idle.
"""

from pathlib import Path

import pytest

# Folders whose tests wait for other programs, and for devices that keep real time; those that wait most first.
WAITING = ("transport", "drivers", "guara_perception/app")
TESTS = Path(__file__).parent


def mixed(items: list[pytest.Item], workers: int) -> list[pytest.Item]:
    """The tests in an order for this number of workers, the same in each; those of one file mostly stay together."""
    groups = workers // 2
    files: dict[str, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path.relative_to(TESTS).as_posix(), []).append(item)
    waiting = [file for folder in WAITING for file in files if file.startswith(f"{folder}/")]
    if groups < 1 or len(waiting) == len(files):
        return items
    computing = [item for file in files if file not in waiting for item in files[file]]
    begun = [[item for file in waiting[group::groups] for item in files[file]] for group in range(groups)]
    # What is left of a worker's share is filled with tests that compute.
    lacking = [max(len(items) // workers - len(tests), 0) for tests in begun]
    ordered = computing[: len(computing) - sum(lacking)]
    rest = computing[len(ordered) :]
    for tests, number in zip(begun, lacking, strict=True):
        ordered += tests + rest[:number]
        rest = rest[number:]
    return ordered
