"""The experiments of the paper, run again: ``mavdem reproduce``, and the claims that they test, in ``claims.toml``.

Needs the extra ``view``: ``pip install 'mavdem[view]'``.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


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


_TABLES = tomllib.loads(Path(__file__).with_name("claims.toml").read_text(encoding="utf-8"))
CLAIMS = tuple(Claim(**table) for table in _TABLES["claims"])
"""In the order of the paper, then its preliminaries."""
INTRODUCTION: str = _TABLES["introduction"]
