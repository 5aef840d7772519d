"""Ordering of a scan's pictures, and their pairing (laser on and off), by numbers and words in their names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from guara_perception.exceptions import InvalidInput, MissingFile

# Words that mark a picture without the laser.
OFF_WORDS = {"off", "dark", "background", "bg", "ambient", "without"}
SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
# Largest number of names listed in a message.
MOST_NAMES = 6


@dataclass(frozen=True, slots=True)
class PicturePair:
    """Pictures of one stripe.

    Attributes:
        number: number in the name that gives the order.
        on: picture with the laser.
        off: picture without it, which stripes may share, or None.
    """

    number: int
    on: Path
    off: Path | None


def picture_files(given: Sequence[Path]) -> list[Path]:
    """List the given pictures; a folder is replaced by the pictures in it.

    Raises:
        MissingFile: a picture does not exist, or a folder has none.
        InvalidInput: a picture is given twice.
    """
    found: list[Path] = []
    for path in given:
        inside = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
        if not inside or not all(picture.is_file() for picture in inside):
            raise MissingFile(f"{path}: {'no picture in it' if path.is_dir() else 'no such picture'}")
        found += inside
    twice = [path for path, count in Counter(found).items() if count > 1]
    if twice:
        raise InvalidInput(f"pictures given twice: {names_of(twice)}")
    return found


def pair_pictures(pictures: Sequence[Path], off: str = "", number: int | None = None) -> tuple[PicturePair, ...]:
    """Put the pictures of a scan in order, each with its picture without the laser.

    Args:
        pictures: all pictures, in any order.
        off: pattern of the names without the laser, as in a shell; empty = those with a word such as off or dark.
        number: position of the number in a name that gives the order, 1 the first, -1 the last; None = any, if the
            order is clear.

    Raises:
        InvalidInput: the order is not clear, or a picture has no partner; the message names the pictures.
    """
    dark = [path for path in pictures if (fnmatch(path.name, off) if off else _is_off(path))]
    lit = [path for path in pictures if path not in dark]
    if not lit:
        raise InvalidInput(f"all {len(pictures)} pictures are without the laser by their names: give --off PATTERN")
    orders = _orders(lit, number)
    if len(dark) <= 1:
        shared = dark[0] if dark else None
        return tuple(PicturePair(value, path, shared) for value, path in sorted(orders[max(orders)].items()))
    for place, order in sorted(orders.items(), reverse=True):
        partners = {numbers_of(path)[place]: path for path in dark if len(numbers_of(path)) > place}
        if partners.keys() == order.keys() and len(partners) == len(dark):
            return tuple(PicturePair(value, path, partners[value]) for value, path in sorted(order.items()))
    alone = [path for value, path in order.items() if value not in partners]
    extra = [path for path in dark if path not in partners.values() or not _has(order, path, place)]
    raise InvalidInput(f"pictures without a partner: {names_of([*alone, *extra])}")


def numbers_of(path: Path) -> list[int]:
    """Numbers in a name, from left to right."""
    return [int(digits) for digits in re.findall(r"\d+", path.stem)]


def names_of(paths: Collection[Path]) -> str:
    """Names for a message."""
    names = sorted(path.name for path in paths)
    return ", ".join(names[:MOST_NAMES]) + (f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else "")


def _is_off(path: Path) -> bool:
    return not OFF_WORDS.isdisjoint(re.split(r"[^a-z]+", path.stem.lower()))


def _has(order: dict[int, Path], path: Path, place: int) -> bool:
    numbers = numbers_of(path)
    return len(numbers) > place and numbers[place] in order


def _orders(pictures: Sequence[Path], number: int | None) -> dict[int, dict[int, Path]]:
    """Pictures by number, for each place in the name where all numbers differ; all places give the same order."""
    counts = Counter(len(numbers_of(path)) for path in pictures)
    usual = counts.most_common(1)[0][0]
    odd = [path for path in pictures if len(numbers_of(path)) != usual]
    if odd or not usual:
        raise InvalidInput(
            f"the order of the pictures is not clear: {names_of(odd or pictures)} "
            f"{f'do not have {usual} numbers in the name like the others' if usual else 'have no number in the name'}"
        )
    places = list(range(usual))
    if number is not None:
        if not 1 <= abs(number) <= usual:
            raise InvalidInput(f"--number is {number}, allowed: 1 ... {usual} or -1 ... -{usual}: names have {usual}")
        places = [number - 1 if number > 0 else usual + number]
    by_place = {place: {numbers_of(path)[place]: path for path in pictures} for place in places}
    orders = {place: order for place, order in by_place.items() if len(order) == len(pictures)}
    if not orders:
        order = by_place[places[-1]]
        raise InvalidInput(
            f"the order of the pictures is not clear: {names_of([p for p in pictures if p not in order.values()])} "
            "have the number of another picture"
        )
    if len({tuple(path for _, path in sorted(order.items())) for order in orders.values()}) > 1:
        listed = ", ".join(str(place + 1) for place in orders)
        raise InvalidInput(
            f"the order of the pictures is not clear: numbers {listed} of names such as {pictures[0].name} give "
            "different orders: give --number, 1 for the first"
        )
    return orders
