"""Simulated terrain with exact height and material at any point, read from a TOML file."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Codes, Float
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.simulation.features import KINDS, AnyFeature, Step, check_seed, material_index
from guara_perception.simulation.light import Light, real_light
from kinematics.untrusted import LARGEST_FILE, key_lines, parse_toml, table_name

# Number of waves that make up the undulation, and range of their lengths.
UNDULATION_WAVES = 6
SHORTEST_WAVE_M = 0.25
LONGEST_WAVE_M = 1.0
# Folder of the worlds that come with the package.
WORLDS = Path(__file__).resolve().parent / "worlds"


@dataclass(frozen=True, slots=True)
class World:
    """Ground with features on it; z = 0 is the bare ground without undulation.

    Outside the area, each point has the height and material of the nearest point of the border.

    Attributes:
        x: smallest and largest x of the area [m].
        y: smallest and largest y of the area [m].
        features: features in the order of placement; each stands on the ground as shaped by the features before it.
        material: material of the bare ground.
        undulation: standard deviation of the bare ground about z = 0 [m].
        seed: seed of undulation and texture.
        flat_until: x up to which there is no undulation [m]; the undulation grows smoothly over the next 0.2 m.
        light: parameters of light and sensor.
    """

    x: tuple[float, float] = (-1.0, 3.0)
    y: tuple[float, float] = (-1.0, 1.0)
    features: tuple[AnyFeature, ...] = ()
    material: str = "soil"
    undulation: float = 0.0
    seed: int = 0
    flat_until: float = -np.inf
    light: Light = field(default_factory=Light)
    _bases: tuple[float, ...] = field(default=(), init=False, repr=False)
    _waves: Float = field(default_factory=lambda: np.zeros((0, 3)), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the fields and compute the height on which each feature stands.

        Raises:
            InvalidInput: the area is empty or not finite, a feature is outside it, the undulation is not 0 ... 0.1 m,
                the seed is negative, or the material is unknown.
        """
        for name, (low, high) in (("x", self.x), ("y", self.y)):
            if not (np.isfinite([low, high]).all() and low < high):
                raise InvalidInput(f"{name} is ({low}, {high}), allowed: (low, high), both finite and low below high")
        if not (np.isfinite(self.undulation) and 0 <= self.undulation <= 0.1):
            raise InvalidInput(f"undulation is {self.undulation}, allowed: 0 ... 0.1 m")
        check_seed(self.seed)
        material_index(self.material)
        for feature in self.features:
            self.check_inside(feature)
        object.__setattr__(self, "features", tuple(self.features))
        object.__setattr__(self, "_waves", _waves(self.seed))
        for i, feature in enumerate(self.features):
            y = 0.0 if isinstance(feature, Step) else feature.y
            base = float(self._evaluate(feature.x, y, self.features[:i])[0])
            object.__setattr__(self, "_bases", (*self._bases, base))

    def check_inside(self, feature: AnyFeature) -> None:
        """Reject a feature that extends beyond the area.

        Raises:
            InvalidInput: the feature is outside; the message gives its bounds and the allowed ones.
        """
        x0, x1, y0, y1 = feature.bounds
        if x0 < self.x[0] or x1 > self.x[1] or y0 < self.y[0] or y1 > self.y[1]:
            raise InvalidInput(
                f"{type(feature).__name__.lower()} covers x {x0:.3f} ... {x1:.3f}, y {y0:.3f} ... {y1:.3f}: outside "
                f"the world, x {self.x[0]} ... {self.x[1]}, y {self.y[0]} ... {self.y[1]}"
            )

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float:
        """Exact height of the top surface at points of any (broadcast) shape [m]."""
        return self._evaluate(x, y, self.features)[0]

    def material_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Codes:
        """Material of the top surface at points, as an index into MATERIALS."""
        return self._evaluate(x, y, self.features)[1]

    def raster(self, x: tuple[float, float], y: tuple[float, float], cell: float) -> tuple[Float, Codes]:
        """Heights and materials at the cell centres of a grid a[iy, ix] with cells of size `cell` [m] over an area.

        Faster than `height` and `material_at` for many features, because each feature is evaluated only where it lies.
        """
        cx = np.arange(x[0] + cell / 2, x[1], cell)
        cy = np.arange(y[0] + cell / 2, y[1], cell)
        heights = self._undulated(cx, cy)
        materials = np.full(heights.shape, material_index(self.material), dtype=np.uint8)
        for feature, base in zip(self.features, self._bases, strict=True):
            x0, x1, y0, y1 = feature.bounds
            if isinstance(feature, Step):
                x1, y0, y1 = np.inf, -np.inf, np.inf
            columns, rows = slice(*np.searchsorted(cx, (x0, x1))), slice(*np.searchsorted(cy, (y0, y1)))
            part = heights[rows, columns]
            if not part.size:
                continue
            near_x, near_y = np.meshgrid(cx[columns], cy[rows])
            top, mask = feature.shape(near_x, near_y, part, base)
            heights[rows, columns] = top
            materials[rows, columns][mask] = material_index(feature.material)
        return heights, materials

    def sole_height(self, x: float, y: float, length: float, width: float) -> float:
        """Height of a level, rigid sole of length x width centred at a point [m]."""
        u, v = np.meshgrid(np.linspace(-0.5, 0.5, 17) * length, np.linspace(-0.5, 0.5, 13) * width)
        return float(self.height(x + u, y + v).max())

    def _undulated(self, cx: Float, cy: Float) -> Float:
        """Heights (ny, nx) of the bare ground [m]; the angle-sum identity reduces millions of sines to thousands."""
        if self.undulation <= 0:
            return np.zeros((cy.size, cx.size))
        cx, cy = np.clip(cx, *self.x), np.clip(cy, *self.y)
        kx, ky, phase = self._waves.T
        row, column = cx[:, None] * kx + phase, cy[:, None] * ky
        waves = np.cos(column) @ np.sin(row).T + np.sin(column) @ np.cos(row).T
        return np.asarray(waves * self._amplitude(cx))

    def _amplitude(self, x: Float) -> Float:
        """Amplitude of each wave [m]; 0 where the ground is flat."""
        rise = np.clip((x - self.flat_until) / 0.2, 0, 1)
        return np.asarray(self.undulation * np.sqrt(2 / len(self._waves)) * rise**2 * (3 - 2 * rise))

    def _evaluate(self, x: npt.ArrayLike, y: npt.ArrayLike, features: tuple[AnyFeature, ...]) -> tuple[Float, Codes]:
        """Height and material of the ground with some features at points."""
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        px, py = np.clip(px, *self.x), np.clip(py, *self.y)
        heights = np.zeros(px.shape)
        if self.undulation > 0:
            for kx, ky, phase in self._waves:
                heights += np.sin(kx * px + ky * py + phase)
            heights *= self._amplitude(px)
        materials = np.full(px.shape, material_index(self.material), dtype=np.uint8)
        for feature, base in zip(features, self._bases, strict=False):
            heights, mask = feature.shape(px, py, heights, base)
            materials[mask] = material_index(feature.material)
        return heights, materials


