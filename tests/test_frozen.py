"""Frozen grids make the same bytes as on the day they were frozen, and frames the same grids."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guara_perception.app.map_summary import message_to_regions, message_to_summary
from guara_perception.app.messages import message_to_terrain
from tests import frozen
from transport.messages.codec import decode, encode
from transport.messages.map_messages import decode_regions, decode_summary
from transport.messages.terrain_message import decode_terrain, encode_terrain, rounded
from transport.messages.typestore import TERRAIN

HOW = (
    "is not as it was frozen. If that is meant, and for a reason that the changelog tells: `python -m tests.frozen` "
    "freezes anew (--bytes: without the grids themselves); commit tests/data/frozen alone, with the reason"
)
each_grid = pytest.mark.parametrize("name", frozen.GRIDS)


def same(one: bytes, other: bytes, what: str) -> None:
    """Fail with the place of the first difference, where pytest would print all bytes."""
    if one != other:
        first = next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
        around = slice(max(0, first - 40), first + 40)
        pytest.fail(f"{what} {HOW}. From byte {first} of {len(one)}: {one[around]!r}, frozen: {other[around]!r}")


def same_message(one: bytes, other: bytes, kind: str, what: str) -> None:
    """The frozen bytes are encoded as they were, and the fields are the same.

    Corners of outlines are computed from the grid, and their last bit differs between processors.
    """
    same(bytes(encode(decode(other, kind))), other, what)
    same_fields(decode(one, kind), decode(other, kind), what)


def same_fields(one: Any, other: Any, what: str) -> None:
    """Fail where a field differs, a float64 by more than rounding."""
    if dataclasses.is_dataclass(other):
        for field in dataclasses.fields(other):
            same_fields(getattr(one, field.name), getattr(other, field.name), f"{what}: {field.name}")
    elif isinstance(other, list):
        assert len(one) == len(other), f"{what} {HOW}"
        for a, b in zip(one, other, strict=True):
            same_fields(a, b, what)
    elif isinstance(other, float) or getattr(other, "dtype", None) == np.float64:
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12, err_msg=f"{what} {HOW}")
    else:
        np.testing.assert_array_equal(one, other, err_msg=f"{what} {HOW}")


@each_grid
def test_a_grid_makes_the_same_message(name: str) -> None:
    now, then = encode_terrain(frozen.message_of(name, frozen.frozen(name))), frozen.payloads()[name]
    same_message(bytes(now), then, TERRAIN, f"{name}: CDR")


@each_grid
def test_a_grid_makes_the_same_small_messages(name: str) -> None:
    """What zstd makes of them is its own affair: compared is what it was given."""
    for ending, payload in frozen.encodings(name, frozen.frozen(name)).items():
        content = (frozen.FROZEN / f"{name}{ending}").read_bytes()
        now, then = (frozen.uncompressed(ending, each) for each in (payload, content))
        same_message(now, then, frozen.KINDS[ending], f"{name}{ending}")


@each_grid
def test_a_grid_makes_the_same_file(name: str, tmp_path: Path) -> None:
    frozen.frozen(name).save(tmp_path / "grid.npz")
    now, then = (frozen.npz_content(p.read_bytes()) for p in (tmp_path / "grid.npz", frozen.FROZEN / f"{name}.npz"))
    assert list(now) == list(then), f"{name}.npz {HOW}"
    for member, content in now.items():
        same(content, then[member], f"{name}.npz: {member}")


def test_grids_make_the_same_recording(tmp_path: Path) -> None:
    frozen.record(tmp_path / "grids.mcap", {name: frozen.frozen(name) for name in frozen.GRIDS})
    now, then = list(frozen.recorded(tmp_path / "grids.mcap")), list(frozen.recorded(frozen.RECORDING))
    assert [described for described, _ in now] == [described for described, _ in then], f"grids.mcap {HOW}"
    for (described, one), (_, other) in zip(now, then, strict=True):
        if described[0] in ("/frozen/terrain", "/frozen/map"):
            same_message(one, other, TERRAIN, f"grids.mcap: {described[0]}")
        else:
            same(one, other, f"grids.mcap: {described[0]}")


@each_grid
def test_frozen_bytes_are_read_as_the_same_grid(name: str) -> None:
    terrain = frozen.frozen(name)
    message = frozen.message_of(name, terrain)
    for read, wanted in (
        (decode_terrain(frozen.payloads()[name]), message),
        (decode_terrain((frozen.FROZEN / f"{name}.compact").read_bytes()), rounded(message)),
    ):
        assert json.loads(read.metadata) == json.loads(wanted.metadata)
        back = message_to_terrain(read)
        assert (back.stamp, back.step, back.extent, back.geometry) == (
            terrain.stamp,
            terrain.step,
            terrain.extent,
            terrain.geometry,
        )
        assert list(back.layers) == list(terrain.layers)
        for layer, values in wanted.layers.items():
            np.testing.assert_array_equal(back.layers[layer], values, err_msg=layer)


@each_grid
def test_frozen_summary_and_regions_are_read(name: str) -> None:
    terrain = frozen.frozen(name)
    summary = message_to_summary(decode_summary((frozen.FROZEN / f"{name}.summary").read_bytes()))
    np.testing.assert_array_equal(summary.hazard, terrain.hazard)
    np.testing.assert_allclose(summary.elevation, terrain.elevation, atol=0.51e-3)
    regions = message_to_regions(decode_regions((frozen.FROZEN / f"{name}.regions").read_bytes()))
    assert (regions.robot, regions.sequence) == ("frozen", 1 + frozen.GRIDS.index(name))
    for one, other in zip(regions.regions, terrain.steppable_regions(), strict=True):
        np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-9)
        np.testing.assert_allclose(one.plane, other.plane, atol=1e-9)


@pytest.mark.slow
@each_grid
def test_the_same_grid_comes_out_of_the_frames(name: str) -> None:
    """Flags are equal, and heights to 1e-6 m; those of simulated frames to 1e-5 m.

    On another processor a grey level of a simulated frame may be rounded the other way: 7 of 11,200 cells of the walk
    differed by up to 2.1e-6 m between two makes of processors.
    """
    tolerance = 1e-5 if name == "walk" else 1e-6
    now, then = frozen.from_frames(name), frozen.frozen(name)
    assert now.geometry == then.geometry
    changed = np.count_nonzero(now.hazard != then.hazard)
    assert changed == 0, f"{name}: {changed} cells have other flags; it {HOW}"
    for layer in ("elevation", "elevation_min", "elevation_max"):
        np.testing.assert_allclose(
            now.layers[layer], then.layers[layer], rtol=0, atol=tolerance, err_msg=f"{name}, {layer}: {HOW}"
        )
