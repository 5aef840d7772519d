"""`guara listen --all`: table, JSON, and the message when no robot is running."""

import json
from pathlib import Path

import pytest

PUBLISHING_NODE = Path(__file__).parent.parent / "publishing_node.py"


@pytest.mark.slow
def test_the_robots_of_a_router_are_listed(guara, start, free_endpoint: str, terrain_file: Path) -> None:
    """A table with one line per robot, the same as JSON, and selection of one robot by name."""
    node = start(PUBLISHING_NODE, free_endpoint, "rex", terrain_file)
    assert node.line() == "ready"
    node.tell("publish 12")
    said = guara("listen", "--all", "--connect", free_endpoint)
    assert said.code == 0, said.err
    head, row = said.out.splitlines()
    assert head.split() == ["robot", "step", "age", "health", "links"]
    assert row.split()[:2] == ["rex", "12"] and row.split()[-3:] == ["s", "ok", "1"]
    (state,) = json.loads(guara("listen", "--all", "--connect", free_endpoint, "--name", "rex", "--json").out)
    assert (state["robot"], state["step"], state["health"], state["links"]) == ("rex", 12, "ok", 1)
    assert 0 <= state["age"] < 600 and state["standing"] is None and state["message"] == ""
    node.tell("pause 13")
    assert json.loads(guara("listen", "--all", "--connect", free_endpoint, "--json").out)[0]["standing"] is True
    said = guara("listen", "--all", "--connect", free_endpoint, "--robot", "bob", "--timeout", "0.2")
    assert said.code == 1 and said.out == "" and "none of bob was found" in said.err
    assert said.err.count("\n") == 1


@pytest.mark.slow
def test_where_nobody_listens_it_says_so(guara, free_endpoint: str) -> None:
    """Exit 1, one line."""
    said = guara("listen", "--all", "--connect", free_endpoint)
    assert said.code == 1 and "cannot connect to" in said.err and said.out == ""
