"""Tests of world files."""

from __future__ import annotations

import pytest

from guara_perception.exceptions import FileFormatError, MissingFile
from guara_perception.simulation import Light, real_light
from guara_perception.simulation.features import Box, Pit, Stairs
from guara_perception.simulation.world_file import WORLDS, load_world, parse_world

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
        ("height = 0.04", "height = -0.04", r"w.toml, line 15: \[\[box\]\]: height is -0.04, it must be above 0 m"),
        ("depth = 0.02", "depth = -0.02", r"line 28: \[\[pit\]\]: depth is -0.02, it must be above 0 m"),
        ("depth = 0.02", "deep = 0.02", "line 28: unknown key 'deep'; a pit has: x, y, size, yaw, material, depth"),
        ("x = 2\n", "x = 7\n", "line 24: pit covers x 6.950 ... 7.050, .* outside the world, x -1.0 ... 3.0"),
        ("count = 3", "count = 2.5", "line 21: count is 2.5, it must be a whole number"),
        ("size = [0.1, 0.08]", "size = 0.1", "line 14: size is 0.1, it must be two numbers"),
        ("height = 0.04\n", "", "line 11: 'height' is missing; a box needs it"),
        ('"blue"', "3", "line 16: material is 3, it must be a text"),
        ('"blue"', '"tar"', r"line 16: \[\[box\]\]: material is 'tar', allowed: soil"),
        ("undulation = 0.005", "undulation = -1.0", "line 3: undulation is -1.0, it must be 0 ... 0.1 m"),
        ("x = [-1, 3]", "x = [3, -1]", r"line 2: x is \(3.0, -1.0\), it must be \(low, high\)"),
        ("seed = 3", "sed = 3", "line 1: unknown key 'sed'; a world has: x, y, .*; tables: box, ramp"),
        ("[[stairs]]", "[[stair]]", "line 18: unknown key 'stair'; a world has"),
        ("[[stairs]]", "[stairs]", r"write \[\[stairs\]\] for each stairs"),
        ("seed = 3", "seed = ", r"not a TOML file \(Invalid value \(at line 1"),
        ("seed = 3", "seed = true", "line 1: seed is True, it must be a whole number"),
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
        ("[light]\nambient = 2\n", r"line 30: \[light\]: strength of ambient is 2, it must be 0 \.\.\. 1"),
        ("[light]\nambient = 'much'\n", "line 30: ambient is 'much', it must be a number"),
        ("[[light]]\nambient = 1\n", r"write \[light\], and below it an effect and its strength in each line"),
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
