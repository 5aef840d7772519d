"""One table of layers in Python, in messages and in the documents."""

from pathlib import Path

import numpy as np

import transport
from guara_perception.settings import MODES
from guara_perception.terrain.layers.layered_grid import EXTENTS
from guara_perception.terrain.layers.layers import LAYERS
from transport.messages import terrain_message

DOCS = Path(__file__).parents[4] / "docs"


def test_the_wire_carries_the_same_layers() -> None:
    """Messages have the same names, order, types, units, extents and modes."""
    layers = [(layer.name, np.dtype(layer.dtype), layer.unit) for layer in LAYERS]
    assert layers == [(name, kind.dtype, kind.unit) for name, kind in transport.LAYERS.items()]
    assert (EXTENTS, MODES) == (terrain_message.EXTENTS, terrain_message.MODES)


def test_the_documents_list_the_same_layers() -> None:
    """The table in the documents has every layer, in the same order, with its type, unit and meaning."""
    rows = [f"| `{layer.name}` | {np.dtype(layer.dtype)} | {layer.unit} | {layer.meaning} |" for layer in LAYERS]
    assert "\n".join(rows) in (DOCS / "files.md").read_text()
