"""Reproduction of the paper's experiments (``mavdem reproduce``), and the claims that they check, from ``claims.toml``.

The paper is A. Anil Meera and M. Wisse, "A Brain Inspired Learning Algorithm for the Perception of a Quadrotor in
Wind". Each claim has one experiment, which a module of this package runs and checks by rules that are fixed beforehand.
``estimation`` has the experiments of articles that followed it.

Its figures need matplotlib, the extra ``plot``: ``pip install 'mavdem[plot]'``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mavdem.files import load_adjacent_toml


@dataclass(frozen=True, eq=False)
class Claim:
    """One claim of the paper that is checked; the names of the fields are keys of ``claims.toml`` and of documents."""

    name: str
    """Name of the claim on the command line."""

    title: str
    """Heading of the claim on the page."""

    section: str
    """Number and title of the paper's section that makes the claim."""

    labels: list[str]
    """The paper's figures, tables and algorithms on the claim, each with its LaTeX label in brackets."""

    quote: str
    """The claim, in the paper's words."""

    remarks: Sequence[str] = ()
    """Sentences on how the claim is checked."""


_TABLES = load_adjacent_toml(__file__, "claims.toml")

CLAIMS = tuple(Claim(**table) for table in _TABLES["claims"])
"""All claims, in the order of the paper; the authors' code and the paper's preliminaries come last."""

INTRODUCTION: str = _TABLES["introduction"]
"""Paragraph at the top of the page, on how claims are checked."""
