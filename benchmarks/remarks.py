"""Why targets are not met, for the documents; only reasons for missed targets are printed."""

from __future__ import annotations

from benchmarks.section import Section

REASONS = {
    "extraction / reference extraction, synthetic clean stripes": (
        "the reference only takes the highest peak; `precise` also smooths over three columns, looks for "
        "rivals, judges the frame, gives a sigma and smooths the line: about 100 calls of numpy on arrays of"
        " one row, each of which costs more to call than to carry out. A compiled kernel that fuses the passes "
        "reached 0.4 of the reference in a prototype (numba: 200 MB more to install, 0.4 s more to start)"
    ),
    "extraction / reference extraction, frames of the scan": (
        "as above; where the stripe clips, all three channels are read and mixed"
    ),
    "CPU of a whole scan / reference extraction of its frames": (
        "extraction is half of it (see above); the rest is triangulation with its guards (ends of runs, own "
        "body) and the raster of the surface between stripes, all of them numpy on one stripe at a time"
    ),
    "last frame to grid / reference extraction of one frame": (
        "one stripe with all its guards, the causes of unknown cells (what hides each cell from camera "
        "and laser) and the layers are most of it"
    ),
    "memory growth in a scan, MB": (
        "8 MB of it are the pair of frames itself and 4 MB what a scan keeps (profiles and points of every stripe, for "
        "range images and for stripes that come late); the rest comes and goes, with a band as with the layers at "
        "the end"
    ),
}


def remarks(targets: Section) -> str:
    """A list in Markdown with the reason for each missed target; empty when none is missed."""
    missed = [name for name, figure in targets.figures.items() if not figure["met"]]
    lines = [f"- *{name}*: {REASONS.get(name, 'see the profile below')}." for name in missed]
    return "\n".join(["### Why the others are not met", "", *lines, ""]) if lines else ""
