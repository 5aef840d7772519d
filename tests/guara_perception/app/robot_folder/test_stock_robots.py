"""The stock quadrupeds of the package index, each from its URDF to a sound folder and a walk; extra `robots-test`."""

from __future__ import annotations

from pathlib import Path

import pytest

from guara_perception.app.robot_folder.check import walk_findings
from guara_perception.app.robot_folder.trial_walk import trial_walk
from kinematics import load_robot
from testbed.stock_results import StockResult, line, stock_result
from testbed.stock_robots import FILES, StockRobotsMissing, stock_urdf

pytestmark = pytest.mark.robots
pytest.importorskip("yourdfpy", reason="the extra `robots-test` is not installed")


@pytest.fixture(scope="module", params=FILES)
def result(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[StockResult, Path]:
    """One stock robot and its folder."""
    folder = tmp_path_factory.mktemp("stock") / request.param
    try:
        return stock_result(request.param, folder), folder
    except StockRobotsMissing as error:
        pytest.skip(str(error))


def test_it_loads_and_is_sound(result: tuple[StockResult, Path]) -> None:
    """`robot new` takes it as it is, `robot check` finds nothing to mend."""
    assert result[0].is_passed, line(result[0])


def test_its_stance_pose_is_that_of_another_reader(result: tuple[StockResult, Path]) -> None:
    """To a nanometre, in several stances and attitudes."""
    assert result[0].difference < 1e-9


@pytest.mark.slow
def test_it_walks_and_takes_nothing_unknown_for_safe(result: tuple[StockResult, Path]) -> None:
    """Ten pauses over boxes, a pit and a dark patch: no unknown cell traversable, no foot on a hazard."""
    walk = trial_walk(load_robot(result[1]))
    assert not list(walk_findings(walk)) and walk.pauses == 10 and walk.feet >= 9, walk


def test_nothing_of_theirs_is_in_the_repository() -> None:
    """No stock URDF, or a part of one, lies here."""
    root = Path(__file__).parents[4]
    files = [*(root / "robots").rglob("*.urdf"), *(root / "tests").rglob("*.urdf")]
    texts = [path.read_text() for path in files]
    for name in FILES:
        try:
            stock = stock_urdf(name).read_text()
        except StockRobotsMissing as error:
            pytest.skip(str(error))
        assert all(stock[1000:1400] not in text for text in texts)
