"""`guara acceptance`: repeated scans of known blocks; report, verdict and refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.acceptance import Acceptance, AcceptanceFailed, Turn, measure, parse_blocks
from tests.made_once import made_once


def accept(folder: Path) -> None:
    """Run the acceptance of a simulated device."""
    from guara_perception.app.main import run

    assert run(["acceptance", str(folder), "--simulated", "--scans", "3", "--note", "test <b>"]) == 0


@pytest.fixture(scope="module")
def accepted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Finished acceptance test; read only."""
    return made_once(tmp_path_factory, "acceptance", accept)


def shape_of(page: str) -> str:
    """Text of a report without its numbers, hashes, rows and image."""
    return re.sub(
        r"[^a-z]+", " ", re.sub(r"<td>.*?</td>|</?tr>|<style>.*?</style>|src=\"[^\"]*\"", "", page, flags=re.S)
    )


@pytest.mark.slow
def test_report_states_error_repeatability_known_light_calibration_and_versions(accepted: Path, root: Path):
    """The true calibration measures to a tenth of a millimetre; the example in the docs has the same structure."""
    data = json.loads((accepted / "acceptance.json").read_text())
    errors = np.array([turn["heights"] for turn in data["turns"]]) - data["blocks"]
    assert errors.shape == (3, 3) and np.abs(errors).max() < 1e-4 and data["is_held"] and data["is_simulated"]
    assert len(set(errors[:, 0])) == 3, "the noise of each scan is its own"
    page = (accepted / "report.html").read_text()
    for part in (
        "repeatability",
        "Known cells: 9",
        "exposure 0.008 s",
        ", created: simulated",
        "A simulated device",
        "test &lt;b&gt;",
        *data["device"],
    ):
        assert part in page
    assert set(data["device"]) == {"camera", "laser board", "calibration", "light", "programs"}
    calibration_hash = gp.load_terrain(accepted / "scan_01.npz").record.calibration_hash
    assert calibration_hash and f"hash {calibration_hash}, created" in data["device"]["calibration"]
    example = (root / "docs" / "hardware" / "acceptance-example.html").read_text()
    assert shape_of(example) == shape_of(page)


@pytest.mark.slow
def test_a_finished_acceptance_is_not_written_over_and_an_interrupted_one_goes_on(accepted: Path, tmp_path, guara):
    """Existing scans are kept, except the last, which also describes the device."""
    assert guara("acceptance", accepted, "--simulated").code == 2
    for number in (1, 2):
        (tmp_path / f"scan_0{number}.npz").write_bytes((accepted / f"scan_0{number}.npz").read_bytes())
    first = tmp_path / "scan_01.npz"
    before = first.stat().st_mtime_ns
    said = guara("acceptance", tmp_path, "--simulated", "--scans", "2")
    assert said.code == 0 and "passed: all heights" in said.out and first.stat().st_mtime_ns == before


@pytest.mark.slow
def test_other_blocks_than_given_are_refused(accepted: Path):
    """The message lists the measured blocks: a hidden block, a misplaced decimal point, and an empty floor."""
    terrain = gp.load_terrain(accepted / "scan_01.npz")
    for heights in ((0.01, 0.02), (0.01, 0.02, 0.06), (0.01, 0.02, 0.03, 0.05)):
        with pytest.raises(AcceptanceFailed, match=r"shows blocks of 10\.0, 20\.0, 50\.0 mm, allowed: .* 5 cm"):
            measure(terrain, heights)
    with pytest.raises(AcceptanceFailed, match="the scan shows no blocks, allowed"):
        measure(terrain, (0.2,))


@pytest.mark.slow
def test_a_scan_without_the_blocks_is_taken_again_by_the_same_command(accepted: Path, tmp_path: Path, guara):
    """Exit 1 with one line; the grid without the blocks is not kept."""
    for number in (1, 2):
        (tmp_path / f"scan_0{number}.npz").write_bytes((accepted / "scan_01.npz").read_bytes())
    said = guara("acceptance", tmp_path, "--simulated", "--blocks", "0.01,0.03,0.05", "--scans", "3")
    assert said.code == 1 and "20.0, 50.0 mm, allowed" in said.err and said.err.count("\n") == 1
    assert not (tmp_path / "scan_01.npz").exists() and (tmp_path / "scan_02.npz").exists()


def test_an_error_beyond_what_the_grid_states_is_not_held():
    """The verdict compares every scan, not the mean."""
    right = Turn(np.array([0.0101, 0.05]), np.array([0.0001, 0.0001]), 0.97, ())
    wrong = Turn(np.array([0.01, 0.0504]), np.array([0.0001, 0.0001]), 0.97, ("light: too dark",))
    held = Acceptance((0.01, 0.05), (right, right), {}, "", is_simulated=False)
    assert held.is_held and held.verdict.startswith("passed: all heights are within")
    failed = Acceptance((0.01, 0.05), (right, wrong), {}, "", is_simulated=False)
    assert not failed.is_held and "largest error 0.40 mm in 2 scans of 2 blocks" in failed.verdict


def test_verdict_of_a_real_device_is_on_its_page(tmp_path: Path):
    """The page contains the reasons of each scan."""
    turn = Turn(np.array([0.02]), np.array([0.0001]), 0.9, ("light: too dark",))
    page = Acceptance((0.01,), (turn, turn), {}, "oak", is_simulated=False).save(tmp_path).read_text()
    assert (
        "FAILED: not all heights" in page and "A real device." in page and "light: too dark" in page and "oak" in page
    )


@pytest.mark.parametrize("text", ["", "10", "0.01,0.012", "0.001", "0.01,0.1,0.2,0.3,0.4,0.45,0.5", "a"])
def test_heights_that_no_block_has_are_refused(text: str):
    """In millimetres, nearly equal, too low, too many, and not a number."""
    with pytest.raises(gp.InvalidInput, match="--blocks is"):
        parse_blocks(text)


def test_devices_beside_a_simulation_are_refused(guara, tmp_path: Path):
    """Nothing is written; without either option, a calibration is requested."""
    said = guara("acceptance", tmp_path / "a", "--simulated", "--devices", "devices.toml")
    assert said.code == 2 and "leave --devices out" in said.err
    said = guara("acceptance", tmp_path / "a")
    assert said.code == 2 and "no calibration: give -c" in said.err and not (tmp_path / "a").exists()
