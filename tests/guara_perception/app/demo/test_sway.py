"""A swaying robot beside a still one in `guara demo --sway`, and its check, which must be able to fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.demo.sway import SwayingScan, sway_failures, sway_lines
from guara_perception.app.main import run


@pytest.mark.heavy
def test_the_demo_shows_a_swaying_robot_beside_a_still_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a stream, as many cells are known as with a still body; without, most are left out, and health says why."""
    assert run(["demo", "--sway", "0.5", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    still, streamed, blind = (line for line in lines if " cells known, " in line)
    count = [int(line.split(": ")[1].split()[0].replace(",", "")) for line in (still, streamed, blind)]
    assert count[0] > 9000 and count[1] > 0.9 * count[0] and count[2] < 0.5 * count[0]
    assert all(" 0 free cells wrong" in line for line in (still, streamed, blind))
    assert "camera moved" in blind and "camera moved" not in streamed
    assert lines[-1] == "the demo's check passed"
    assert (tmp_path / "sway.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_a_sway_that_the_legs_cannot_make_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = tmp_path / "flat.toml"
    world.write_text("x = [-1.0, 3.0]\ny = [-1.0, 1.0]\n")
    for given, said in (("9", "0.05<=x<=2.0"), ("0.01", "0.05<=x<=2.0")):
        assert run(["demo", "--sway", given, "--world", str(world), "--out", str(tmp_path)]) == 2
        assert said in capsys.readouterr().err


def test_the_check_fails_for_wrong_cells_and_for_lost_ground() -> None:
    """A wrong free cell fails the check, and so does a stream with fewer than nine tenths of the cells."""
    flat = gp.assess_terrain(np.zeros((60, 60)), 0.005)
    x, y = np.meshgrid(*flat.geometry.centres())
    right = SwayingScan(flat, x, y, np.zeros(flat.shape))
    assert sway_failures([("still", right), ("streamed", right), ("blind", right)]) == []
    wrong = replace(right, errors=np.full(flat.shape, 0.006))
    free = int((flat.hazard == 0).sum())
    assert free > 0 and wrong.wrong == free
    assert sway_failures([("still", right), ("streamed", right), ("blind", wrong)]) == [
        f"blind: {free} free cells are wrong"
    ]
    lost = replace(right, errors=np.where(y > y.mean(), np.nan, 0.0))
    (failure,) = sway_failures([("still", right), ("streamed", lost)])
    assert failure == "with a stream 1,800 cells are known, at least 90% of 3,600 required"
    assert "1,800 cells known" in sway_lines([("streamed", lost)])[0]
    nothing = replace(right, errors=np.full(flat.shape, np.nan))
    assert "0 cells known, height error none" in sway_lines([("blind", nothing)])[0]
