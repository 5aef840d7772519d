"""Tests of the simulated terrain."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.simulation import Light, real_light
from guara_perception.simulation.features import MATERIALS, Box, Patch, Pit, Ramp, Rock, Stairs, Step, material_index
from guara_perception.simulation.world import WORLDS, World, load_world, parse_world
from testbed.random_world import random_world
from tests.thorough import examples

GOOD = """\
seed = 3
x = [-1, 3]
undulation = 0.005

[[pit]]          # line 5
x = 1
y = 0
size = [0.1, 0.1]
depth = 0.06

[[box]]          # line 11
x = 0.7
y = 0.1
size = [0.1, 0.08]
height = 0.04
material = "blue"

[[stairs]]       # line 18
x = 1.5
height = 0.02
count = 3
run = 0.2

[[pit]]          # line 24
x = 2
y = 0
size = [0.1, 0.1]
depth = 0.02
"""


def test_each_feature_has_its_exact_height() -> None:
    """Heights follow from the features' geometry, also 0.1 mm beside their edges, which a raster would miss."""
    world = World(
        x=(0.0, 6.0),
        features=(
            Box(x=0.5, y=0.0, size=(0.1, 0.1), height=0.04),
            Ramp(x=1.0, y=0.0, size=(0.4, 0.2), height=0.1, yaw=np.pi / 2),
            Pit(x=1.5, y=0.0, size=(0.1, 0.1), depth=0.06),
            Step(x=2.0, height=0.05),
            Box(x=2.5, y=0.0, size=(0.1, 0.1), height=0.04),
            Stairs(x=3.0, height=0.02, count=3, run=0.1, direction="down"),
        ),
    )
    x = [0.5499, 0.5501, 1.0, 1.0, 1.0, 1.5, 1.9999, 2.0, 2.5, 3.05, 3.15, 3.25, 3.9]
    y = [0.0499, 0.0, 0.0, 0.1999, -0.1, 0.04, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    wanted = [0.04, 0.0, 0.05, 0.099975, 0.025, -0.06, 0.0, 0.05, 0.09, 0.03, 0.01, -0.01, -0.01]
    np.testing.assert_allclose(world.height(x, y), wanted, atol=1e-9)


def test_a_turned_box_covers_its_turned_corners() -> None:
    """A positive yaw turns a feature counter-clockwise seen from above."""
    world = World(features=(Box(x=0.5, y=0.0, size=(0.2, 0.02), height=0.03, yaw=np.pi / 4),))
    assert world.height(0.56, 0.06) == 0.03
    assert world.height(0.56, -0.06) == 0.0


@settings(max_examples=examples(20), deadline=None, derandomize=True)
@given(seed=st.integers(0, 1000))
def test_the_raster_agrees_with_the_exact_height(seed: int) -> None:
    """The raster, which is computed in another way, holds the heights and materials of its cells' centres."""
    world = random_world(seed, boxes=4, rocks=3, length=1.5)
    heights, materials = world.raster((0.5, 1.5), (-0.4, 0.4), 0.02)
    x, y = np.meshgrid(np.arange(0.51, 1.5, 0.02), np.arange(-0.39, 0.4, 0.02))
    np.testing.assert_allclose(heights, world.height(x, y), atol=1e-12)
    np.testing.assert_array_equal(materials, world.material_at(x, y))


def test_later_features_stand_on_earlier_ones() -> None:
    """A box on a box is as high as both, and shows its own material."""
    lower = Box(x=0.5, y=0.0, size=(0.2, 0.2), height=0.03, material="brick")
    upper = Box(x=0.5, y=0.0, size=(0.1, 0.1), height=0.02, material="blue")
    world = World(features=(lower, upper))
    assert world.height(0.5, 0.0) == pytest.approx(0.05)
    assert MATERIALS[int(world.material_at(0.5, 0.0))].name == "blue"
    assert MATERIALS[int(world.material_at(0.58, 0.0))].name == "brick"
    assert MATERIALS[int(world.material_at(0.8, 0.0))].name == "soil"


def test_a_rock_rises_smoothly_from_its_rim() -> None:
    """A rock is no higher than asked for, highest inside, and flush with the ground at its rim."""
    rock = Rock(x=0.5, y=0.0, size=(0.1, 0.1), height=0.04, seed=5)
    world = World(features=(rock,))
    radius = np.linspace(0, 0.049999, 200)
    heights = world.height(0.5 + radius, np.zeros_like(radius))
    assert 0.02 < heights.max() <= 0.04 * 1.0
    assert heights[-1] < 0.001
    assert world.height(0.5505, 0.0) == 0


def test_undulation_has_the_stated_size_and_spares_the_start() -> None:
    """The ground's standard deviation is as asked for; before `flat_until` it is level."""
    world = World(x=(-1.0, 30.0), y=(-10.0, 10.0), undulation=0.01, flat_until=0.0, seed=2)
    x, y = np.meshgrid(np.linspace(0.5, 29, 300), np.linspace(-9, 9, 200))
    assert world.height(x, y).std() == pytest.approx(0.01, rel=0.15)
    assert np.abs(world.height(np.linspace(-1, 0, 50), np.zeros(50))).max() == 0


def test_a_sole_rests_on_the_highest_point_beneath_it() -> None:
    """A sole half on a box is carried by the box; beside it, by the ground."""
    world = World(features=(Box(x=0.5, y=0.0, size=(0.1, 0.1), height=0.03),))
    assert world.sole_height(0.58, 0.0, 0.08, 0.06) == pytest.approx(0.03)
    assert world.sole_height(0.60, 0.0, 0.08, 0.06) == 0


def test_random_worlds_repeat_and_leave_the_start_free() -> None:
    """A seed gives one world; nothing stands where the robot starts."""
    assert random_world(3) == random_world(3)
    assert random_world(3) != random_world(4)
    x, y = np.meshgrid(np.linspace(-1, 0.55, 60), np.linspace(-0.8, 0.8, 60))
    assert np.abs(random_world(5).height(x, y)).max() == 0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Box(x=0, y=0, size=(0.1, 0.1), height=-0.1), "height is -0.1, allowed: finite values above 0 m"),
        (lambda: Box(x=0, y=0, size=(0.1, 0.0), height=0.1), r"size is \(0.1, 0.0\), allowed: \(length, width\)"),
        (lambda: Box(x=np.nan, y=0, size=(0.1, 0.1), height=0.1), "x is nan, allowed: finite numbers"),
        (lambda: Pit(x=0, y=0, size=(0.1, 0.1), depth=0.0), "depth is 0.0, allowed: finite values above 0 m"),
        (lambda: Patch(x=0, y=0, size=(0.1, 0.1), material="tar"), "material is 'tar', allowed: soil, wood"),
        (lambda: Step(x=0, height=0.1, direction="left"), "direction is 'left', allowed: up, down"),
        (lambda: Stairs(x=0, height=0.1, count=0, run=0.1), "count is 0, allowed: an integer 1 ... 100"),
        (lambda: World(x=(1.0, 0.0)), r"x is \(1.0, 0.0\), allowed: \(low, high\)"),
        (lambda: World(seed=-1), "seed is -1, allowed: 0 or more"),
        (lambda: Rock(x=0, y=0, size=(0.1, 0.1), height=0.1, seed=-1), "seed is -1, allowed: 0 or more"),
        (lambda: World(undulation=-0.1), "undulation is -0.1, allowed: 0 ... 0.1 m"),
        (lambda: World(features=(Box(x=9, y=0, size=(0.1, 0.1), height=0.1),)), "box covers x 8.950 ... 9.050"),
        (lambda: random_world(0, rocks=-1), "rocks is -1, allowed: 0 or more"),
        (lambda: random_world(0, length=0.5), "length is 0.5 m, allowed: 1 m or more"),
        (lambda: material_index("tar"), "material is 'tar', allowed"),
    ],
)
def test_impossible_worlds_are_refused(make, message: str) -> None:
    """The message says what was given and what is allowed."""
    with pytest.raises(InvalidInput, match=message):
        make()


