"""A recorded scan becomes terrain, whole or streaming; what does not belong together is refused."""

import dataclasses
import itertools
import logging
from collections.abc import Callable

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import RobotModel, Stillness


def same_bytes(a: gp.TerrainGrid, b: gp.TerrainGrid) -> None:
    """Two grids hold the same bits in every layer, NaN included."""
    assert a.shape == b.shape and a.origin == b.origin and a.resolution == b.resolution
    for name, layer in a.layers.items():
        assert layer.tobytes() == b.layer(name).tobytes(), name


def streamed(scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel, order: list[int]) -> gp.TerrainGrid:
    processor = gp.ScanProcessor(calibration, robot, scan.stance, scan.mode, stamp=scan.stamp, step=scan.step)
    frames = list(scan.frames())
    for index in order:
        stripe, on, off = frames[index]
        processor.add(stripe.index, on, off)
    return processor.finish()


def test_public_flow_gives_the_promised_grid(paper_terrain: gp.TerrainGrid, paper_scan: gp.Scan):
    """Open, process, ask: extent, shape, corner and step of the default grid are those of docs/conventions.md."""
    assert paper_terrain.shape == (108, 90)
    assert paper_terrain.origin == (0.50, -0.27)
    assert paper_terrain.resolution == 0.005
    assert (paper_terrain.extent, paper_terrain.frame) == ("footprint", "base_footprint")
    assert (paper_terrain.stamp, paper_terrain.step) == (paper_scan.stamp, paper_scan.step)
    assert {name: picture.shape for name, picture in paper_terrain.pictures.items()} == {
        "ortho_image_mm": (512, 640),
        "range_image_mm": (512, 640),
    }


def test_report_says_what_was_done(paper_terrain: gp.TerrainGrid, calibration: gp.Calibration, paper_scan: gp.Scan):
    """The metadata name method, mode, calibration, stance and every stripe."""
    report = paper_terrain.metadata
    assert (report["robot"], report["mode"], report["method"]) == ("guara", "coarse", "precise")
    assert report["calibration_hash"] == calibration.hash
    assert report["stance"] == paper_scan.stance.to_dict()
    assert report["attitude_source"] == "imu"
    assert report["stripes_used"] == len(paper_scan.stripes) == report["stripes_planned"]
    assert report["stripes_missing"] == [] and report["frames_bad"] == {}
    assert report["health"] == {"level": "ok", "reasons": []}
    known = (np.asarray(paper_terrain.hazard) & UNKNOWN_MASK) == 0
    assert report["known"] == pytest.approx(known.mean())


def test_grid_cannot_be_written(paper_terrain: gp.TerrainGrid):
    """Every layer and picture is read-only, and the fields cannot be replaced."""
    for array in (*paper_terrain.layers.values(), *paper_terrain.pictures.values()):
        assert not array.flags.writeable
    with pytest.raises(dataclasses.FrozenInstanceError):
        paper_terrain.step = 7


@pytest.mark.slow
@pytest.mark.parametrize(("resolution", "shape"), [(0.005, (108, 90)), (0.01, (54, 45)), (0.015, (36, 30))])
def test_resolutions_that_divide_the_area(paper_scan, calibration, robot, resolution, shape):
    """A coarser grid covers the same area and stays safe: it knows no more area and calls none safe that was unseen."""
    terrain = gp.process_scan(paper_scan, calibration, robot, resolution=resolution, pictures=False)
    assert terrain.shape == shape and terrain.origin == (0.50, -0.27)
    assert terrain.resolution == pytest.approx(resolution)
    fine = gp.process_scan(paper_scan, calibration, robot, pictures=False)
    ratio = round(resolution / 0.005)
    known = np.isfinite(fine.elevation).reshape(shape[0], ratio, shape[1], ratio).all(axis=(1, 3))
    np.testing.assert_array_equal(np.isfinite(terrain.elevation), known)


@pytest.mark.parametrize("resolution", [0.007, 0.0, -0.005, float("nan"), float("inf"), 0.02, 1.0, "'fine'"])
def test_resolutions_that_do_not_fit_are_refused(paper_scan, calibration, robot, resolution):
    """The message shows the value and what is allowed."""
    with pytest.raises(gp.InvalidInput, match=f"resolution (is )?{resolution}"):
        given = resolution.strip("'") if isinstance(resolution, str) else resolution
        gp.process_scan(paper_scan, calibration, robot, resolution=given)