def _waves(seed: int) -> Float:
    """Wave numbers and phases (n, 3) of the undulation."""
    rng = np.random.default_rng(seed)
    lengths = np.exp(rng.uniform(np.log(SHORTEST_WAVE_M), np.log(LONGEST_WAVE_M), UNDULATION_WAVES))
    angles, phases = rng.uniform(0, 2 * np.pi, (2, UNDULATION_WAVES))
    return np.column_stack((2 * np.pi / lengths * np.cos(angles), 2 * np.pi / lengths * np.sin(angles), phases))


LIGHT = "light"
# Types of a number, compared by `type` because `isinstance` would accept true and false.
NUMBERS = (int, float)
TYPES = {"float": "a number", "int": "an integer", "str": "a string", "tuple[float, float]": "two numbers"}


def load_world(name_or_path: str | Path) -> World:
    """Read a world file.

    The keys at the top level are `x`, `y` (area, two numbers each), `material`, `undulation`, `flat_until` and `seed`.
    Each feature has a table `[[box]]`, `[[rock]]`, `[[ramp]]`, `[[pit]]`, `[[patch]]`, `[[step]]` or `[[stairs]]`; the
    tables are in the order of placement. Units are metres and radians. The table `[light]` contains the strengths of
    effects of real light, where 1 is the strength in the worst photograph (`real_light`).

    Args:
        name_or_path: a .toml file, or the name of a world that comes with the package.

    Raises:
        MissingFile: there is neither a file nor a world of this name; the message lists the worlds.
        FileFormatError: the file is invalid; the message names the file and the fault, in most cases with the line, the
            value and what is allowed.
    """
    path = Path(name_or_path)
    named = WORLDS / f"{name_or_path}.toml"
    if path.suffix != ".toml" and named.is_file():
        path = named
    if not path.is_file():
        names = ", ".join(sorted(p.stem for p in WORLDS.glob("*.toml")))
        raise MissingFile(f"{name_or_path}: no such world file; worlds that come with the package: {names}")
    if path.stat().st_size > LARGEST_FILE:
        raise FileFormatError(f"{path}: has {path.stat().st_size} bytes, allowed: {LARGEST_FILE} or fewer")
    try:
        return parse_world(path.read_text(encoding="utf-8"), str(path))
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not a TOML file ({error})") from None


