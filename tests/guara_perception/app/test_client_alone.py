"""guara-client alone: the same answers to the last bit, and a one-line error for what it does not include."""

import dataclasses
import importlib.metadata
import json
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import guara_perception as gp
import hatch_build
from kinematics.stance_pose import support_soles
from tests import client_alone
from tests.client_alone import answers
from tests.frozen import FROZEN, GRIDS
from tests.thorough import examples

pytestmark = pytest.mark.slow

NODE = Path(__file__).with_name("publishing_node.py")
LIBRARIES = Path(np.__file__).parents[1]


def brought() -> set[str]:
    """Distributions that guara-client installs: its dependencies, recursively."""
    project = tomllib.loads((hatch_build.CLIENT / "pyproject.toml").read_text())["project"]
    left, found = list(project["dependencies"]), set()
    while left:
        wanted = Requirement(left.pop())
        name = canonicalize_name(wanted.name)
        if name not in found and (wanted.marker is None or wanted.marker.evaluate({"extra": ""})):
            found.add(name)
            left += importlib.metadata.requires(name) or []
    return found


def hidden() -> list[str]:
    """Modules of the test environment that guara-client does not install."""
    kept = brought()
    owners = importlib.metadata.packages_distributions()
    return [top for top, names in owners.items() if not {canonicalize_name(name) for name in names} & kept]


def some_grids() -> Iterator[gp.TerrainGrid]:
    """Frozen grids, one with a standing robot, and many small ones with boxes, holes and unknown ground."""
    for name in GRIDS:
        yield gp.load_terrain(FROZEN / f"{name}.npz")
    yield standing_ground()
    for seed in range(examples(500) - len(GRIDS) - 1):
        rng = np.random.default_rng(seed)
        heights = rng.uniform(-0.1, 0.1) * np.linspace(0, 1, 50)[:, None] * np.ones((50, 60))
        for _ in range(int(rng.integers(0, 5))):
            iy, ix = rng.integers(0, 45, 2)
            heights[iy : iy + 6, ix : ix + 8] = rng.choice([0.02, 0.05, -0.03, np.nan])
        variance = np.full(heights.shape, rng.choice([1e-7, 1e-6]))
        yield gp.assess_terrain(heights, 0.01, origin=(0.45, -0.25), variance=variance)


def standing_ground() -> gp.TerrainGrid:
    """Level ground around a standing robot, unknown below its soles."""
    robot = gp.load_robot("guara")
    stance = gp.Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    heights = np.zeros((140, 200))
    soles = support_soles(pose, robot.noise)
    for x, y in (sole[0, :2] for sole in soles.values()):
        iy, ix = int((y + 0.35) / 0.005), int((x + 0.4) / 0.005)
        heights[iy - 3 : iy + 4, ix - 4 : ix + 5] = np.nan
    terrain = gp.assess_terrain(heights, 0.005, origin=(-0.4, -0.35), variance=np.full(heights.shape, 1e-7))
    to_footprint = np.asarray(pose.transform_base_to_footprint)
    stands = {"robot": "guara", "stance": stance, "transform_base_to_footprint": to_footprint, "support_soles": soles}
    grid = dataclasses.replace(terrain, record=dataclasses.replace(terrain.record, **stands))
    assert all(grid.swing(sole[0], (sole[0, 0] + 0.14, sole[0, 1], 0.0), 0.02).ok for sole in soles.values())
    return grid


@pytest.fixture(scope="module")
def said(start, module_endpoint: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[list, list]:
    """Answers of this process and of the client alone, with a node that publishes the frozen scan of boxes."""
    folder = tmp_path_factory.mktemp("client")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=hatch_build.CLIENT, check=True, capture_output=True)
    site, grids = folder / "site", folder / "grids"
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as archive:
        archive.extractall(site)
    grids.mkdir()
    mine = []
    for number, terrain in enumerate(some_grids()):
        terrain.save(grids / f"{number:03}.npz")
        mine.append(answers(gp.load_terrain(grids / f"{number:03}.npz"), 0, folder))
    node = start(NODE, module_endpoint, "guara", FROZEN / "paper.npz")
    assert node.line() == "ready"
    node.tell("publish 1")
    arguments = [client_alone.__file__, str(site), str(LIBRARIES), json.dumps(hidden()), str(grids), module_endpoint]
    done = subprocess.run([sys.executable, "-I", "-S", *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return mine, [json.loads(line) for line in done.stdout.splitlines()]


def test_answers_are_those_of_the_whole(said: tuple[list, list]):
    """Every query without a leg, on every grid, to the last bit."""
    mine, its = said
    assert len(mine) == examples(500)
    for number, answer in enumerate(mine):
        assert its[number] == answer, number


def test_a_node_is_asked_in_every_way(said: tuple[list, list]):
    """wait_for_step, latest, query and stream return the grid that the node published."""
    mine, its = said
    received = its[len(mine) : len(mine) + 4]
    assert received == [received[0]] * 4
    paper = mine[GRIDS.index("paper")]
    same = set(paper) - {"save", "repr"}
    assert {name: received[0][name] for name in same} == {name: paper[name] for name in same}


def test_what_is_missing_says_what_to_install(said: tuple[list, list]):
    """A public name, a robot, and the reach of a leg: one line each."""
    lines = said[1][-3:]
    assert all(re.fullmatch(r"[^\n]*pip install guara-perception[^\n]*", line) for line in lines), lines


def test_heavy_libraries_are_hidden():
    """Without hidden libraries, the other tests would prove nothing."""
    assert {"scipy", "matplotlib", "mcap", "cryptography", "usb"} <= set(hidden())
    assert not {"numpy", "zenoh", "rosbags"} & set(hidden())
