"""Summary of a map: never safer than the map, close to it, and received over Zenoh without a history."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.app.map_summary import MAXIMUM_BYTES, merged, message_to_summary, summary_payload
from guara_perception.app.messages import terrain_to_message
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from tests.thorough import examples
from transport import TerrainMessage
from transport.messages.map_messages import decode_summary

PATIENCE = 60.0


def _summary(terrain: gp.TerrainGrid) -> gp.TerrainSummary:
    return message_to_summary(decode_summary(summary_payload(terrain_to_message(terrain, robot="rex", sequence=3))))


def _map_message(terrain: gp.TerrainGrid) -> TerrainMessage:
    return dataclasses.replace(terrain_to_message(terrain, robot="rex", sequence=3), extent="map")


def test_a_scanned_grid_is_small_and_close(paper_terrain: gp.TerrainGrid) -> None:
    """Equal flags, heights to half a millimetre, traversability lower by at most 1/255 and never higher."""
    small = _summary(paper_terrain)
    assert np.array_equal(small.hazard, paper_terrain.hazard)
    assert np.array_equal(np.isnan(small.elevation), np.isnan(paper_terrain.elevation))
    known = ~np.isnan(small.elevation)
    assert np.abs(small.elevation - paper_terrain.elevation)[known].max() <= 0.5e-3 + 1e-6
    lost = paper_terrain.traversability - small.traversability
    assert lost.min() >= -1e-6 and lost.max() < 1 / 255 + 1e-6
    assert np.array_equal(small.traversability > 0, paper_terrain.traversability > 0)
    message = terrain_to_message(paper_terrain, robot="rex", sequence=3)
    assert len(summary_payload(message)) < 12_000
    assert (small.robot, small.step, small.sequence, small.shape) == ("rex", paper_terrain.step, 3, paper_terrain.shape)
    assert not small.elevation.flags.writeable and not small.hazard.flags.writeable
    x, y = (float(centre[5]) for centre in paper_terrain.geometry.centres())
    assert small.is_traversable(x, y) == paper_terrain.is_traversable(x, y)
    np.testing.assert_allclose(small.height_at(x, y), paper_terrain.height_at(x, y), atol=0.51e-3)
    assert np.isnan(small.height_at(9.0, 9.0)) and not small.is_traversable(9.0, 9.0)


@pytest.mark.slow
@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 0.4), tall=st.integers(0, 3))
def test_no_cell_becomes_safer(seed: int, share: float, tall: int) -> None:
    """For any heights and gaps: a cell that is not traversable in the map is not traversable in the summary."""
    rng = np.random.default_rng(seed)
    elevation = rng.normal(0, 0.004, (24, 30)).astype(np.float32)
    elevation[rng.random(elevation.shape) < share * share] = np.nan
    terrain = gp.assess_terrain(elevation, 0.005)
    layers = dict(terrain.layers)
    # Any score above zero, and heights beyond the range of a summary.
    score = np.where(layers["hazard"] == 0, rng.random(elevation.shape) ** 8 + 1e-7, 0)
    layers["traversability"] = np.minimum(score, 1).astype(np.float32)
    lift = np.zeros((24, 30), np.float32)
    for _ in range(tall):
        lift[rng.integers(0, 24), rng.integers(0, 30)] += 40.0
    for name in ("elevation", "elevation_min", "elevation_max"):
        layers[name] = layers[name] + lift
    terrain = dataclasses.replace(terrain, layers=layers)
    small = _summary(terrain)
    assert not np.any((small.traversability > 0) & (terrain.traversability == 0))
    assert not np.any((small.hazard & UNKNOWN_MASK != 0) & (small.traversability > 0))
    assert np.all(small.traversability <= terrain.traversability + 1e-6)
    was_unknown = (terrain.hazard & UNKNOWN_MASK) != 0
    assert np.all(np.isnan(small.elevation)[was_unknown])
    assert np.all(
        small.hazard[was_unknown] == terrain.hazard[was_unknown] | (small.hazard[was_unknown] & gp.Hazard.EDGE)
    )


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 90), st.integers(1, 90)),
    share=st.floats(0, 0.2),
    maximum=st.integers(600, 6000),
)
def test_noise_fits_too_and_no_cell_becomes_safer(
    seed: int, shape: tuple[int, int], share: float, maximum: int
) -> None:
    """Worst case for compression: each cell has its own height, flags and score. Merged cells are as unsafe as the
    worst.
    """
    rng = np.random.default_rng(seed)
    terrain = gp.assess_terrain(np.zeros(shape, np.float32), 0.005)
    hazard = np.where(rng.random(shape) < 0.5, 0, rng.integers(0, 2**16, shape)).astype(np.uint16)
    hazard[rng.random(shape) < share * share] = gp.Hazard.UNSCANNED.value
    unknown = (hazard & UNKNOWN_MASK) != 0
    hazard[(hazard == 0) & (cv2.dilate(unknown.astype(np.uint8), np.ones((3, 3))) > 0)] = gp.Hazard.EDGE.value
    layers = dict(terrain.layers)
    layers["hazard"] = hazard
    layers["elevation"] = np.where(unknown, np.nan, rng.uniform(-32, 32, shape)).astype(np.float32)
    layers["traversability"] = np.where(hazard == 0, rng.uniform(0.01, 1, shape), 0).astype(np.float32)
    message = dataclasses.replace(_map_message(terrain), layers=layers)
    sent = summary_payload(message, maximum)
    assert len(sent) <= maximum
    small = message_to_summary(decode_summary(sent))
    cells = round(small.resolution / 0.005)
    assert small.resolution == pytest.approx(cells * 0.005)
    iy, ix = np.indices(shape) // cells
    assert small.shape == (iy.max() + 1, ix.max() + 1)
    assert np.all(small.traversability[iy, ix] <= layers["traversability"] + 1e-6)
    assert np.all(np.isnan(small.elevation[iy, ix])[unknown])
    assert not np.any(hazard & ~small.hazard[iy, ix])
    height = small.elevation[iy, ix]
    assert np.all(np.isnan(height) | (height >= layers["elevation"] - 0.51e-3))


def test_noise_of_a_whole_map_gets_larger_cells_and_a_scanned_one_keeps_its_own(
    paper_terrain: gp.TerrainGrid,
) -> None:
    """A map of the published size, known everywhere, with a different height and score in each cell."""
    assert decode_summary(summary_payload(_map_message(paper_terrain))).resolution == paper_terrain.resolution
    rng, shape = np.random.default_rng(1), (140, 320)
    terrain = gp.assess_terrain(np.zeros(shape, np.float32), 0.005)
    layers = dict(terrain.layers)
    layers["hazard"] = (rng.integers(0, 2**8, shape) << 8).astype(np.uint16)
    layers["elevation"] = rng.uniform(-32, 32, shape).astype(np.float32)
    layers["traversability"] = np.where(layers["hazard"] == 0, rng.uniform(0.01, 1, shape), 0).astype(np.float32)
    worst = dataclasses.replace(_map_message(terrain), layers=layers)
    payloads = summary_payload(worst, 10**6), summary_payload(worst)
    assert len(payloads[0]) > 100_000 > MAXIMUM_BYTES >= len(payloads[1])
    whole, small = map(decode_summary, payloads)
    assert (whole.resolution, small.resolution) == pytest.approx((0.005, 0.020))
    assert merged(whole, 512).shape == (1, 1)


def test_a_summary_that_breaks_the_invariant_is_refused(paper_terrain: gp.TerrainGrid) -> None:
    """A flag lost in transit would make a cell safe: nothing is returned."""
    message = decode_summary(summary_payload(terrain_to_message(paper_terrain, robot="rex", sequence=1)))
    for layer, value in (("hazard", 0), ("traversability", 200), ("heights", 5)):
        changed = np.array(getattr(message, layer))
        iy, ix = (int(i[0]) for i in np.nonzero(paper_terrain.hazard & UNKNOWN_MASK))
        changed[iy, ix] = value
        with pytest.raises(gp.UnsafeGrid, match="summary received from 'rex'"):
            message_to_summary(dataclasses.replace(message, **{layer: changed}))


@pytest.mark.slow
def test_it_comes_with_each_map_and_has_no_history(start, free_endpoint: str, terrain_file: Path, eventually) -> None:
    """The first call waits; later calls return the newest; an old or missing summary is reported."""
    node = start(Path(__file__).with_name("publishing_node.py"), free_endpoint, "rex", terrain_file)
    assert node.line() == "ready"
    node.tell("map 1")
    with gp.TerrainClient(free_endpoint, robot="rex", timeout=PATIENCE) as client:
        with pytest.raises(gp.ReceiveTimeout, match="rex/perception/v1/summary"):
            client.summary(timeout=1.0)
        node.tell("map 2")
        small, whole = client.summary(timeout=PATIENCE), client.wait_for_step(2, PATIENCE, "map")
        assert (small.step, small.sequence, small.robot) == (2, 2, "rex")
        assert np.array_equal(small.hazard, whole.hazard)
        node.tell("map 3")
        client.wait_for_step(3, PATIENCE, "map")
        assert eventually(lambda: client.summary().step == 3)
        with pytest.raises(gp.StaleTerrain, match="newest summary grid"):
            client.summary(timeout=0.5, max_age=0.0)
    with gp.TerrainClient(free_endpoint, robot="nobody", timeout=PATIENCE) as client:
        with pytest.raises(gp.ScannerUnavailable):
            client.summary(timeout=0.5)
