"""What surfaces of the simulated world are made of."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.exceptions import InvalidInput


@dataclass(frozen=True, slots=True)
class Material:
    """One material.

    Attributes:
        name: name in world files.
        albedo: share of light scattered back, red, green, blue, 0 ... 1.
        shine: share of the rest that is mirrored, 0 ... 1.
        texture: standard deviation of the albedo over the surface, as a share of it.
    """

    name: str
    albedo: tuple[float, float, float]
    shine: float = 0.0
    texture: float = 0.08


MATERIALS = (
    Material("soil", (0.28, 0.19, 0.13), texture=0.10),
    Material("wood", (0.38, 0.27, 0.17), texture=0.15),
    Material("concrete", (0.42, 0.42, 0.40), texture=0.08),
    Material("brick", (0.40, 0.13, 0.09), texture=0.12),
    Material("blue", (0.07, 0.12, 0.30), texture=0.10),
    Material("gravel", (0.33, 0.31, 0.28), texture=0.35),
    # Coal, rubber, black cloth: under 3 % in red, the stripe drowns in the noise.
    Material("dark", (0.006, 0.006, 0.006), texture=0.10),
    Material("metal", (0.10, 0.10, 0.11), shine=0.7, texture=0.05),
    Material("wet", (0.14, 0.10, 0.07), shine=0.35, texture=0.10),
)
INDEX = {material.name: index for index, material in enumerate(MATERIALS)}


def material_index(name: str) -> int:
    """Index of a material in MATERIALS.

    Raises:
        InvalidInput: no such material; the message lists them.
    """
    if name not in INDEX:
        raise InvalidInput(f"material is {name!r}, allowed: {', '.join(INDEX)}")
    return INDEX[name]
