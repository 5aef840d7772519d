"""Access to the scans, grids and stance pauses of a recording, and to one grid of a recording or grid file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from guara_perception.app.files.scan_recording import open_recorded_scans
from guara_perception.app.messages import message_to_terrain
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import parse_calibration
from guara_perception.exceptions import FileFormatError, InvalidInput, errors_as
from guara_perception.files import existing_file
from guara_perception.scan import Scan
from guara_perception.terrain.file import load_terrain
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.layered_grid import EXTENTS
from transport import StancePause, TransportError
from transport.recording import open_recording as open_messages


class Recording(AbstractContextManager["Recording"]):
    """Recording (.mcap) of a node; use it in a `with` block.

    Opening it checks the calibration, scans and footprint grids; frames and grids are loaded on demand. Iterating over
    a recording yields its footprint grids.

    Attributes:
        path: path of the file.
        scans: recorded scans that have a laser-on frame, in order; `process_scan` can process them again, except those
            that were withdrawn.
        calibration: attached calibration, or None.

    Example:
        with gp.open_recording("walk.mcap") as recording:
            for terrain in recording.grids("map"):
                print(terrain.step, terrain.best_foothold(0.4, 0.18, radius=0.05))
    """

    def __init__(self, path: str | Path) -> None:
        """Open the file; see `open_recording`."""
        self.path = existing_file(path)
        with errors_as(FileFormatError, "", TransportError):
            self._messages = open_messages(self.path)
        text = self._messages.calibration
        source = f"{self.path}: calibration.json"
        self.calibration: Calibration | None = None if text is None else parse_calibration(text, source)
        self.scans: tuple[Scan, ...] = tuple(open_recorded_scans(self.path))

    def __exit__(self, *error: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[TerrainGrid]:
        """Yield the footprint grids."""
        return self.grids()

    def grids(self, extent: str = "footprint") -> Iterator[TerrainGrid]:
        """Yield the recorded grids of one extent, in order.

        Raises:
            InvalidInput: unknown extent.
            FileFormatError: a grid is damaged.
            UnsafeGrid: a grid violates the safety invariant.
        """
        if extent not in EXTENTS:
            raise InvalidInput(f"extent is {extent!r}; allowed: {', '.join(EXTENTS)}")
        with errors_as(FileFormatError, self.path, TransportError):
            for message in self._messages.terrains(extent):
                yield message_to_terrain(message)

    def stances(self) -> Iterator[StancePause]:
        """Yield the recorded announcements of stance pauses, in order.

        Raises:
            FileFormatError: an announcement is damaged.
        """
        with errors_as(FileFormatError, self.path, TransportError):
            yield from self._messages.stance_pauses()

    def close(self) -> None:
        """Close the file. May be called twice."""
        self._messages.close()


def open_recording(path: str | Path) -> Recording:
    """Open a recording (.mcap).

    Raises:
        MissingFile: the file does not exist.
        FileFormatError: the file is not a recording, its calibration, a scan or a grid is invalid, or it is truncated
            (`guara convert` then makes it readable).
    """
    return Recording(path)


def open_grid(path: str | Path, step: int | None = None, extent: str | None = None) -> TerrainGrid:
    """Read one grid from an .npz file or an .mcap recording.

    Args:
        path: path of the file.
        step: step of the pause; None = the grid of the .npz file, or the last grid of the recording.
        extent: "footprint" or "map"; None = the grid of the .npz file, or a footprint grid of the recording.

    Raises:
        MissingFile, FileFormatError: the file does not exist, or is not a valid .npz file or recording.
        InvalidInput: the file contains no grid of this step and extent, or the extent is unknown.
        UnsafeGrid: a grid of the recording violates the safety invariant.
    """
    path = Path(path)
    if path.suffix != ".mcap":
        terrain = load_terrain(path)
        if step not in (None, terrain.step) or extent not in (None, terrain.extent):
            raise InvalidInput(f"{path} contains only the {terrain.extent} grid of step {terrain.step}")
        return terrain
    found: dict[int, TerrainGrid] = {}
    with open_recording(path) as recording:
        for terrain in recording.grids(extent or "footprint"):
            if step is None:
                found.clear()
            found[terrain.step] = terrain
    if not found:
        raise InvalidInput(f"{path} contains no {extent or 'footprint'} grid; `guara replay` makes grids from scans")
    if step is not None and step not in found:
        raise InvalidInput(f"{path} has no grid of step {step}; allowed: {', '.join(map(str, sorted(found)))}")
    return found[step] if step is not None else next(iter(found.values()))
