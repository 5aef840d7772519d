"""`open_grid`: one grid, whether it is a file of its own or part of a recording."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.files.recording import open_recording
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.file import load_terrain
from guara_perception.terrain.grid import TerrainGrid


def open_grid(path: str | Path, step: int | None = None, extent: str | None = None) -> TerrainGrid:
    """A grid from an .npz file, or from an .mcap recording.

    Args:
        path: path of the file.
        step: pause of a recording; None = its last.
        extent: extent of the grid in a recording, "footprint" or "map"; None = footprint.

    Raises:
        MissingFile, FileFormatError: the file is not there or cannot be read.
        InvalidInput: a step or extent that the file does not hold.
    """
    path = Path(path)
    if path.suffix != ".mcap":
        terrain = load_terrain(path)
        if step not in (None, terrain.step) or extent not in (None, terrain.extent):
            raise InvalidInput(f"{path} holds the {terrain.extent} grid of step {terrain.step} and no other")
        return terrain
    found: dict[int, TerrainGrid] = {}
    with open_recording(path) as recording:
        for terrain in recording.grids(extent or "footprint"):
            if step is None:
                found.clear()
            found[terrain.step] = terrain
    if not found:
        raise InvalidInput(f"{path} holds no {extent or 'footprint'} grid; `guara replay` makes them from its scans")
    if step is not None and step not in found:
        raise InvalidInput(f"{path} holds no grid of step {step}; its steps: {', '.join(map(str, sorted(found)))}")
    return found[step] if step is not None else next(iter(found.values()))