def test_a_world_file_is_read_in_its_order() -> None:
    """Features come in the order of the file, whatever their kinds; what is not given has its default."""
    world = parse_world(GOOD, "world.toml")
    assert [type(feature) for feature in world.features] == [Pit, Box, Stairs, Pit]
    assert world.x == (-1.0, 3.0)
    assert world.y == (-1.0, 1.0)
    assert (world.seed, world.undulation) == (3, 0.005)
    assert world.features[1] == Box(x=0.7, y=0.1, size=(0.1, 0.08), height=0.04, material="blue")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "height = 0.04",
            "height = -0.04",
            r"w.toml, line 15: \[\[box\]\]: height is -0.04, allowed: finite values above 0 m",
        ),
        ("depth = 0.02", "depth = -0.02", r"line 28: \[\[pit\]\]: depth is -0.02, allowed: finite values above 0 m"),
        ("depth = 0.02", "deep = 0.02", "line 28: unknown key 'deep'; a pit has: x, y, size, yaw, material, depth"),
        ("x = 2\n", "x = 7\n", "line 24: pit covers x 6.950 ... 7.050, .* outside the world, x -1.0 ... 3.0"),
        ("count = 3", "count = 2.5", "line 21: count is 2.5, allowed: an integer"),
        ("size = [0.1, 0.08]", "size = 0.1", "line 14: size is 0.1, allowed: two numbers"),
        ("height = 0.04\n", "", "line 11: 'height' is missing; a box needs it"),
        ('"blue"', "3", "line 16: material is 3, allowed: a string"),
        ('"blue"', '"tar"', r"line 16: \[\[box\]\]: material is 'tar', allowed: soil"),
        ("undulation = 0.005", "undulation = -1.0", "line 3: undulation is -1.0, allowed: 0 ... 0.1 m"),
        ("x = [-1, 3]", "x = [3, -1]", r"line 2: x is \(3.0, -1.0\), allowed: \(low, high\)"),
        ("seed = 3", "sed = 3", "line 1: unknown key 'sed'; a world has: x, y, .*; tables: box, ramp"),
        ("[[stairs]]", "[[stair]]", "line 18: unknown key 'stair'; a world has"),
        ("[[stairs]]", "[stairs]", r"write \[\[stairs\]\] for each stairs"),
        ("seed = 3", "seed = ", r"not a TOML file \(Invalid value \(at line 1"),
        ("seed = 3", "seed = -3", "w.toml, line 1: seed is -3, allowed: 0 or more"),
        (
            "[[stairs]]",
            "[[rock]]\nx = 1\ny = 0\nsize = [0.1, 0.1]\nheight = 0.1\nseed = -2\n[[stairs]]",
            r"w.toml, line 23: \[\[rock\]\]: seed is -2, allowed: 0 or more",
        ),
        ("seed = 3", "seed = true", "line 1: seed is True, allowed: an integer"),
    ],
)
def test_bad_world_files_are_refused_with_the_line(old: str, new: str, message: str) -> None:
    """Every mistake names the file, the line, what was given and what is allowed."""
    assert GOOD.count(old) == 1
    with pytest.raises(FileFormatError, match=message):
        parse_world(GOOD.replace(old, new), "w.toml")


