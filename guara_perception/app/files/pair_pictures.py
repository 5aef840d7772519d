"""Order of a scan's images, and pairing of images with and without laser, by numbers and words in the file names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

from guara_perception.exceptions import InvalidInput, MissingFile

# Words in a file name that mark a laser-off image.
OFF_WORDS = {"off", "dark", "background", "bg", "ambient", "without"}
SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"}
# Largest number of names listed in a message.
MOST_NAMES = 6


@dataclass(frozen=True, slots=True)
class PicturePair:
    """Images of one stripe.

    Attributes:
        number: number in the file name by which the images are sorted.
        on: laser-on image.
        off: laser-off image, which several stripes may share, or None.
    """

    number: int
    on: Path
    off: Path | None


def picture_files(given: Sequence[Path]) -> list[Path]:
    """List the given image files. A folder is replaced by the image files in it.

    Raises:
        MissingFile: a file does not exist, or a folder contains no image.
        InvalidInput: a file is given twice.
    """
    found: list[Path] = []
    for path in given:
        inside = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
        if not inside or not all(picture.is_file() for picture in inside):
            raise MissingFile(f"{path}: {'contains no picture' if path.is_dir() else 'no such picture'}")
        found += inside
    twice = [path for path, count in Counter(found).items() if count > 1]
    if twice:
        raise InvalidInput(f"pictures given twice: {names_of(twice)}")
    return found


def pair_pictures(pictures: Sequence[Path], off: str = "", number: int | None = None) -> tuple[PicturePair, ...]:
    """Sort the images of a scan, and pair each laser-on image with its laser-off image.

    A single laser-off image is shared by all stripes.

    Args:
        pictures: all images, in any order.
        off: shell pattern of the names of laser-off images; empty = names with a word such as off or dark.
        number: which of the numbers in a name gives the order (1 = first, -1 = last); None = any, if the order is
            unambiguous.

    Raises:
        InvalidInput: `off` matches no image, there is no laser-on image, the names have no or different counts of
            numbers, `number` is out of range, the order is ambiguous, or images have no partner.
    """
    dark = [path for path in pictures if (fnmatch(path.name, off) if off else _is_off(path))]
    if off and not dark:
        raise InvalidInput(f"--off is {off!r}, which matches no picture; allowed: a pattern of names, such as 'dark_*'")
    lit = [path for path in pictures if path not in dark]
    if not lit:
        raise InvalidInput(f"the names mark all {len(pictures)} pictures as laser-off: give --off PATTERN")
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
    """Numbers in a file name, from left to right."""
    return [int(digits) for digits in re.findall(r"\d+", path.stem)]


def names_of(paths: Collection[Path]) -> str:
    """List file names for a message, at most MOST_NAMES of them."""
    names = sorted(path.name for path in paths)
    return ", ".join(names[:MOST_NAMES]) + (f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else "")


def _is_off(path: Path) -> bool:
    return not OFF_WORDS.isdisjoint(re.split(r"[^a-z]+", path.stem.lower()))


def _has(order: dict[int, Path], path: Path, place: int) -> bool:
    numbers = numbers_of(path)
    return len(numbers) > place and numbers[place] in order


def _orders(pictures: Sequence[Path], number: int | None) -> dict[int, dict[int, Path]]:
    """Sort images by number, for each position in the names (or the given one) at which all numbers differ.

    Returns:
        Images by number, for each position. All positions give the same order.

    Raises:
        InvalidInput: the names have no or different counts of numbers, `number` is out of range, or the order is
            ambiguous.
    """
    counts = Counter(len(numbers_of(path)) for path in pictures)
    usual = counts.most_common(1)[0][0]
    odd = [path for path in pictures if len(numbers_of(path)) != usual]
    if odd or not usual:
        raise InvalidInput(
            f"the order of the pictures is not clear: "
            f"{f'names without {usual} numbers, unlike the others' if usual else 'names without a number'}: "
            f"{names_of(odd or pictures)}"
        )
    places = list(range(usual))
    if number is not None:
        if not 1 <= abs(number) <= usual:
            raise InvalidInput(f"--number is {number}; allowed: 1 ... {usual} or -1 ... -{usual}, as in the names")
        places = [number - 1 if number > 0 else usual + number]
    by_place = {place: {numbers_of(path)[place]: path for path in pictures} for place in places}
    orders = {place: order for place, order in by_place.items() if len(order) == len(pictures)}
    if not orders:
        order = by_place[places[-1]]
        raise InvalidInput(
            f"the order of the pictures is not clear: these repeat the number of another: "
            f"{names_of([p for p in pictures if p not in order.values()])}"
        )
    if len({tuple(path for _, path in sorted(order.items())) for order in orders.values()}) > 1:
        listed = ", ".join(str(place + 1) for place in orders)
        raise InvalidInput(
            f"the order of the pictures is not clear: numbers {listed} of names such as {pictures[0].name} give "
            "different orders: give --number, 1 for the first"
        )
    return orders
