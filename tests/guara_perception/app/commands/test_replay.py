"""`guara replay`: fused grids of recorded scans, saved and published, and refusals of bad input."""

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.writer import Writer

import guara_perception as gp
from guara_perception.app.commands import replay
from guara_perception.app.files import open_scan
from guara_perception.app.files.convert import _write_recording as write_recording
from guara_perception.terrain.layers.hazard import Hazard

GUARA = ("-m", "guara_perception.app.main")


@pytest.mark.slow
def test_saves_both_grids_of_every_pause(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """One file and one line per pause and extent; the second map contains the ground of both scans."""
    scans = data / "scans"
    said = guara("replay", scans / "paper", scans / "dark", "-c", calibration_file, "-o", tmp_path / "grids")
    assert said.code == 0 and said.err == ""
    assert sorted(path.name for path in (tmp_path / "grids").iterdir()) == [
        "0000-step0-footprint.npz", "0000-step0-map.npz", "0001-step2-footprint.npz", "0001-step2-map.npz"
    ]  # fmt: skip
    assert [line.split(":")[0] for line in said.out.splitlines()] == ["footprint", "map"] * 2
    first, second = (gp.load_terrain(tmp_path / "grids" / f"{name}-map.npz") for name in ("0000-step0", "0001-step2"))
    assert (first.extent, first.shape, second.step) == ("map", (140, 320), 2)
    assert second.metadata["scans"] == 2
    # Two scans of different boxes from the same position contradict each other.
    assert np.count_nonzero(second.hazard & Hazard.CONFLICT) > 500


@pytest.mark.slow
def test_only_the_extent_that_is_wanted(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """--extent map writes no footprints."""
    said = guara("replay", data / "scans" / "tilt", "-c", calibration_file, "-o", tmp_path, "--extent", "map")
    assert said.code == 0
    assert [path.name for path in tmp_path.iterdir()] == ["0000-step4-map.npz"]


@pytest.mark.slow
def test_an_earlier_step_begins_another_walk(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """Step 0 after step 2 is reported, and the map contains the last scan only."""
    scans = data / "scans"
    said = guara("replay", scans / "dark", scans / "paper", "-c", calibration_file, "-o", tmp_path, "--extent", "map")
    assert said.code == 0
    assert "step 0 after step 2: another walk; the map restarts" in said.out
    assert gp.load_terrain(tmp_path / "0001-step0-map.npz").metadata["scans"] == 1


@pytest.mark.slow
def test_walks_of_one_recording_are_kept_apart(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """If the steps restart within a file, each walk has its own map and its own files."""
    paper, dark = (gp.open_scan(data / "scans" / name) for name in ("paper", "dark"))
    write_recording([paper, dark, paper], None, tmp_path / "walks.mcap", None)
    said = guara("replay", tmp_path / "walks.mcap", "-c", calibration_file, "-o", tmp_path / "maps", "--extent", "map")
    assert said.code == 0 and "step 0 after step 2: another walk; the map restarts" in said.out
    maps = sorted((tmp_path / "maps").iterdir())
    assert [path.name for path in maps] == ["0000-step0-map.npz", "0001-step2-map.npz", "0002-step0-map.npz"]
    assert [gp.load_terrain(path).metadata["scans"] for path in maps] == [1, 2, 1]


@pytest.mark.slow
def test_another_epoch_is_another_walk(
    guara, monkeypatch: pytest.MonkeyPatch, data: Path, calibration_file: Path, tmp_path: Path
):
    """A new epoch begins another walk even if the steps continue."""
    scans = [replace(gp.open_scan(data / "scans" / name), epoch=name) for name in ("paper", "dark")]
    monkeypatch.setattr(open_scan, "open_scans", lambda path: scans)
    said = guara("replay", tmp_path, "-c", calibration_file, "-o", tmp_path, "--extent", "map")
    assert said.code == 0 and "step 2 after step 0: another walk; the map restarts" in said.out
    assert gp.load_terrain(tmp_path / "0001-step2-map.npz").metadata["scans"] == 1


@pytest.mark.slow
def test_publishes_for_planners(
    start, guara, monkeypatch: pytest.MonkeyPatch, data: Path, calibration_file: Path, free_endpoint: str
):
    """A listener in another process receives the fused grid of each pause, even if it joins after the first."""
    scans, pauses, listeners = data / "scans", [], []

    def sleep(seconds: float) -> None:
        """Wait between two grids, and after the last, until the listener has received them."""
        pauses.append(seconds)
        if not listeners:
            arguments = ("listen", "--connect", free_endpoint, "--extent", "map", "--count", "2", "--timeout", "60")
            listeners.append(start(*GUARA, *arguments))
        step = ("step 0", "step 4")[len(pauses) - 1]
        assert listeners[0].line().startswith(f"guara map #{len(pauses)}: {step}, coarse, 320x140 cells")

    monkeypatch.setattr(replay, "time", SimpleNamespace(sleep=sleep, time_ns=time.time_ns))
    said = guara(
        "replay", scans / "paper", scans / "tilt", "-c", calibration_file, "--publish",
        "--listen", free_endpoint, "--interval", "8", "--extent", "map",
    )  # fmt: skip
    assert said.code == 0 and said.out.splitlines()[0] == f"guara: publishing on {free_endpoint}"
    assert pauses == [8.0, 8.0]
    assert listeners[0].wait() == 0


FOREIGN = {
    "pictures of a camera": ("/camera/image", "sensor_msgs/msg/Image", "cdr", b"\x00\x01\x00\x00" + bytes(60)),
    "text in JSON": ("/chatter", "chatter", "json", b'{"data": "hello"}'),
    "topic of a scan, other bytes": (
        "/guara/scan/start",
        "guara_msgs/msg/ScanStart",
        "cdr",
        b"\x00\x01\x00\x00nonsense",
    ),
    "topic of a scan, JSON": ("/guara/scan/start", "start", "json", b"{}"),
    "topic of a grid, other bytes": (
        "/guara/terrain",
        "guara_msgs/msg/Terrain",
        "cdr",
        b"\x00\x01\x00\x00" + bytes(40),
    ),
}


def _write_foreign(path: Path, topic: str, schema: str, encoding: str, payload: bytes) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema(schema, "ros2msg" if encoding == "cdr" else "jsonschema", b"")
        channel = writer.register_channel(topic, encoding, number)
        for instant in range(3):
            writer.add_message(channel, instant, payload, instant)
        writer.finish()


@pytest.mark.parametrize("kind", FOREIGN)
def test_a_foreign_recording_is_reported(guara, calibration_file: Path, tmp_path: Path, kind: str):
    """A valid .mcap of another program gives one line and exit 2 from commands that need a scan."""
    path = tmp_path / "foreign.mcap"
    _write_foreign(path, *FOREIGN[kind])
    for arguments in (
        ("replay", path, "-c", calibration_file),
        ("process", path, "-c", calibration_file, "-o", tmp_path / "t.npz"),
        ("convert", path, tmp_path / "folder"),
    ):
        said = guara(*arguments)
        assert said.code == 2 and str(path) in said.err and said.err.count("\n") == 1, said
    assert guara("info", path).code in (0, 2)
    assert guara("recover", path, "-o", tmp_path / "whole.mcap").code in (0, 1, 2)
    assert not (tmp_path / "t.npz").exists() and not (tmp_path / "folder").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--extent", "world"], "--extent has 'world'; allowed: footprint, map"),
        (["--listen", "tcp/127.0.0.1:1"], "require --publish"),
        (["--method", "fast"], "allowed: "),
        (["-o", "FILE"], "is a file; a folder is needed"),
        (["--robot", "tapir"], "tapir"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    guara, data: Path, calibration_file: Path, tmp_path: Path, arguments: list[str], message: str
):
    """Exit 2, one line, nothing written."""
    file = tmp_path / "file"
    file.write_text("")
    given = [str(file) if word == "FILE" else word for word in arguments]
    said = guara("replay", data / "scans" / "paper", "-c", calibration_file, *given)
    assert said.code == 2
    assert message in said.err and said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [file]


def test_missing_scans_are_refused(guara, calibration_file: Path, tmp_path: Path):
    """No scan argument, or a scan that does not exist."""
    assert guara("replay", "-c", calibration_file).code == 2
    said = guara("replay", tmp_path / "nothing", "-c", calibration_file)
    assert said.code == 2
    assert "no such scan" in said.err
