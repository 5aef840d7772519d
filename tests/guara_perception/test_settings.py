"""What perception reads from robot.toml: the Guará's values, and every refusal."""

from __future__ import annotations

from pathlib import Path

import pytest

import guara_perception as gp
from guara_perception.settings import Settings
from guara_perception.terrain.layers.record import limits_to_dict
from kinematics import RobotModel, load_robot
from testbed.altered_robot import altered_guara


def test_areas_and_patterns_of_the_guara(robot: RobotModel) -> None:
    """Extents, resolution and patterns are those that the documents promise."""
    settings = Settings.of(robot)
    assert (settings.footprint_x, settings.footprint_y) == ((0.50, 0.95), (-0.27, 0.27))
    assert (settings.map_x, settings.map_y) == ((-0.60, 1.00), (-0.35, 0.35))
    assert settings.resolution == 0.005
    assert list(settings.pattern("standard")) == list(range(70))
    assert list(settings.pattern("coarse")) == list(range(0, 70, 2))
    with pytest.raises(gp.InvalidInput, match="mode is 'fine', allowed: coarse, standard"):
        settings.pattern("fine")


def test_settings_are_read_once_of_each_robot(robot: RobotModel, tmp_path: Path) -> None:
    """The same robot gives the same object; another one of the same name its own."""
    assert Settings.of(robot) is Settings.of(robot)
    altered = altered_guara(tmp_path, ("stripes = 70", "stripes = 60"))
    assert Settings.of(load_robot(altered)).stripes == 60
    assert Settings.of(robot).stripes == 70


def test_the_edge_costs_60_mm_at_most(robot: RobotModel) -> None:
    """Half a sole, the disc and one cell: more would take too much of the scanned area."""
    settings = Settings.of(robot)
    limits = settings.limits
    assert limits.sole_length / 2 + limits.disc_radius + settings.resolution <= 0.060 + 1e-12


def test_limits_go_through_plain_values(robot: RobotModel) -> None:
    """The limits read from a grid's metadata equal those that were written to it."""
    limits = Settings.of(robot).limits
    assert gp.TraversabilityLimits(**limits_to_dict(limits)) == limits


@pytest.mark.parametrize(
    ("line", "instead", "message"),
    [
        (
            "resolution = 0.005",
            "resolution = 0.0",
            r"robot.toml:\d+: \[grid\] resolution is 0.0; a number of 0.0001 or more and at most 0.1",
        ),
        ("resolution = 0.005", 'resolution = "5 mm"', r"\[grid\] resolution is '5 mm'"),
        ("x = [0.50, 0.95]", "x = [0.95, 0.50]", "the first below the second"),
        ("x = [0.50, 0.95]", "x = [0.50]", r"\[grid.footprint\] x is \[0.5\]; a list of two numbers"),
        (
            "slope_limit = 0.35",
            "slope_limit = 20.0",
            r"\[traversability\] slope_limit is 20.0; a number above 0 and at most 1.571",
        ),
        ("drop_limit = 0.020", "", r"\[traversability\] drop_limit is missing"),
        ("pauses = 40", "pauses = 0", r"\[validity\] pauses is 0; a whole number of at least 1 and at most 255"),
        ("stripes = 70", "stripes = 70.5", r"\[scan\] stripes is 70.5"),
        ("minimum = -0.080", "minimum = 0.2", r"\[heights\] minimum is 0.2"),
    ],
)
def test_wrong_values_are_refused_with_table_and_field(tmp_path: Path, line: str, instead: str, message: str) -> None:
    """A robot.toml with one impossible value: the message names robot, table, field, value and what is allowed."""
    folder = altered_guara(tmp_path, (line, instead))
    with pytest.raises(gp.FileFormatError, match=message):
        Settings.of(load_robot(folder))


def test_all_wrong_values_are_reported_at_once(tmp_path: Path) -> None:
    """Faults in five tables: one refusal that lists them all."""
    folder = altered_guara(
        tmp_path,
        ("resolution = 0.005", "resolution = 5.0"),
        ("drop_limit = 0.020", 'drop_limit = "2 cm"'),
        ("disc_radius = 0.015", ""),
        ("coarse_every = 2", "coarse_every = 0"),
        ("[validity]", "[valid]"),
    )
    with pytest.raises(gp.FileFormatError, match="5 errors: ") as caught:
        Settings.of(load_robot(folder))
    for expected_text in (
        "[grid] resolution is 5.0",
        "drop_limit is '2 cm'",
        "disc_radius is missing",
        "coarse_every is 0",
        "[validity]",
    ):
        assert any(expected_text in finding for finding in caught.value.findings), expected_text