@pytest.mark.slow
def test_any_order_gives_the_same_bytes(paper_scan, calibration, robot, paper_terrain):
    """Streaming in any order gives bit for bit the grid of the recorded order."""
    count = len(paper_scan.stripes)
    generator = np.random.default_rng(1)
    orders = [list(range(count)), list(reversed(range(count))), generator.permutation(count).tolist()]
    for order in orders:
        same_bytes(streamed(paper_scan, calibration, robot, order), paper_terrain)


@pytest.mark.slow
def test_finish_at_any_time(paper_scan, calibration, robot, paper_terrain):
    """What was not added is unknown, nothing known is taken back, and finishing does not disturb what follows."""
    processor = gp.ScanProcessor(
        calibration, robot, paper_scan.stance, paper_scan.mode, stamp=paper_scan.stamp, step=paper_scan.step
    )
    known = []
    for done, (stripe, on, off) in enumerate(paper_scan.frames()):
        if done % 9 == 0:
            terrain = processor.finish()
            known.append(int(np.isfinite(terrain.elevation).sum()))
            assert len(terrain.metadata["stripes_missing"]) == len(paper_scan.stripes) - done
            assert terrain.metadata["health"]["level"] == "degraded"
        processor.add(stripe.index, on, off)
    assert known[0] == 0 and known == sorted(known) and known[-1] > 0
    same_bytes(processor.finish(), paper_terrain)


def test_nothing_added_is_all_unscanned(paper_scan, calibration, robot):
    """A scan without a frame knows nothing: every cell is UNSCANNED and nothing else is claimed."""
    terrain = gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse").finish()
    hazard = np.asarray(terrain.hazard)
    assert ((hazard & UNKNOWN_MASK) == gp.Hazard.UNSCANNED).all()
    assert np.isnan(terrain.elevation).all() and not terrain.traversability.any()
    assert (terrain.to_occupancy() == 100).all() and (terrain.looks == 0).all()


def test_a_stripe_counts_once(paper_scan, calibration, robot):
    """The same index twice is refused, as is one that the mode does not fire."""
    processor = gp.ScanProcessor(calibration, robot, paper_scan.stance, "coarse")
    stripe, on, off = next(paper_scan.frames())
    processor.add(stripe.index, on, off)
    with pytest.raises(gp.InvalidInput, match="stripe index 0 was added before; a scan takes each stripe once"):
        processor.add(stripe.index, on, off)
    with pytest.raises(gp.InvalidInput, match="stripe index 1 is not in the coarse pattern: 0, 2 ... 68"):
        processor.add(1, on, off)


def test_repeated_index_in_a_scan_is_refused(paper_scan: gp.Scan):
    """A scan that lists an index twice does not say which frame is the stripe's."""
    with pytest.raises(gp.InvalidInput, match="stripe index 0 is listed 2 times"):
        dataclasses.replace(paper_scan, stripes=(*paper_scan.stripes, paper_scan.stripes[0]))


def test_missing_stripe_is_unknown_and_reported(paper_scan, calibration, robot, paper_terrain):
    """A stripe that a scan lacks is UNSCANNED where it would have looked; no other cell becomes known or safe."""
    without = tuple(stripe for stripe in paper_scan.stripes if stripe.index != 30)
    terrain = gp.process_scan(dataclasses.replace(paper_scan, stripes=without), calibration, robot, pictures=False)
    assert terrain.metadata["stripes_missing"] == [30]
    assert terrain.metadata["health"] == {"level": "degraded", "reasons": ["1 of 35 stripes were not fired"]}
    lost = np.isfinite(paper_terrain.elevation) & ~np.isfinite(terrain.elevation)
    assert lost.any() and (np.asarray(terrain.hazard)[lost] & gp.Hazard.UNSCANNED).any()
    assert not (np.isfinite(terrain.elevation) & ~np.isfinite(paper_terrain.elevation)).any()
    assert not ((terrain.traversability > 0) & ~(paper_terrain.traversability > 0)).any()


def test_pairing_is_by_index_not_by_order(paper_scan, calibration, robot, paper_terrain):
    """The order of the list in scan.json means nothing."""
    shuffled = dataclasses.replace(paper_scan, stripes=paper_scan.stripes[::-1])
    same_bytes(gp.process_scan(shuffled, calibration, robot, pictures=False), paper_terrain)


def test_another_robots_model_is_refused(paper_scan, calibration, robot):
    """Robot of scan, of model and of calibration must be one."""
    other = dataclasses.replace(paper_scan, robot="tapir")
    with pytest.raises(gp.CalibrationMismatch, match=r"scan.json: robot is 'tapir', but the given model is 'guara'"):
        gp.process_scan(other, calibration, robot)


