"""The claims of the paper that are tested again, with the labels of its figures and tables.

Source: A. Anil Meera, M. Wisse, "A Brain Inspired Learning Algorithm for the Perception of a Quadrotor in Wind".
"""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import NamedTuple


class Claim(NamedTuple):
    """One claim that is tested again; ``labels`` count figures, tables and algorithms in the order of the source."""

    name: str
    title: str
    section: str
    labels: tuple[str, ...]
    quote: str


_TABLES = tomllib.loads((files("mavdem.paper") / "claims.toml").read_text())["claims"]
CLAIMS = tuple(Claim(**table | {"labels": tuple(table["labels"])}) for table in _TABLES)
"""In the order of the paper, then its preliminaries."""

MSPE_WITHOUT_COORDINATES = (0.1197, 0.0640, 0.1647, 0.0518, 0.0951)
"""Table II (SSE_GC), DEM without GC, p = 1: experiments 1 to 5, summed over outputs; 0.4953 in total."""

MSPE_WITH_COORDINATES = (0.0521, 0.0133, 0.0583, 0.0458, 0.1172)
"""Table II (SSE_GC), DEM with GC, p = 2: likewise; 0.2867 in total."""
