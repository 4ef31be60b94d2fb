"""The experiments of the paper, run again: ``mavdem reproduce``, and the claims that they test, in ``claims.toml``.

Needs the extra ``view``: ``pip install 'mavdem[view]'``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mavdem.files import load_adjacent_toml


@dataclass(frozen=True, eq=False)
class Claim:
    """One claim that is tested again; ``labels`` are the paper's figures, tables and algorithms about it.

    ``remarks`` are sentences on how it is tested.
    """

    name: str
    title: str
    section: str
    labels: list[str]
    quote: str
    remarks: Sequence[str] = ()


_TABLES = load_adjacent_toml(__file__, "claims.toml")
CLAIMS = tuple(Claim(**table) for table in _TABLES["claims"])
"""In the order of the paper, then its preliminaries."""
INTRODUCTION: str = _TABLES["introduction"]
