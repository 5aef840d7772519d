"""The demo's planner in its own process: it answers from the received grid, and its end is reported."""

import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

import guara_perception as gp
from guara_perception.app.demo import walk
from guara_perception.app.demo.walk import PlannerProcess
from guara_perception.exceptions import PlannerFailed
from guara_perception.simulation.planner import plan_swing
from tests.forked import ForkedProcess

pytestmark = pytest.mark.slow

NODE = Path(__file__).parent.parent / "publishing_node.py"


@pytest.fixture(scope="module")
def node(start, module_endpoint: str, terrain_file: Path):
    """Node that has published both grids of step 5."""
    process = start(NODE, module_endpoint, "guara", terrain_file)
    assert process.line() == "ready"
    process.tell("publish 5")
    process.tell("map 5")
    return process


@pytest.fixture
def forked_planner(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fork planners from a process with all imports; the other tests start them as the demo does."""
    forked = SimpleNamespace(**{**vars(subprocess), "Popen": lambda arguments, **_: ForkedProcess(*arguments[1:])})
    monkeypatch.setattr(walk, "subprocess", forked)


def test_foothold_is_that_of_the_grid(node, module_endpoint: str, paper_terrain: gp.TerrainGrid):
    """The planner answers what the grid itself answers, over Zenoh and from another process.

    A foot swings from where it stands, which a single scan has not seen: there is a foothold, but no swing to it.
    """
    x, y = 0.72, 0.0
    expected = plan_swing(paper_terrain, "lf", (x, y))
    with PlannerProcess(module_endpoint, "guara") as planner:
        reply = planner.choose(step=5, leg="lf", x=x, y=y)
        far = planner.choose(step=5, leg="lf", x=5.0, y=5.0)
    assert reply["step"] == 5 and reply["leg"] == "lf" and reply["received"] >= 1
    if expected is None:
        assert reply["foothold"] is None and reply["reasons"]
    else:
        assert reply["foothold"] == pytest.approx(expected.foothold.position.tolist())
    assert far["foothold"] is None and far["reasons"]


def test_no_node_is_reported_and_nothing_is_left_behind(free_endpoint: str, capfd):
    """A planner that cannot connect prints one line, and the demo reports that it ended."""
    with pytest.raises(PlannerFailed, match=r"the planner process ended \(exit code 1\)"):
        PlannerProcess(free_endpoint, "guara")
    said = capfd.readouterr().err
    assert said.startswith("planner: cannot connect to") and "Traceback" not in said


def test_planner_that_died_is_reported(forked_planner: None, node, module_endpoint: str):
    """A request to a dead planner fails at once; closing it twice is allowed."""
    planner = PlannerProcess(module_endpoint, "guara")
    planner._process.kill()
    planner._process.wait(60)
    with pytest.raises(PlannerFailed, match="the planner process ended"):
        planner.choose(step=5, leg="lf", x=0.7, y=0.0)
    planner.__exit__()
    planner.__exit__()


def test_closing_ends_the_process(forked_planner: None, node, module_endpoint: str):
    """Leaving the block ends the planner without a signal; later requests fail."""
    with PlannerProcess(module_endpoint, "guara") as planner:
        process = planner._process
    assert process.returncode == 0
    with pytest.raises(PlannerFailed):
        planner.choose(step=5, leg="lf", x=0.7, y=0.0)
