"""Light that is not the robot's, and frames of another instant: found by the code of dark flashes, or harmless."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from drivers import AcquireOptions, OffFrames
from guara_perception.app.main import run
from guara_perception.app.summary import summary
from guara_perception.scanning.flash_proof import FlashProof, doubled_stripes, lit_pixels
from guara_perception.simulation import World
from kinematics import PoseInOdom
from testbed.scenes import OWN_DATA, recorded, simulated
from testbed.strange_cases import Case, cases, measure
from testbed.strange_light import Fault, Scene, beside, ghost, take

CODE_CAUSES = "foreign laser light", "frames are not of their flash", "two lines in one picture"
# Pauses between two scans of a test.
STEPS = 3
PER_STRIPE = AcquireOptions(off=OffFrames.PER_STRIPE, together=16)
CASES = [
    Case("foreign", Fault("brighter, half a stripe aside", extra=beside(0.5, 1.6))),
    Case("foreign", Fault("the same, step by step", extra=beside(-1, 1.6)), triggered=False),
    Case("foreign", Fault("own laser dead", gain=0.0, extra=beside(1, 1.0))),
    Case("foreign", Fault("own laser weak", gain=0.25, extra=beside(0.5, 1.0))),
    Case("short line", Fault("half a stripe aside, 1.6 as bright", extra=beside(0.5, 1.6, range(14, 20)))),
    Case("short line", Fault("three times as bright", extra=beside(-0.5, 3.0, range(3, 13)))),
    Case("ghost", Fault("three quarters of a stripe aside", extra=ghost(0.75, 1.3))),
    Case("ghost", Fault("half a stripe aside", extra=ghost(-0.5, 1.3))),
    Case("frames", Fault("pixels of the frame before", late=1)),
    Case("frames", Fault("the same from frame 20 on", late=1, first=20)),
    Case("frames", Fault("clock jumps back", gaps=-2, first=20)),
    Case("frames", Fault("clock jumps ahead", gaps=1, first=20)),
    Case("frames", Fault("one stripe late", late=1), triggered=False),
    Case("frames", Fault("one stripe late, off per stripe", late=2), triggered=False, options=PER_STRIPE),
]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(recorded(OWN_DATA / "scans" / "paper"))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.group}, {case.fault.name}")
def test_no_free_cell_is_wrong(scene: Scene, case: Case) -> None:
    """Nothing is called free on unseen ground or more than 5 mm off; what is refused says why."""
    found = measure(scene, case)
    assert found.unsafe == found.wrong == 0
    assert any(cause in found.health for cause in CODE_CAUSES)


@pytest.mark.slow
def test_light_that_stays_is_left_out(scene: Scene) -> None:
    """Light that stays makes the pixels around it unusable, or the whole scan."""
    case = next(case for case in cases(scene) if case.fault.name.startswith("trace"))
    assert (found := measure(scene, case)).unsafe == found.wrong == 0


@pytest.mark.slow
@pytest.mark.parametrize("triggered", [True, False])
def test_a_clean_scan_loses_nothing(scene: Scene, triggered: bool) -> None:
    """At most 0.5 % of the known cells; its record holds the number of dark flashes that were dark."""
    processor, taken = take(scene, Fault("clean"), triggered=triggered)
    terrain = processor.finish()
    bare = scene.scan.processor()
    scene.scan.add_to(bare)
    plain = bare.finish()
    known, before = (int(np.isfinite(each.elevation).sum()) for each in (terrain, plain))
    assert known >= 0.995 * before and not taken.problems
    assert terrain.scan_record.dark_flashes == 2 and not processor.refused
    assert terrain.record.health is not None and terrain.record.health.level == "ok"
    assert plain.scan_record.dark_flashes is None
    assert "no dark flashes" in summary(plain) and "no dark flashes" not in summary(terrain)


@pytest.mark.slow
def test_a_refused_scan_leaves_the_map_as_it_was(scene: Scene) -> None:
    """Ground that was known stays known and grows older; nothing becomes free, nothing is new."""
    foreign = Fault("foreign", extra=beside(0.5, 1.6))
    scans = [take(scene, fault, triggered=True)[0].finish() for fault in (Fault("clean"), foreign)]
    terrain_map = gp.TerrainMap(scene.scan.robot)
    pose = PoseInOdom(np.eye(4), np.zeros((6, 6)))
    before, after = (
        terrain_map.update(dataclasses.replace(terrain, step=step), pose)
        for step, terrain in zip((1, 1 + STEPS), scans, strict=True)
    )
    assert not np.isfinite(scans[1].elevation).any()
    assert np.isfinite(before.elevation).sum() > 5000
    assert np.array_equal(before.elevation, after.elevation, equal_nan=True)
    assert np.array_equal(before.traversability > 0, after.traversability > 0)
    # As old as before: where the ground was seen long ago it is stale.
    late = terrain_map.update(dataclasses.replace(scans[1], step=2 + before.record.validity_pauses), pose)
    assert not np.any(late.traversability > 0)


@pytest.mark.slow
def test_a_recorded_scan_keeps_its_code(tmp_path: Path) -> None:
    """In scan.json and MCAP, so that its dark frames are checked again later. Old folders can still be read."""
    folder, mcap, again = tmp_path / "scan", tmp_path / "scan.mcap", tmp_path / "again"
    assert run(["scan", str(folder), "--simulated", "--mode", "coarse"]) == 0
    listed = json.loads((folder / "scan.json").read_text())
    assert len(listed["dark_after"]) == 2 and listed["dark_after"][-1] == 68
    assert [s["index"] for s in listed["stripes"] if "dark" in s] == listed["dark_after"]
    for source, target in ((folder, mcap), (mcap, again)):
        assert run(["convert", str(source), str(target)]) == 0
    scans = [gp.open_scan(path) for path in (folder, mcap, again)]
    assert len({scan.dark_after for scan in scans}) == 1 and scans[0].dark_after == tuple(listed["dark_after"])
    for scan in scans:
        assert [stripe.index for stripe in scan.stripes if stripe.dark is not None] == listed["dark_after"]
    robot, calibration = gp.load_robot("guara"), gp.load_calibration(folder / "calibration.json")
    grids = [gp.process_scan(scan, calibration, robot) for scan in scans]
    assert all(np.array_equal(grids[0].elevation, grid.elevation, equal_nan=True) for grid in grids)
    assert [grid.scan_record.dark_flashes for grid in grids] == [2, 2, 2]
    # A line in the dark.
    shown = next(s for s in listed["stripes"] if "dark" in s)
    shutil.copy(folder / shown["on"], folder / shown["dark"])
    spoilt = gp.process_scan(folder, calibration, robot)
    assert not np.isfinite(spoilt.elevation).any()
    assert spoilt.record.health is not None and spoilt.record.health.level == "failed"
    assert spoilt.record.health.reasons[0].startswith("foreign laser light, or frames are not of their flash")
    # Stripes that no dark flash follows are not used.
    del listed["stripes"][-1]["dark"]
    del shown["dark"]
    (folder / "scan.json").write_text(json.dumps(listed))
    unproved = gp.process_scan(folder, calibration, robot)
    assert not np.isfinite(unproved.elevation).any()
    # Without its code it is processed as scans were before.
    del listed["dark_after"]
    (folder / "scan.json").write_text(json.dumps(listed))
    plain = gp.process_scan(folder, calibration, robot)
    assert np.isfinite(plain.elevation).any() and plain.scan_record.dark_flashes is None
    for wrong in ([-1], ["a"], 3):
        (folder / "scan.json").write_text(json.dumps({**listed, "dark_after": wrong}))
        with pytest.raises(gp.FileFormatError, match="dark_after"):
            gp.open_scan(folder)


def test_light_of_any_direction_is_seen_and_a_change_as_a_whole_is_not() -> None:
    """Lines along rows, columns and between; not noise, a brighter scene, or a soft shadow."""
    rng = np.random.default_rng(0)
    scene = cv2.GaussianBlur(rng.uniform(20, 90, (512, 640, 3)).astype(np.float32), (0, 0), 3)

    def shot(level: np.ndarray) -> np.ndarray:
        return np.clip(np.rint(level + rng.normal(0, 1.5, level.shape)), 0, 255).astype(np.uint8)

    for ends in (((0, 200), (639, 240)), ((300, 0), (310, 511)), ((0, 0), (639, 511))):
        line = np.zeros((512, 640), np.float32)
        cv2.line(line, *ends, 60.0, 3)
        light = scene.copy()
        light[:, :, 2] += line
        lit = lit_pixels(shot(light), shot(scene))
        assert max(lit.any(axis=0).mean(), lit.any(axis=1).mean()) > 0.9
    shade = 1 - 0.3 / (1 + np.exp((np.arange(640) - 320) / 40))[None, :, None]
    for other in (scene, 1.2 * scene, 0.8 * scene, scene * shade):
        assert lit_pixels(shot(other), shot(scene)).mean() < 1e-4


def test_dark_frames_without_a_laser_off_picture_are_compared_with_each_other() -> None:
    """A line that moves is seen in either."""
    rng = np.random.default_rng(1)
    proof = FlashProof()
    proof.expect((3, 9))
    for index, row in ((3, 100), (9, 140)):
        picture = rng.integers(20, 24, (256, 320, 3), dtype=np.uint8)
        picture[row : row + 3, :, 2] += 80
        proof.add_dark(index, picture, None)
    assert proof.judge().refused.startswith("foreign laser light")


@pytest.mark.parametrize("usual", [0.03, 0.2])
def test_a_second_line_that_other_stripes_lack_spoils_its_stripe(usual: float) -> None:
    """Also a fainter one; a line that all stripes show is a reflection, which shifts no height by over 5 mm."""
    shares = dict.fromkeys(range(20), usual) | {3: 0.3, 7: 0.5, 8: 1.0}
    assert doubled_stripes(shares) == ({3, 7, 8} if usual < 0.1 else {7, 8})
    assert doubled_stripes({}) == frozenset()


@pytest.mark.slow
@pytest.mark.parametrize("second", [0.0, 1.0])
def test_a_thin_line_is_not_two_lines(second: float) -> None:
    """In pictures of 320 x 256 the stripe is 2 px wide; a reflection three quarters of a stripe aside is found."""
    small = simulated((320, 256), 70, world=World(), is_uncertain=False)
    extra = ghost(-0.75, second) if second else None
    processor, _ = take(Scene(small), Fault("reflection", extra=extra), triggered=True)
    health = processor.finish().record.health
    assert health is not None and health.level == ("failed" if second else "ok")
    assert ("two lines in one picture" in processor.refused) == bool(second)


@pytest.mark.heavy
def test_every_case_of_the_benchmark(scene: Scene) -> None:
    for case in cases(scene):
        found = measure(scene, case)
        assert found.unsafe == found.wrong == 0, case
