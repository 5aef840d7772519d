"""Grids frozen as files, and the bytes that encodings make of them; `python -m tests.frozen [--bytes]` freezes anew."""

from __future__ import annotations

import argparse
import dataclasses
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

import guara_perception as gp
from guara_perception.app.map_summary import regions_message, summary_payload
from guara_perception.app.messages import terrain_to_message
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Box, Step
from guara_perception.simulation.walk import WalkNoise, simulate_walk
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import LegOdometry, load_robot
from testbed.truth import truth_calibration
from transport import TerrainMessage
from transport.messages.codec import decode, encode
from transport.messages.map_messages import LAYERS as SUMMARY_LAYERS
from transport.messages.map_messages import encode_regions
from transport.messages.shuffle import decompress
from transport.messages.terrain_message import encode_compact, encode_terrain
from transport.messages.typestore import REGIONS, SUMMARY, TERRAIN
from transport.recording.writer import RecordingWriter

DATA = Path(__file__).parent / "data"
FROZEN = DATA / "frozen"
RECORDING = FROZEN / "grids.mcap"
SCANS = ("paper", "dark", "tilt")
GRIDS = (*SCANS, "walk")
# Type of what a grid's other encodings hold, by the ending of their file.
KINDS = {".compact": TERRAIN, ".summary": SUMMARY, ".regions": REGIONS}
# [m] A quarter of the cells: the data stay small.
RESOLUTION = 0.010
# [px] One grid has its range images, of which every so many pixels are kept.
THINNING = 16
SECONDS = {"extract": 0.25, "triangulate": 0.125, "raster": 0.0625, "finish": 0.03125}
START_NS, PAUSE_NS = 1_700_000_000_000_000_000, 4_675_000_000
PAUSES = 3
# What tells one message of a running node from another.
STATED = {"run": "0123456789abcdef", "scan_end_clock": 1234.5}


def from_frames(name: str) -> gp.TerrainGrid:
    """One of `GRIDS` made from frames as the product is now, but for the seconds that it took."""
    if name == "walk":
        return _walk()
    terrain = gp.process_scan(
        DATA / "scans" / name, truth_calibration(DATA), "guara", resolution=RESOLUTION, pictures=name == "paper"
    )
    thin = {each: picture[::THINNING, ::THINNING].copy() for each, picture in terrain.pictures.items()}
    return dataclasses.replace(_with_fixed_seconds(terrain), pictures=thin)


def _walk() -> gp.TerrainGrid:
    """The map after a few simulated pauses before a box and a step."""
    robot = load_robot("guara")
    world = World(features=(Box(x=0.62, y=0.05, size=(0.10, 0.08), height=0.03), Step(x=0.75, height=0.02)))
    calibration = specimen(robot)
    rangefinder = SimulatedRangefinder(world, calibration, robot, seed=1)
    odometry, walk_map = LegOdometry(robot), gp.TerrainMap(robot, resolution=RESOLUTION)
    fused = None
    for pause, _ in zip(simulate_walk(world, robot, seed=2, noise=WalkNoise(slide=0.0)), range(PAUSES), strict=False):
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor = gp.ScanProcessor(
            calibration,
            robot,
            pause.stance,
            "coarse",
            resolution=RESOLUTION,
            stamp=START_NS + pause.step * PAUSE_NS,
            step=pause.step,
        )
        for index, on, off in rangefinder.frames(range(0, 70, 2)):
            processor.add(index, on, off)
        fused = walk_map.update(
            _with_fixed_seconds(processor.finish("wide")),
            odometry.update(pause.stance),
            known_ground=pause.known_ground,
        )
    assert fused is not None
    return fused


def _with_fixed_seconds(terrain: gp.TerrainGrid) -> gp.TerrainGrid:
    assert set(terrain.metadata["seconds"]) == set(SECONDS)
    return dataclasses.replace(terrain, record=ScanRecord.from_json({**terrain.metadata, "seconds": SECONDS}))


def message_of(name: str, terrain: gp.TerrainGrid) -> TerrainMessage:
    """The message of a frozen grid."""
    return terrain_to_message(
        terrain,
        robot="frozen",
        sequence=1 + GRIDS.index(name),
        scan_start=terrain.stamp - 1_400_000_000,
        valid_for=30.0,
        stated=STATED,
    )


def encodings(name: str, terrain: gp.TerrainGrid) -> dict[str, bytes]:
    """The bytes of a grid by the ending of their file."""
    message = message_of(name, terrain)
    return {
        ".compact": encode_compact(message),
        ".summary": bytes(summary_payload(message)),
        ".regions": bytes(encode_regions(regions_message(terrain, message))),
    }


def npz_content(content: bytes) -> dict[str, bytes]:
    """What an .npz file holds, by member: another zlib may make other bytes of the same."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def uncompressed(ending: str, payload: bytes) -> bytes:
    """What an encoding holds, without zstd, of which another version may make other bytes of the same."""
    if ending == ".compact":
        return decompress(payload)
    if ending == ".summary":
        message = decode(payload, SUMMARY)
        for layer, dtype in SUMMARY_LAYERS.items():
            plain = decompress(getattr(message, layer).tobytes(), dtype.itemsize)
            setattr(message, layer, np.frombuffer(plain, np.uint8))
        return bytes(encode(message))
    return payload


def record(path: Path, grids: dict[str, gp.TerrainGrid]) -> None:
    """Write the grids as a recording."""
    with RecordingWriter(path, robot="frozen", calibration=b"{}") as writer:
        for name, terrain in grids.items():
            writer.add_terrain(message_of(name, terrain))


def recorded(path: Path) -> Iterator[tuple[tuple[Any, ...], bytes]]:
    """What a recording holds but for the time of writing: the description of every attachment and message, its bytes.

    Read by mcap itself: chunks are compressed by zstd, so the bytes of the file are not the same for every version.
    """
    with path.open("rb") as stream:
        reader = make_reader(stream)
        for attachment in reader.iter_attachments():
            yield (attachment.name, attachment.media_type), attachment.data
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            kind = channel.message_encoding, channel.metadata, schema.name, schema.encoding, schema.data
            yield (channel.topic, reader.get_header().profile, *kind), message.data


def payloads(path: Path = RECORDING) -> dict[str, bytes]:
    """The Terrain payloads of a recording, by the name of the grid."""
    with path.open("rb") as stream:
        return dict(zip(GRIDS, (message.data for _, _, message in make_reader(stream).iter_messages()), strict=True))


def frozen(name: str) -> gp.TerrainGrid:
    """One of `GRIDS` from its frozen file."""
    return gp.load_terrain(FROZEN / f"{name}.npz")


def freeze(*, grids_too: bool) -> None:
    """Make the frozen files anew: the grids from frames, and the bytes of all encodings."""
    grids = {}
    for name in GRIDS:
        if grids_too:
            from_frames(name).save(FROZEN / f"{name}.npz")
        grids[name] = frozen(name)
        for ending, payload in encodings(name, grids[name]).items():
            (FROZEN / f"{name}{ending}").write_bytes(payload)
    if payloads() != {name: bytes(encode_terrain(message_of(name, terrain))) for name, terrain in grids.items()}:
        RECORDING.unlink()
        record(RECORDING, grids)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bytes", action="store_true", help="keep the grids, and freeze what encodings make of them")
    freeze(grids_too=not parser.parse_args().bytes)
