"""The experiments of the paper, run again: ``mavdem reproduce``, and the claims that they test, in ``claims.toml``.

Needs the extra ``paper``: ``pip install 'mavdem[paper]'``.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, eq=False)
class Claim:
    """One claim that is tested again; ``labels`` are the paper's figures, tables and algorithms about it."""

    name: str
    title: str
    section: str
    labels: list[str]
    quote: str


_TABLES = tomllib.loads(Path(__file__).with_name("claims.toml").read_text(encoding="utf-8"))["claims"]
CLAIMS = tuple(Claim(**table) for table in _TABLES)
"""In the order of the paper, then its preliminaries."""