def test_another_robots_calibration_is_refused(paper_scan, calibration, robot):
    """A calibration of another robot is not used."""
    other = dataclasses.replace(calibration, robot="tapir")
    with pytest.raises(gp.CalibrationMismatch, match="calibration belongs to robot 'tapir', not 'guara'"):
        gp.process_scan(paper_scan, other, robot)


def test_calibration_without_the_scans_stripes_is_refused(paper_scan, calibration, robot):
    """Stripes that were never calibrated are named, and so are those that were."""
    half = dataclasses.replace(calibration, stripes=calibration.stripes[:20])
    with pytest.raises(gp.CalibrationMismatch, match=r"stripe index 40, 42 ... 68 is not in the calibration"):
        gp.process_scan(paper_scan, half, robot)


def test_stripe_outside_the_pattern_is_refused(paper_scan, calibration, robot):
    """An index that the mode never fires is named with those it fires."""
    odd = dataclasses.replace(paper_scan.stripes[0], index=7)
    scan = dataclasses.replace(paper_scan, stripes=(odd, *paper_scan.stripes[1:]))
    with pytest.raises(gp.InvalidInput, match=r"stripe index 7 is not in the coarse pattern of guara: 0, 2 ... 68"):
        gp.process_scan(scan, calibration, robot)


def test_unknown_method_is_refused(paper_scan, calibration, robot):
    """The message lists the methods."""
    with pytest.raises(gp.InvalidInput, match="method is 'exact', allowed: .*precise"):
        gp.process_scan(paper_scan, calibration, robot, method="exact")


def test_unknown_mode_is_refused(paper_scan, calibration, robot):
    """A mode that does not exist is refused by scan and processor alike."""
    with pytest.raises(gp.InvalidInput, match="mode is 'fine', allowed: coarse, standard"):
        gp.ScanProcessor(calibration, robot, paper_scan.stance, "fine")
    with pytest.raises(gp.InvalidInput, match="mode is 'fine', allowed: coarse, standard"):
        dataclasses.replace(paper_scan, mode="fine")


def test_stance_that_is_not_the_robots_is_refused_with_the_scans_name(paper_scan, calibration, robot):
    """A joint or a leg that the robot lacks is named, with those it has and the file it came from."""
    joints = dict(paper_scan.stance.joint_positions)
    joints["lf_hap_joint"] = joints.pop("lf_haa_joint")
    for stance, reported in (
        (dataclasses.replace(paper_scan.stance, joint_positions=joints), "unknown joint 'lf_hap_joint'.*lf_haa_joint"),
        (dataclasses.replace(paper_scan.stance, support_feet=("lf", "xx", "lh")), "unknown leg 'xx'.*lf, rf, lh, rh"),
    ):
        with pytest.raises(gp.InvalidInput, match=f"scan.json: stance: {reported}"):
            gp.process_scan(dataclasses.replace(paper_scan, stance=stance), calibration, robot)


def with_frames(scan: gp.Scan, change: Callable[[str, np.ndarray], np.ndarray]) -> gp.Scan:
    """The scan with every frame passed through a function of its name and picture."""
    return dataclasses.replace(scan, read_frame=lambda name: change(name, scan.read_frame(name)))


def test_frames_of_another_size_are_refused(paper_scan, calibration, robot):
    """A camera that was not calibrated is not used, strict or not."""
    small = with_frames(paper_scan, lambda name, frame: frame[::2, ::2])
    with pytest.raises(gp.CalibrationMismatch, match="no frame has the calibrated camera's 640x512 px"):
        gp.process_scan(small, calibration, robot)
    with pytest.raises(gp.InvalidInput, match="on_000.jpg: the frame is 320x256 px, the calibration is for 640x512 px"):
        gp.process_scan(small, calibration, robot, strict=True)
    turned = with_frames(paper_scan, lambda name, frame: np.rot90(frame))
    with pytest.raises(gp.CalibrationMismatch, match="640x512 px: the frames are turned by 90 degrees"):
        gp.process_scan(turned, calibration, robot)