def test_a_world_file_says_in_which_light_it_is_seen() -> None:
    """Effects by name, anywhere among the tables; without any it is plain light."""
    assert parse_world(GOOD, "w.toml").light == Light()
    lit = parse_world(GOOD + "\n[light]\nambient = 0.5\njpeg = 1\n", "w.toml")
    assert lit.light == real_light({"ambient": 0.5, "jpeg": 1.0})
    assert load_world("sunlit").features == load_world("demo").features
    for table, message in (
        ("[light]\nfog = 1\n", r"w.toml, line 30: \[light\]: effect is 'fog', allowed: width, skirt"),
        ("[light]\nambient = 2\n", r"line 30: \[light\]: strength of ambient is 2, allowed: 0 \.\.\. 1"),
        ("[light]\nambient = 'much'\n", "line 30: ambient is 'much', allowed: a number"),
        ("[[light]]\nambient = 1\n", r"light is \[.*\], allowed: a table \[light\] of effects and strengths"),
    ):
        with pytest.raises(FileFormatError, match=message):
            parse_world(GOOD + table, "w.toml")


def test_worlds_are_found_by_name_and_by_path(tmp_path) -> None:
    """A name finds a world of the package, a path a file; anything else is refused with the names there are."""
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    assert load_world(path) == parse_world(GOOD, "x")
    for path in WORLDS.glob("*.toml"):
        assert load_world(path.stem).features
    with pytest.raises(MissingFile, match="nowhere: no such world file; .* demo"):
        load_world("nowhere")
