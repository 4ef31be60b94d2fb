"""Models of the JSON documents of ``mavdem convert``, ``mavdem fly`` and ``mavdem reproduce``."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from mavdem.containers import JsonValues
from mavdem.documents.document import Document, SentenceText
from mavdem.units import Seconds


class Converted(Document):
    """A conversion."""

    source: str
    """IN as on the command line"""
    out: str
    """OUT as on the command line"""


class Convert(Converted, is_partial=True):
    """`--json` of convert."""

    frames: int
    """number of frames written; with the next five for a stream only"""
    left_out: int
    """number of messages that cannot be encoded"""
    unread: int
    """number of frames of another dialect, or damaged"""
    stamps_filled: int
    """number of frames with the receive time of the one before"""
    bytes_skipped: int
    """number of bytes that belong to no frame"""
    repairs: list[SentenceText]
    """what was put right, one sentence each"""
    samples: int
    """number of rows or positions; with the others for a table, with ``start`` and ``end`` for a path"""
    columns: list[str]
    """names of the columns, with units"""
    dt: Seconds = None
    """sampling step"""
    resampling: dict[str, str]
    """how signals came onto one clock"""
    start: Seconds = None
    """first time stamp, on the boot clock"""
    end: Seconds = None
    """last time stamp, on the boot clock"""
    learnable: bool
    """whether a full model can be learned"""
    cautions: list[SentenceText]
    """what limits the table, one sentence each"""


class Listed(Document):
    """A scenario of the list."""

    name: str
    """name of the scenario"""
    description: str
    """what it is, one sentence"""


class Fly(Document, is_partial=True):
    """`--json` of fly."""

    scenarios: list[Listed]
    """all scenarios; with --list only"""
    scenario: str
    """name or file of the scenario"""
    values: JsonValues
    """all keys of the scenario's file; with --describe only"""
    seed: int
    """seed of the wind"""
    duration: Seconds = None
    """time from arming to disarming"""
    out: str
    """log that was written"""
    frames: int
    """number of frames written or sent"""
    truth: str
    """file of the true states"""
    rrd: str
    """recording for Rerun"""
    took: Seconds = None
    """time that it took"""
    udp: str
    """ground station; with the next three for a live flight only"""
    commands: int
    """number of commands received"""
    flown: Seconds = None
    """time that was simulated"""
    stopped: bool
    """whether the flight was ended early"""


class ListedClaim(Document):
    """A claim of the list."""

    name: str
    """name of the claim"""
    title: str
    """title of the claim"""
    section: str
    """section of the paper"""


class Claim(Document):
    """A claim of the paper, and where it stands there."""

    section: str
    """section of the paper"""
    labels: list[str]
    """labels of its figures and tables"""
    claim: str = Field(validation_alias="quote")
    """the claim in the paper's words"""


class Check(Document):
    """One condition of a claim."""

    rule: str
    """the condition"""
    holds: bool
    """whether it holds"""
    finding: str
    """the result with its numbers"""


class Item(Document):
    """One claim of the paper, reproduced."""

    name: str
    """name of the claim, as in --list"""
    title: str
    """title of the claim"""
    paper: Claim
    """where the claim stands in the paper"""
    verdict: SentenceText
    """whether it holds"""
    sentence: SentenceText
    """what was found"""
    checks: list[Check]
    """conditions of the claim"""
    numbers: Any
    """all figures, by name"""
    remarks: list[SentenceText]
    """what to know of it, one sentence each"""


class Reproduce(Document, is_partial=True):
    """The document numbers.json, and `--json` of reproduce."""

    claims: list[ListedClaim]
    """all claims; with --list, and nothing else"""
    paper: str
    """title of the paper"""
    mavdem: str
    """version of the program"""
    python: str
    """version of Python"""
    seconds: Seconds = None
    """time that it took"""
    items: list[Item]
    """the paper's claims"""
