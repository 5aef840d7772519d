"""Grid files: saved grids are loaded unchanged; other and unsafe files are rejected by name."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory, paper_terrain: gp.TerrainGrid) -> Path:
    """Grid file; never write to it."""
    path = tmp_path_factory.mktemp("grid") / "grid.npz"
    paper_terrain.save(path)
    return path


def test_everything_comes_back(saved: Path, paper_terrain: gp.TerrainGrid):
    """Layers and pictures bit for bit, geometry, times, extent and metadata."""
    loaded = gp.load_terrain(saved)
    for name, layer in paper_terrain.layers.items():
        assert loaded.layer(name).tobytes() == layer.tobytes() and loaded.layer(name).dtype == layer.dtype
    for name, picture in paper_terrain.pictures.items():
        assert loaded.pictures[name].tobytes() == picture.tobytes()
    for name in ("origin", "resolution", "shape", "frame", "stamp", "step", "extent", "metadata"):
        assert getattr(loaded, name) == getattr(paper_terrain, name)


def test_a_stale_grid_stays_stale(paper_terrain: gp.TerrainGrid, tmp_path: Path):
    """With its reasons, also in a file: queries reject it unless stale grids are allowed."""
    dataclasses.replace(paper_terrain, stale_because=("2 pauses old", "withdrawn")).save(tmp_path / "stale.npz")
    terrain = gp.load_terrain(tmp_path / "stale.npz")
    assert terrain.stale_because == ("2 pauses old", "withdrawn") and "stale_because" not in terrain.metadata
    for ask in (terrain.to_occupancy, lambda: terrain.is_traversable(0.7, 0.0)):
        with pytest.raises(gp.StaleTerrain, match="2 pauses old; withdrawn"):
            ask()
    np.testing.assert_array_equal(terrain.to_occupancy(allow_stale=True), paper_terrain.to_occupancy())


def test_grid_without_pictures_is_saved_too(tmp_path: Path):
    """A grid from any heights is saved and loaded with its extent."""
    terrain = gp.assess_terrain(np.zeros((30, 20), np.float32), 0.01, origin=(-0.5, 2.0))
    terrain.save(tmp_path / "t.npz")
    loaded = gp.load_terrain(tmp_path / "t.npz")
    assert dict(loaded.pictures) == {} and loaded.origin == (-0.5, 2.0) and loaded.extent == terrain.extent
    np.testing.assert_array_equal(loaded.hazard, terrain.hazard)


def changed(**values: object):
    """Change of some arrays of the file."""
    return lambda content: content.update({name: np.asarray(value) for name, value in values.items()})


BAD = {
    "layer missing": (lambda c: c.pop("slope"), "not a terrain file; missing arrays: slope"),
    "layer of another type": (lambda c: c.update(slope=c["slope"].astype(np.float64)), "layer slope is float64"),
    "layer of another shape": (lambda c: c.update(slope=c["slope"][:, 1:]), "layer slope is float32 (108, 89)"),
    "flat layers": (lambda c: c.update(elevation=c["elevation"].ravel()), "grid shape is (9720,); it must be (ny, nx)"),
    "origin of three": (changed(origin=np.zeros(3)), "origin is float64 of shape (3,); it must be 2 numbers"),
    "origin NaN": (changed(origin=np.full(2, np.nan)), "it must be two finite numbers"),
    "resolution zero": (changed(resolution=0.0), "resolution is 0.0; it must be a positive number"),
    "resolution a text": (changed(resolution="5 mm"), "resolution is <U4 of shape (); it must be one number"),
    "two stamps": (changed(stamp=[1, 2]), "stamp is int64 of shape (2,); it must be one whole number"),
    "stamp a fraction": (changed(stamp=1.5), "stamp is float64 of shape (); it must be one whole number"),
    "frame a number": (changed(frame=1), "frame is int64 of shape (); it must be one text"),
    "metadata no JSON": (changed(metadata="{"), "metadata: not a JSON file"),
    "metadata a list": (changed(metadata="[]"), "metadata: the top level is a list; it must be a JSON object"),
    "metadata with NaN": (changed(metadata='{"a": [NaN]}'), "metadata: a[0] is nan; it must be finite"),
    "unknown extent": (changed(metadata='{"extent": "world"}'), "extent is 'world', allowed: footprint, map"),
    "picture of one row": (
        changed(ortho_image_mm=np.zeros(3)),
        "ortho_image_mm is float64 of shape (3,); it must be n x n floating-point numbers",
    ),
}


@pytest.mark.parametrize(("change", "reported"), BAD.values(), ids=BAD)
def test_bad_content_is_refused_by_name(saved: Path, tmp_path: Path, change, reported: str):
    """Each message begins with the file, and names the array, its fault, and what it must be."""
    with np.load(saved) as content:
        arrays = dict(content)
    change(arrays)
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)
    with pytest.raises(gp.FileFormatError) as caught:
        gp.load_terrain(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and reported in message and "\n" not in message


def test_unsafe_content_is_refused(saved: Path, tmp_path: Path):
    """A file in which a safe cell was given a flag is rejected with the violated rule."""
    with np.load(saved) as content:
        arrays = dict(content)
    iy, ix = np.argwhere(arrays["hazard"] == 0)[0]
    arrays["hazard"][iy, ix] = gp.Hazard.STEEP
    np.savez(tmp_path / "unsafe.npz", **arrays)
    with pytest.raises(gp.FileFormatError, match=f"a cell is traversable with a hazard.*iy={iy}, ix={ix}"):
        gp.load_terrain(tmp_path / "unsafe.npz")


@pytest.mark.slow
def test_damaged_file_is_refused(tmp_path: Path):
    """Truncated anywhere, or with any bit of its directory or data flipped: rejected, or the same grid."""
    path = tmp_path / "grid.npz"
    reference = gp.assess_terrain(np.zeros((8, 6), np.float32), 0.01)
    reference.save(path)
    whole = path.read_bytes()
    refused = 0
    for index in range(0, len(whole), 7):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << (index % 8)
        for content in (bytes(flipped), whole[:index]):
            path.write_bytes(content)
            try:
                loaded = gp.load_terrain(path)
            except gp.FileFormatError:
                refused += 1
            else:
                assert all(loaded.layer(n).tobytes() == layer.tobytes() for n, layer in reference.layers.items())
    assert refused > len(whole) / 7


def test_other_files_are_refused(tmp_path: Path):
    """A missing file, a text, an empty file, a bare array, pickled objects."""
    with pytest.raises(gp.MissingFile, match="none.npz: no such file"):
        gp.load_terrain(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("x")
    (tmp_path / "empty.npz").write_bytes(b"")
    with (tmp_path / "array.npz").open("wb") as stream:
        np.save(stream, np.zeros(3))
    np.savez(tmp_path / "objects.npz", elevation=np.array([{}], dtype=object))
    for name in ("text", "empty", "array", "objects"):
        with pytest.raises(gp.FileFormatError, match=f"{name}.npz: not a terrain file"):
            gp.load_terrain(tmp_path / f"{name}.npz")
