"""The report of `mavdem reproduce`: a page with its figures, the numbers, and a recording for Rerun."""

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from mavdem.containers import JsonValues
from mavdem.experiments.paper import (
    CLAIMS,
    INTRODUCTION,
    Claim,
    forecasts,
    landscape,
    noise,
    oracle,
    order,
)
from mavdem.experiments.paper.runner import ClaimStatus, ExperimentResult, findings
from mavdem.facts import Level
from mavdem.report.blocks import Blocks, Rated, Sentence, Table
from mavdem.report.pages.page import Chapter
from mavdem.report.pages.page import render_document as page

EXPERIMENTS = (
    *(noise.run, forecasts.prediction, forecasts.coordinates, forecasts.benchmark),
    *(order.run, oracle.run, landscape.run),
)
ITEMS = dict(zip(CLAIMS, EXPERIMENTS, strict=True))

PAGE = "index.html"
NUMBERS = "numbers.json"
TITLE = "A Brain Inspired Learning Algorithm for the Perception of a Quadrotor in Wind"


@dataclass(frozen=True)
class ItemReport:
    """A claim and the result of its experiment."""

    claim: Claim
    result: ExperimentResult

    @property
    def status(self) -> ClaimStatus:
        """Whether the claim is reproduced, from the checks; without any, it is not tried."""
        held = [check.holds for check in self.result.checks]
        if not held:
            return ClaimStatus.UNTRIED
        return (
            ClaimStatus.REPRODUCED
            if all(held)
            else ClaimStatus.PARTLY
            if any(held)
            else ClaimStatus.NOT
        )

    @property
    def sentence(self) -> str:
        """The status and the findings behind it."""
        if not self.result.checks:
            return f"Not tried: {' '.join(self.result.remarks)}"
        return f"{self.status.value.capitalize()}: {findings(self.result.checks)}."

    def to_dict(self) -> JsonValues:
        """Returns plain JSON values by name."""
        claim = self.claim
        return {
            "name": claim.name,
            "title": claim.title,
            "paper": claim,
            "verdict": self.status.value,
            "sentence": self.sentence,
            "checks": self.result.checks,
            "numbers": self.result.numbers,
            "remarks": [*claim.remarks, *self.result.remarks],
        }

    def chapter(self) -> Chapter:
        """Returns its part of the page: the claim, what was found, the rules of the checks, tables and figures."""
        claim = self.claim
        result = self.result
        blocks: Blocks = [
            Sentence(f"“{claim.quote}” ({', '.join(claim.labels)})", f"{claim.section}:"),
            Sentence(self.sentence),
        ]
        if result.checks:
            checks = [
                ["holds" if check.holds else "fails", check.finding, check.rule]
                for check in sorted(result.checks, key=lambda check: check.holds)
            ]
            blocks += [Table(["check", "finding", "holds if"], checks, words=True), *result.tables]
            blocks += map(Sentence, (*claim.remarks, *result.remarks))
        return Chapter(claim.title, blocks, [picture.group for picture in result.pictures])


def document(reports: Sequence[ItemReport], seconds: float) -> JsonValues:
    """Returns all numbers as plain JSON values, the content of ``numbers.json``."""
    return {
        "paper": TITLE,
        "mavdem": version("mavdem"),
        "python": platform.python_version(),
        "seconds": round(seconds, 1),
        "items": [report.to_dict() for report in reports],
    }


def write(folder: Path, reports: Sequence[ItemReport], seconds: float) -> None:
    """Writes the page."""
    folder.mkdir(parents=True, exist_ok=True)
    levels = {ClaimStatus.REPRODUCED: Level.GOOD}
    rows = [
        [
            report.claim.title,
            Rated(report.status.value, levels.get(report.status, Level.UNKNOWN)),
            report.sentence,
        ]
        for report in reports
    ]
    blocks: Blocks = [
        Sentence(INTRODUCTION),
        Table(["item", "status", "findings"], rows, words=True),
        Sentence(f"All numbers are in `{NUMBERS}`. It took {seconds:.0f} s."),
    ]
    subtitle = f"The experiments of {TITLE} (Anil Meera and Wisse), run again."
    html = page(
        "The paper’s experiments, run again",
        subtitle,
        blocks,
        [report.chapter() for report in reports],
    )
    (folder / PAGE).write_text(html)
