"""docs/new-robot.md followed word by word with stock robots; tests/test_docs.py does the same with the tapir."""

from __future__ import annotations

from pathlib import Path

import pytest

from guara_perception.app.main import run
from testbed.stock_robots import StockRobotsMissing, stock_urdf
from tests.test_docs import ROOT, Reader, blocks

pytestmark = [pytest.mark.robots, pytest.mark.slow]


@pytest.mark.parametrize("name", ["a1", "anymal_c"])
def test_the_page_leads_from_a_stock_urdf_to_a_walking_simulation(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A1: point feet, three joints per leg. ANYmal C: links and joints share names. Each line of the page works."""
    try:
        (tmp_path / "my_robot.urdf").symlink_to(stock_urdf(name))
    except StockRobotsMissing as error:
        pytest.skip(str(error))
    reader = Reader(tmp_path, tmp_path / "no-grid.npz")
    try:
        for block in blocks(ROOT / "docs" / "new-robot.md"):
            reader.read(block)
        reader.stop_running()
    finally:
        for _, process in reader.running:
            process.kill()
            process.communicate()
    assert (tmp_path / "mine.png").read_bytes().startswith(b"\x89PNG")
    assert run(["robot", "check", str(tmp_path / "robots" / "mine"), "--walk"]) == 0
    printed = capsys.readouterr().out
    assert "simulated walk: 10 pauses, " in printed and ": sound, " in printed
