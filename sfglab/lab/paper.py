"""Numbers that the papers state, read from ``data/claims.yaml``, the only file that has them."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from sfglab.lab.claims import Claim, load_claims
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from pathlib import Path


def paper(claim: str, number: str = "") -> float:
    """Return a number that a paper states.

    Args:
        claim: Id of the claim.
        number: Key in the claim's `numbers`. Empty: the claim's own value, `paper`.

    Raises:
        KeyError: There is no such claim or number.
        DocumentError: The file cannot be read.
    """
    stated = _claims(find_project().claims)[claim]
    numbers = {**stated.numbers}
    if stated.paper is not None:
        numbers[""] = stated.paper
    return numbers[number]


@cache
def _claims(path: Path) -> dict[str, Claim]:
    return {claim.id: claim for claim in load_claims(path)}
