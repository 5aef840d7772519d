"""The methods by which a scan can be processed: how stripes are found and how points are made of them."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.exceptions import InvalidInput
from guara_perception.ranging.paper.rangefinder import Literal
from guara_perception.stripes.extract import Extract
from guara_perception.stripes.paper import extract_paper
from guara_perception.stripes.precise import extract_precise


@dataclass(frozen=True, slots=True)
class Method:
    """One method.

    Attributes:
        extract: finds the stripes of some bands.
        literal: what the paper's chain takes as printed; None = triangulation instead of the paper's chain.
    """

    extract: Extract
    literal: Literal | None


METHODS = {
    # Matched filter, triangulation with the calibrated laser planes.
    "precise": Method(extract_precise, None),
    # The paper's chain, eqs. 7 to 21, corrected; with eq. 8 in one iteration; with eqs. 20, 21 about the image centre.
    "paper": Method(extract_paper, Literal()),
    "paper-literal-lens": Method(extract_paper, Literal(lens=True)),
    "paper-literal-ortho": Method(extract_paper, Literal(ortho=True)),
}


def check_method(name: str) -> str:
    """The name itself when there is such a method.

    Raises:
        InvalidInput: no method of that name; the message lists them.
    """
    if name not in METHODS:
        raise InvalidInput(f"method is {name!r}, allowed: {', '.join(METHODS)}")
    return name
