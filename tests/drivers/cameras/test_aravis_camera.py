"""`AravisCamera` with Aravis's fake camera: real GigE Vision on loopback, images drawn at the trigger."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import AravisCamera, CameraSettings
from drivers.cameras import aravis_camera, aravis_library
from drivers.cameras.aravis_camera import BAYER, SHORT_IDS
from drivers.cameras.aravis_library import find_aravis_cameras
from drivers.cameras.bayer import mosaic
from drivers.cameras.camera import setting_changes
from drivers.errors import (
    CameraBackendMissing,
    CameraError,
    CameraNotFound,
    CameraNotOpen,
    CameraSettingRefused,
    CameraTimeout,
)
from testbed.gige import FakeGigeCamera
from tests.gige import fake_gige

# [s] Packets on loopback take milliseconds; a busy machine takes longer.
PATIENCE = 60.0


@pytest.fixture(scope="module")
def fake() -> Iterator[FakeGigeCamera]:
    with fake_gige() as camera:
        yield camera


def picture_of(number: int) -> np.ndarray:
    """Grey image with one red row."""
    picture = np.full((256, 320, 3), 40, np.uint8)
    picture[number % 256, :, 2] = 200
    return picture


def test_each_trigger_brings_the_picture_drawn_for_it(fake: FakeGigeCamera) -> None:
    """One frame per trigger, in order, numbered without gaps across the wrap of the ids.

    No frame arrives before the first trigger. Each has the time of the camera's own clock, and is raw and read-only.
    """
    with AravisCamera(fake.name, trigger="Line1") as camera:
        assert camera.triggered and camera.counts_frames and camera.pixel_format == "Mono8"
        with pytest.raises(CameraTimeout, match=r"delivered no frame within 0\.05 s"):
            camera.grab(0.05)
        # The ids of Aravis's fake camera begin at 65300 of 65535.
        for number in range(260):
            assert fake.expose(picture_of(number), taken_at=7.0 + 0.011 * number)
            frame = camera.grab(PATIENCE)
            assert frame.counter == number
            assert frame.image.shape == (256, 320) and frame.image.dtype == np.uint8
            assert np.array_equal(frame.image, picture_of(number)[:, :, 2])
            assert frame.device_time == pytest.approx(7.0 + 0.011 * number, abs=2e-9)
        with pytest.raises(ValueError, match="read-only"):
            frame.image[0, 0] = 1


def test_frames_wait_in_order_until_they_are_fetched_or_forgotten(fake: FakeGigeCamera) -> None:
    with AravisCamera(fake.name, trigger="Line1") as camera:
        for number in range(5):
            assert fake.expose(picture_of(number), float(number))
        assert [camera.grab(PATIENCE).device_time for _ in range(5)] == [None, 1.0, 2.0, 3.0, 4.0]
        assert fake.expose(picture_of(9), 9.0)
        until = time.monotonic() + PATIENCE
        while camera.waiting == 0 and time.monotonic() < until:
            time.sleep(0.01)
        camera.flush()
        assert fake.expose(picture_of(10), 10.0)
        assert camera.grab(PATIENCE).device_time == 10.0


def test_settings_are_locked_and_read_back(fake: FakeGigeCamera) -> None:
    """The camera keeps them, and the shortest trigger period follows the exposure."""
    with AravisCamera(fake.name, trigger="Line1", exposure_output="Line2") as camera:
        held = camera.lock(CameraSettings(exposure=0.004, gain=6.0, gamma=1.0))
        assert held.exposure == pytest.approx(0.004) and (held.gain, held.gamma, held.white_balance) == (6.0, 1.0, None)
        assert fake.state.exposure == pytest.approx(0.004) and fake.state.gain == 6
        assert fake.state.shows_exposure
        assert 0.004 < camera.trigger_period < 0.005
        camera.lock(CameraSettings(exposure=0.0005))
        # The camera's highest frame rate is 500 frames per second.
        assert camera.trigger_period == pytest.approx(0.002)


def test_what_another_program_changed_is_read(fake: FakeGigeCamera) -> None:
    """Present exposure and gain of the camera are read, in seconds and decibels."""
    with AravisCamera(fake.name) as camera:
        locked = camera.lock(CameraSettings(exposure=0.004, gain=6.0))
        assert setting_changes(camera, locked) == ()
        camera.lock(CameraSettings(exposure=0.01, gain=12.0))
        assert camera.held(locked).values == {"exposure": pytest.approx(0.01), "gain": 12.0}
        assert len(setting_changes(camera, locked)) == 2


@pytest.mark.parametrize(
    ("settings", "expected_text"),
    [
        ({"exposure": 5.0}, r"asked for exposure 5 s; allowed: 1e-05 \.\.\. 1 s"),
        ({"gain": 40.0}, r"asked for gain 40; allowed: 0 \.\.\. 24"),
        ({"white_balance": 5000.0}, "raw frames, which have no white balance"),
        ({"gamma": 0.45}, "has no setting gamma"),
    ],
)
def test_what_it_cannot_hold_is_refused(fake: FakeGigeCamera, settings: dict[str, float], expected_text: str) -> None:
    with AravisCamera(fake.name) as camera, pytest.raises(CameraSettingRefused, match=expected_text):
        camera.lock(CameraSettings(**settings))


@pytest.mark.parametrize("pattern", BAYER)
def test_a_raw_mosaic_comes_as_it_is(fake: FakeGigeCamera, pattern: str) -> None:
    """Each pixel has the colour given by the name of the pattern."""
    rng = np.random.default_rng(4)
    picture = rng.integers(0, 256, (256, 320, 3), dtype=np.uint8)
    with AravisCamera(fake.name, trigger="Line1", pixel_format=pattern, raw=True) as camera:
        assert fake.expose(picture, 1.0)
        seen = camera.grab(PATIENCE).image
    assert np.array_equal(seen, mosaic(picture, pattern))
    colours = pattern[5:7]
    assert [int(seen[0, 0]), int(seen[0, 1])] == [
        int(picture[0, column, "BGR".index(colours[column])]) for column in (0, 1)
    ]


def test_of_a_mosaic_the_red_pixels_are_taken(fake: FakeGigeCamera) -> None:
    """Red pixels form an image of half the width and height; a requested size is that of the frames."""
    rng = np.random.default_rng(6)
    picture = rng.integers(0, 256, (256, 320, 3), dtype=np.uint8)
    with AravisCamera(fake.name, trigger="Line1", pixel_format="BayerGB8", size=(160, 128)) as camera:
        assert fake.expose(picture, 1.0)
        seen = camera.grab(PATIENCE).image
    assert not seen.flags.writeable
    assert np.array_equal(seen, picture[1::2, ::2, 2])


def test_without_a_trigger_it_runs_freely(fake: FakeGigeCamera) -> None:
    """Triggers are then ignored."""
    with AravisCamera(fake.name, fps=50.0) as camera:
        assert not camera.triggered
        first, second = camera.grab(PATIENCE), camera.grab(PATIENCE)
        assert second.counter > first.counter and second.stamp > first.stamp - 1.0
        assert not fake.expose(picture_of(0), 1.0)


def test_part_of_the_sensor_is_read_from_its_centre(fake: FakeGigeCamera) -> None:
    with AravisCamera(fake.name, trigger="Line1", size=(160, 100)) as camera:
        assert fake.state.size == (160, 100)
        assert fake.expose(picture_of(5)[:100, :160], 1.0)
        assert camera.grab(PATIENCE).image.shape == (100, 160)


def test_it_opens_again_after_it_was_closed(fake: FakeGigeCamera) -> None:
    camera = AravisCamera(fake.name, trigger="Line1")
    for _ in range(2):
        with camera:
            camera.open()
            assert fake.expose(picture_of(3), 3.0)
            assert camera.grab(PATIENCE).counter == 0
        camera.close()
        with pytest.raises(CameraNotOpen, match="use `with camera:`"):
            camera.grab(0.01)


def test_it_is_listed(fake: FakeGigeCamera) -> None:
    found = find_aravis_cameras()
    assert [(device.maker, device.model, device.serial, device.protocol) for device in found] == [
        ("Aravis", "Fake", "GUARA1", "GigEVision")
    ]
    with AravisCamera(found[0].name) as camera:
        assert camera.name == "camera aravis:GUARA1" and camera.identity == "Aravis Fake, serial GUARA1"


@pytest.mark.parametrize(
    ("options", "expected_text"),
    [
        ({"trigger": "Line7"}, r"asked for trigger 'Line7'; allowed: Line0, Line1"),
        ({"size": (640, 480)}, "asked for 640 x 480 pixels, but its sensor has 320 x 256"),
        ({"exposure_output": "Line9"}, r"asked for LineSelector 'Line9'; allowed: Line1, Line2"),
    ],
)
def test_what_it_does_not_have_is_refused(fake: FakeGigeCamera, options: dict, expected_text: str) -> None:
    camera = AravisCamera(fake.name, **options)
    with pytest.raises(CameraSettingRefused, match=expected_text):
        camera.open()
    with AravisCamera(fake.name):
        pass  # The camera was released.


def test_a_camera_that_is_not_there(fake: FakeGigeCamera) -> None:
    with pytest.raises(CameraNotFound, match="`guara doctor --cameras` lists"):
        AravisCamera("Nobody-42").open()


def test_a_camera_that_another_program_holds(fake: FakeGigeCamera) -> None:
    """The camera stays with the other program."""
    with AravisCamera(fake.name, trigger="Line1") as first:
        with pytest.raises(CameraNotFound, match="no other program uses it"):
            AravisCamera(fake.name).open()
        assert fake.expose(picture_of(0), 1.0)
        first.grab(PATIENCE)


def test_an_unknown_pixel_format() -> None:
    with pytest.raises(ValueError, match="pixel format is 'RGB8', allowed: Mono8, BayerRG8"):
        AravisCamera(pixel_format="RGB8")


@given(st.lists(st.integers(1, 500), min_size=1, max_size=300), st.integers(1, SHORT_IDS))
def test_counting_goes_on_where_short_numbers_begin_again(increments: list[int], start: int) -> None:
    """The counter continues for any gap and any position of the wrap (1 after 65535, never 0)."""
    camera = AravisCamera()
    true = start
    camera._count(start)
    for increment in increments:
        true += increment
        camera._count((true - 1) % SHORT_IDS + 1)
        assert camera._counter == true - start


def test_a_camera_that_does_not_answer_while_it_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of Aravis are converted to driver errors."""

    def lock_settings(*_: object) -> None:
        raise BrokenPipeError("Timeout")

    camera = AravisCamera("cam")
    monkeypatch.setattr(camera, "_camera", object())
    monkeypatch.setattr(aravis_camera, "lock_settings", lock_settings)
    monkeypatch.setattr(aravis_camera, "glib_error", lambda: BrokenPipeError)
    with pytest.raises(CameraError, match=r"camera aravis:cam cannot be set \(Timeout\): check its cable"):
        camera.lock(CameraSettings(gain=1.0))


def test_without_aravis_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    monkeypatch.setattr(aravis_library, "SYSTEM_PACKAGES", ("/nowhere",))
    with pytest.raises(CameraBackendMissing, match=r"apt install gir1\.2-aravis-0\.8 python3-gi"):
        AravisCamera().open()


@pytest.mark.slow
def test_a_gi_for_another_python_is_distinguished_from_a_missing_one(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    (tmp_path / "gi").mkdir()
    (tmp_path / "gi" / "__init__.py").write_text("from . import _gi\n")
    monkeypatch.setitem(sys.modules, "gi", None)
    monkeypatch.setitem(sys.modules, "gi._gi", None)
    monkeypatch.setattr(aravis_library, "SYSTEM_PACKAGES", (str(tmp_path),))
    with pytest.raises(CameraBackendMissing, match=r"not for this Python 3\.\d+ .*PyGObject<3\.51"):
        aravis_library.load_aravis()