def parse_world(text: str, source: str) -> World:
    """Parse the text of a world file; `source` is its name for messages.

    Raises:
        FileFormatError: as in `load_world`.
    """
    try:
        data: dict[str, Any] = parse_toml(text)
    except ValueError as error:
        raise FileFormatError(f"{source}: not a TOML file ({error})") from None
    file = _WorldFile(source, key_lines(text))
    options = file.options(World, "", {key: data[key] for key in data if key not in KINDS and key != LIGHT})
    strengths = data.get(LIGHT, {})
    if not isinstance(strengths, dict):
        raise FileFormatError(
            f"{file.line('', LIGHT)}: {LIGHT} is {strengths!r}, allowed: a table [{LIGHT}] of effects and strengths"
        )
    for name, strength in strengths.items():
        _value(strength, "float", f"{file.line(LIGHT, name)}: {name}")
        with file.named(LIGHT, "[light]: ", name):
            real_light({name: strength})
    features: list[tuple[int, str, AnyFeature]] = []
    for kind, cls in KINDS.items():
        entries = data.get(kind, [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise FileFormatError(f"{file.line('', kind)}: write [[{kind}]] for each {kind}")
        for number, entry in enumerate(entries, 1):
            table = table_name(kind, number)
            given = file.options(cls, table, entry)
            with file.named(table, f"[[{kind}]]: "):
                features.append((file.lines.get(table, 1), table, cls(**given)))
    features.sort(key=lambda item: item[0])
    with file.named(""):
        bare = World(**options)
    for _, table, feature in features:
        with file.named(table):
            bare.check_inside(feature)
    return World(**options, light=real_light(strengths), features=tuple(feature for _, _, feature in features))


@dataclass(frozen=True, slots=True)
class _WorldFile:
    """Name of a world file and the lines of its tables and keys (from `key_lines`), for messages."""

    name: str
    lines: Mapping[str, int]

    def line(self, table: str, key: str) -> str:
        """File and line of a key, or of its table if the key is missing."""
        return f"{self.name}, line {self.lines.get(f'{table}.{key}' if table else key, self.lines.get(table, 1))}"

    @contextmanager
    def named(self, table: str, title: str = "", key: str = "") -> Iterator[None]:
        """Convert InvalidInput to FileFormatError with the line of `key`, or of the key that begins the message."""
        try:
            yield
        except InvalidInput as error:
            where = self.line(table, key or str(error).split(" ", 1)[0])
            raise FileFormatError(f"{where}: {title}{error}") from None

    def options(self, cls: type[Any], table: str, entry: Mapping[str, Any]) -> dict[str, Any]:
        """Convert a table to keyword arguments of a dataclass, and check names and types.

        Raises:
            FileFormatError: a key is unknown or missing, or a value has the wrong type.
        """
        fields = {f.name: f for f in dataclasses.fields(cls) if f.init and f.name not in ("features", LIGHT)}
        what = f"a {cls.__name__.lower()}"
        result: dict[str, Any] = {}
        for key, value in entry.items():
            where = self.line(table, key)
            if key not in fields:
                extra = f"; tables: {', '.join(KINDS)}, {LIGHT}" if cls is World else ""
                raise FileFormatError(f"{where}: unknown key {key!r}; {what} has: {', '.join(fields)}{extra}")
            result[key] = _value(value, str(fields[key].type), f"{where}: {key}")
        for name, f in fields.items():
            if name not in result and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING:
                raise FileFormatError(f"{self.line(table, '')}: {name!r} is missing; {what} needs it")
        return result


def _value(value: Any, kind: str, where: str) -> Any:
    if kind == "float" and type(value) in NUMBERS:
        return float(value)
    if (kind, type(value)) in (("int", int), ("str", str)):
        return value
    if (
        kind.startswith("tuple")
        and isinstance(value, list)
        and [type(item) in NUMBERS for item in value] == [True, True]
    ):
        return float(value[0]), float(value[1])
    raise FileFormatError(f"{where} is {value!r}, allowed: {TYPES[kind]}")
