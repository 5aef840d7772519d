"""The compact form of a Terrain message, for slow links: rounded to the safe side, then made small.

It is the same message with the same layers of float32, in which numbers take fewer different values. What is done to
each layer makes the terrain no better than it is: lowest samples go down, highest up, variances up, clearance and score
down; flags stay as they are. `rounding` in the metadata says by how much an elevation may be off, and a variance too
large.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from transport.arrays import Array, Float
from transport.messages.shuffle import compress
from transport.messages.terrain_codec import encode_terrain
from transport.messages.terrain_message import TerrainMessage

# Values are rounded to multiples of these, powers of two so that each is a float32: heights, which scatter by 0.1 mm
# and more, differences of heights and clearance [m]; slope [rad].
HEIGHT_UNIT, RELIEF_UNIT, CLEARANCE_UNIT, SLOPE_UNIT = 2.0**-13, 2.0**-12, 2.0**-10, 2.0**-9
# Bits after the leading one: a variance may become an eighth larger, a score a 32nd smaller.
VARIANCE_BITS, SCORE_BITS = 3, 5
# float32 holds whole numbers up to here: larger multiples of a unit stay as they are.
WHOLE_NUMBERS = 2.0**23
MANTISSA_BITS = 23


def encode_compact(terrain: TerrainMessage) -> bytes:
    """The compact payload: `rounded`, as CDR, in one zstd frame of shuffled bytes (see `transport.messages.shuffle`).

    Raises:
        MessageError: as in `encode_terrain`.
    """
    return compress(encode_terrain(rounded(terrain)))


def rounded(terrain: TerrainMessage) -> TerrainMessage:
    """The message with every layer rounded to its safe side; rounded again it stays the same."""
    layers = {name: ROUND[name](array) if name in ROUND else array for name, array in terrain.layers.items()}
    metadata = {**json.loads(terrain.metadata), "rounding": dict(ROUNDING)}
    return dataclasses.replace(terrain, layers=layers, metadata=json.dumps(metadata))


def _in_multiples(unit: float, whole: Callable[[Float], Float]) -> Callable[[Array], Array]:
    def to_multiples(values: Array) -> Array:
        count = values.astype(np.float64) / unit
        return np.where(np.abs(count) < WHOLE_NUMBERS, whole(count) * unit, values).astype(np.float32)

    return to_multiples


def _in_bits(bits: int, *, up: bool) -> Callable[[Array], Array]:
    rest = np.int32((1 << (MANTISSA_BITS - bits)) - 1)

    def to_bits(values: Array) -> Array:
        """For values that are not negative: floats of one sign are in the order of their bits."""
        integers = values.view(np.int32)
        result = ((integers + rest if up else integers) & ~rest).view(np.float32)
        # A value that rounding would make infinite or 0 stays as it is.
        return np.where(np.isfinite(result) & (result > 0.0), result, values)

    return to_bits


ROUND: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "elevation": _in_multiples(HEIGHT_UNIT, np.rint),
        "elevation_min": _in_multiples(HEIGHT_UNIT, np.floor),
        "elevation_max": _in_multiples(HEIGHT_UNIT, np.ceil),
        "variance": _in_bits(VARIANCE_BITS, up=True),
        "slope": _in_multiples(SLOPE_UNIT, np.ceil),
        "step_height": _in_multiples(RELIEF_UNIT, np.ceil),
        "roughness": _in_multiples(RELIEF_UNIT, np.ceil),
        "clearance": _in_multiples(CLEARANCE_UNIT, np.floor),
        "traversability": _in_bits(SCORE_BITS, up=False),
    }
)
# [m] An elevation is off by at most this; the true variance is more than the sent one divided by 1 + this.
ROUNDING: Mapping[str, float] = MappingProxyType({"elevation": HEIGHT_UNIT / 2, "variance": 2.0**-VARIANCE_BITS})
