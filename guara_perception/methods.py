"""The methods by which a scan can be processed: how stripes are found and how points are made of them."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.exceptions import InvalidInput
from guara_perception.ranging.paper.rangefinder import Literal
from guara_perception.stripes.extract import METHODS as EXTRACT
from guara_perception.stripes.extract import Extract


@dataclass(frozen=True, slots=True)
class Method:
    """One method.

    Attributes:
        extract: finds the stripe of each of some bands.
        literal: what the paper's chain takes as printed; None = triangulation instead of the paper's chain.
        meaning: in words.
    """

    extract: Extract
    literal: Literal | None
    meaning: str


PRECISE, PAPER = EXTRACT["precise"], EXTRACT["paper"]
METHODS = {
    "precise": Method(PRECISE, None, "matched filter, triangulation with the calibrated sheets"),
    "paper": Method(PAPER, Literal(), "the paper's chain, eqs. 7 to 21, corrected"),
    "paper-literal-lens": Method(PAPER, Literal(lens=True), "the same, eq. 8 in one step"),
    "paper-literal-ortho": Method(
        EXTRACT["paper"], Literal(ortho=True), "the same, eqs. 20, 21 about the image centre"
    ),
}


def check_method(name: str) -> str:
    """The name itself when there is such a method.

    Raises:
        InvalidInput: there is none; the message lists those there are.
    """
    if name not in METHODS:
        raise InvalidInput(f"method is {name!r}, allowed: {', '.join(METHODS)}")
    return name
