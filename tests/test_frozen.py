"""Frozen grids make the same bytes as on the day they were frozen, and frames the same grids."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from guara_perception.app.map_summary import message_to_regions, message_to_summary
from guara_perception.app.messages import message_to_terrain
from tests import frozen
from transport.messages.compact import rounded
from transport.messages.regions_message import decode_regions
from transport.messages.summary_message import decode_summary
from transport.messages.terrain_codec import decode_terrain, encode_terrain

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


@each_grid
def test_a_grid_makes_the_same_message(name: str) -> None:
    same(bytes(encode_terrain(frozen.message_of(name, frozen.frozen(name)))), frozen.payloads()[name], f"{name}: CDR")


@each_grid
def test_a_grid_makes_the_same_small_messages(name: str) -> None:
    """What zstd makes of them is its own affair: compared is what it was given."""
    for ending, payload in frozen.encodings(name, frozen.frozen(name)).items():
        content = (frozen.FROZEN / f"{name}{ending}").read_bytes()
        same(frozen.uncompressed(ending, payload), frozen.uncompressed(ending, content), f"{name}{ending}")


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
    """Flags are equal, and heights to 1e-6 m: what is rounded otherwise on another processor may differ."""
    now, then = frozen.from_frames(name), frozen.frozen(name)
    assert now.geometry == then.geometry
    changed = np.count_nonzero(now.hazard != then.hazard)
    assert changed == 0, f"{name}: {changed} cells have other flags; it {HOW}"
    for layer in ("elevation", "elevation_min", "elevation_max"):
        np.testing.assert_allclose(
            now.layers[layer], then.layers[layer], rtol=0, atol=1e-6, err_msg=f"{name}, {layer}: {HOW}"
        )
