"""`guara listen`: output and end, in a separate process where signals or counts end it."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

import guara_perception as gp
from guara_perception.app.commands import listen
from transport import KeyNameError

NODE = Path(__file__).parent.parent / "publishing_node.py"
GUARA = ("-m", "guara_perception.app.main")


@pytest.fixture(scope="module")
def node(start, module_endpoint: str, terrain_file: Path):
    """Node that publishes on command."""
    process = start(NODE, module_endpoint, "guara", terrain_file)
    assert process.line() == "ready"
    return process


def test_count_ends_it_after_the_last_grid(node, start, module_endpoint: str):
    """With --count 1, the grid published before is printed at once, and the command ends."""
    node.tell("publish 7")
    listener = start(*GUARA, "listen", "--connect", module_endpoint, "--count", "1", "--timeout", "60")
    line = listener.line()
    assert line.startswith("guara footprint #") and ": step 7, coarse, 90x108 cells of 5 mm, known " in line
    assert listener.wait() == 0 and listener.errors == []


def test_every_new_grid_is_a_line_until_interrupted(node, start, module_endpoint: str):
    """Each grid is printed as it arrives; Ctrl-C ends the command with exit 0 and the number of grids."""
    node.tell("publish 8")
    listener = start(*GUARA, "listen", "--connect", module_endpoint)
    assert ": step 8, " in listener.line()
    node.tell("publish 9")
    assert ": step 9, " in listener.line()
    assert listener.interrupt() == 0
    assert [line.strip() for line in listener.errors] == ["stopped; grids received: 2"]


def test_the_compact_encoding_shows_the_same_grid(node, guara, module_endpoint: str):
    """`--encoding compact` prints the same line as the lossless encoding; in Python, the record states the rounding."""
    node.tell("publish 10")
    lines = []
    for encoding in ("lossless", "compact"):
        options = ("--encoding", encoding, "--json", "--count", "1", "--timeout", "60")
        said = guara("listen", "--connect", module_endpoint, *options)
        lines.append(json.loads(said.out))
        assert said.code == 0
    lossless, compact = lines
    for name in ("sequence", "step", "known", "traversable", "hazards"):
        assert compact.get(name) == lossless.get(name)
    with gp.TerrainClient(module_endpoint, encoding="compact") as client:
        terrain = client.wait_for_step(10, timeout=60)
        assert terrain.metadata["rounding"] == {"elevation": 2.0**-14, "variance": 0.125}
        assert terrain.check_foothold(0.7, 0.0).ok <= client.query().check_foothold(0.7, 0.0).ok
    with pytest.raises(KeyNameError, match="encoding is 'small'; allowed: 'lossless', 'compact'"):
        gp.TerrainClient(module_endpoint, encoding="small")


def test_other_extent(node, guara, module_endpoint: str):
    """`--extent map` prints the fused grids."""
    node.tell("map 12")
    said = guara("listen", "--connect", module_endpoint, "--extent", "map", "--count", "1", "--timeout", "60")
    assert said.out.startswith("guara map #1: step 12, ") and said.code == 0


def test_a_name_that_nobody_has_is_said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Without --timeout, a line says that no such node is visible; a running node gives no line."""
    monkeypatch.setattr(listen, "SILENCE", 0.0)
    for is_alive in (True, False):
        listen.report_missing_node(SimpleNamespace(is_alive=is_alive), "tapir")  # type: ignore[arg-type]
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert "waiting for a node with instance name 'tapir': no such node is visible here; `guara listen" in said.err


def test_no_grid_in_time_is_a_failure(node, guara, module_endpoint: str):
    """No grid under this name: exit 1 with one line."""
    said = guara("listen", "--connect", module_endpoint, "--robot", "tapir", "--count", "1", "--timeout", "0.5")
    assert said.code == 1
    assert said.err.count("\n") == 1 and "tapir/perception/v1/terrain' within 0.5 s" in said.err


@pytest.mark.slow
def test_nobody_there_is_a_failure(guara, free_endpoint: str):
    """No node: exit 1 with one line that lists what to check."""
    said = guara("listen", "--connect", free_endpoint, "--count", "1")
    assert said.code == 1
    assert said.err.count("\n") == 1 and f"cannot connect to {free_endpoint}" in said.err


@pytest.mark.parametrize("endpoint", ["127.0.0.1:7447", "tcp/nowhere", "tcp/127.0.0.1:x"])
def test_bad_endpoint_is_bad_usage(guara, endpoint: str):
    """An invalid endpoint exits 2 and shows a valid example."""
    said = guara("listen", "--connect", endpoint, "--count", "1")
    assert said.code == 2 and endpoint in said.err and said.err.count("\n") == 1