@pytest.mark.slow
def test_one_bad_frame_is_left_unknown_or_refused_when_strict(paper_scan, calibration, robot, paper_terrain):
    """A blank frame costs its stripe and is reported; with `strict` it is refused by name."""
    name = paper_scan.stripes[12].on
    blank = with_frames(paper_scan, lambda n, frame: np.zeros_like(frame) if n == name else frame)
    terrain = gp.process_scan(blank, calibration, robot, pictures=False)
    assert list(terrain.metadata["frames_bad"]) == [str(paper_scan.stripes[12].index)]
    assert "blank" in terrain.metadata["health"]["reasons"][0]
    assert not ((terrain.traversability > 0) & ~(paper_terrain.traversability > 0)).any()
    with pytest.raises(gp.InvalidInput, match=f"frame {name}: the searched rows of the frame are blank"):
        gp.process_scan(blank, calibration, robot, strict=True)


def test_other_calibration_than_recorded_is_reported(paper_scan, calibration, robot, caplog):
    """A scan that names another calibration is processed, with a warning that names both."""
    scan = dataclasses.replace(paper_scan, calibration_hash="0123456789abcdef")
    used = dataclasses.replace(calibration, hash="fedcba9876543210")
    with caplog.at_level(logging.WARNING):
        gp.process_scan(scan, used, robot, pictures=False)
    assert "0123456789abcdef" in caplog.text and "fedcba9876543210" in caplog.text


@pytest.mark.slow
def test_mirror_that_stood_elsewhere_is_reported(paper_scan, calibration, robot, caplog):
    """Stripes are paired by index, but a commanded angle that is not the calibrated one is reported."""
    stripes = tuple(dataclasses.replace(s, mirror_angle=s.mirror_angle + 1e-3) for s in paper_scan.stripes)
    with caplog.at_level(logging.WARNING):
        gp.process_scan(paper_scan, calibration, robot, pictures=False)
        assert not caplog.records
        gp.process_scan(dataclasses.replace(paper_scan, stripes=stripes), calibration, robot, pictures=False)
    assert "mirror_angle of stripe index 0, 2 ... 68 differs from the calibrated one" in caplog.text
    caplog.clear()
    half = dataclasses.replace(
        paper_scan, stripes=stripes, read_frame=lambda name: paper_scan.read_frame(name)[::2, ::2]
    )
    with caplog.at_level(logging.WARNING), pytest.raises(gp.InvalidInput, match="the frame is 320x256 px"):
        gp.process_scan(half, calibration, robot, strict=True)
    # A refused scan has only one message.
    assert not caplog.records


def test_progress_counts_every_stripe(paper_scan, calibration, robot):
    """The callback is called once for each stripe, in order."""
    heard: list[tuple[int, int]] = []
    gp.process_scan(
        paper_scan, calibration, robot, pictures=False, progress=lambda done, total: heard.append((done, total))
    )
    count = len(paper_scan.stripes)
    assert heard == [(done, count) for done in range(1, count + 1)]


def test_a_motion_too_small_for_the_joints_enters_the_variance(
    paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel, monkeypatch: pytest.MonkeyPatch
):
    """The heights' variance holds what each motion of the camera, in axes of base_link, would do to them."""
    sigmas = np.array([1e-3, 2e-3, 0.5e-3, 1e-3, 2e-3, 3e-3])
    processors = []
    for covariance in (np.zeros((6, 6)), np.diag(sigmas**2)):
        monkeypatch.setattr(Stillness, "covariance", covariance)
        processors.append(gp.ScanProcessor(calibration, robot, paper_scan.stance, paper_scan.mode))
    for stripe, on, off in itertools.islice(paper_scan.frames(), 10, 12):
        for processor in processors:
            processor.add(stripe.index, on, off)
    to_footprint = np.asarray(processors[0].pose.transform_base_to_footprint)[:3, :3]
    camera = processors[0].transform_camera_to_footprint[:3, 3]
    without, grid = (processor.finish() for processor in processors)
    iy, ix = np.nonzero(np.isfinite(grid.elevation))
    assert iy.size > 100
    x, y = grid.geometry.centres()
    arms = np.stack((x[ix], y[iy], grid.elevation[iy, ix].astype(np.float64)), axis=1) - camera
    expected = np.zeros(len(arms))
    for axis in range(3):
        direction = to_footprint[:, axis]
        expected += (sigmas[axis] * direction[2]) ** 2
        expected += (sigmas[3 + axis] * np.cross(direction, arms)[:, 2]) ** 2
    np.testing.assert_allclose((grid.variance - without.variance)[iy, ix], expected, rtol=1e-3, atol=1e-10)
    # The stripes of one scan share it.
    np.testing.assert_array_equal(grid.variance_local, without.variance_local)
