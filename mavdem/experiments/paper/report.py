"""The report of ``mavdem reproduce``, which runs a paper's experiments again: a page with a chapter for each claim."""

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
    authors_code,
    benchmark,
    generalized_coordinates,
    landscape,
    model_order,
    noise,
    prediction,
)
from mavdem.experiments.paper.checks import (
    ClaimStatus,
    ExperimentResult,
    claim_status,
    joined_findings,
)
from mavdem.experiments.paper.estimation import (
    input_estimation,
    noise_covariance,
    noise_smoothness,
    state_estimation,
)
from mavdem.facts import Level
from mavdem.report.blocks import Blocks, Rated, Sentence, Table
from mavdem.report.pages.page import Chapter
from mavdem.report.pages.page import render_document as page

EXPERIMENTS = (
    noise.run,
    prediction.run,
    generalized_coordinates.run,
    benchmark.run,
    model_order.run,
    authors_code.run,
    landscape.run,
    state_estimation.run,
    input_estimation.run,
    noise_covariance.run,
    noise_smoothness.run,
)
"""The functions that run the experiments, in the order of ``CLAIMS``."""

ITEMS = dict(zip(CLAIMS, EXPERIMENTS, strict=True))
"""The experiment of each claim: a function that takes the :class:`Runner`."""

PAGE = "index.html"
"""File name of the page in the folder of the report."""

NUMBERS = "numbers.json"
"""File name of the numbers in that folder."""

TITLE = "A Brain Inspired Learning Algorithm for the Perception of a Quadrotor in Wind"
"""Title of the paper."""


@dataclass(frozen=True)
class ItemReport:
    """The report on one claim of the paper: the claim, and the result of the experiment that tests it."""

    claim: Claim
    """The claim of the paper."""

    result: ExperimentResult
    """The result of its experiment."""

    @property
    def status(self) -> ClaimStatus:
        """Whether the claim is reproduced, by its checks; without any, it is not tried."""
        return claim_status(self.result.checks)

    @property
    def sentence(self) -> str:
        """The status and the findings of all checks, or why there are none, as one sentence."""
        if not self.result.checks:
            return f"Not tried: {' '.join(self.result.remarks)}"
        return f"{self.status.value.capitalize()}: {joined_findings(self.result.checks)}."

    def to_dict(self) -> JsonValues:
        """Returns the entry of this claim in ``numbers.json``, the file with all figures of the page.

        Returns:
            Values by key: ``paper`` is what the paper claims and where; ``verdict`` whether that is reproduced, and
            ``sentence`` the same in words; ``checks`` the rules with their findings; ``numbers`` the results of the
            experiment, whose keys each experiment defines; ``remarks`` the limits of the comparison.
        """
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
        """Returns the chapter of this claim on the page.

        From top to bottom: the paper's words with the labels of its figures and tables, the findings in one sentence, a
        table of the checks with their rules, the tables of the experiment, the remarks, and the figures.
        """
        claim = self.claim
        result = self.result
        quotation = f"“{claim.quote}” ({', '.join(claim.labels)})"
        blocks: Blocks = [Sentence(quotation, f"{claim.section}:"), Sentence(self.sentence)]
        # Without checks, the sentence above already contains the remarks.
        if result.checks:
            blocks.append(self._check_table())
            blocks += result.tables
            for remark in (*claim.remarks, *result.remarks):
                blocks.append(Sentence(remark))
        return Chapter(claim.title, blocks, [picture.group for picture in result.pictures])

    def findings(self) -> Blocks:
        """Returns what stands under this claim in a page of docs/evidence: the findings and the experiment's tables."""
        return [Sentence(self.sentence, f"{self.claim.title}:"), *self.result.tables]

    def _check_table(self) -> Table:
        """Returns the table of all checks with their findings and rules, those that fail first."""
        rows = []
        # False sorts before True.
        for check in sorted(self.result.checks, key=lambda check: check.holds):
            rows.append(["holds" if check.holds else "fails", check.finding, check.rule])
        return Table(["check", "finding", "holds if"], rows, words=True)


def document(reports: Sequence[ItemReport], seconds: float) -> JsonValues:
    """Returns the content of ``numbers.json``: all numbers as plain JSON values.

    Args:
        reports: one for each claim whose experiment ran.
        seconds: duration of all experiments, s.

    Returns:
        Values by key.
    """
    return {
        "paper": TITLE,
        "mavdem": version("mavdem"),
        "python": platform.python_version(),
        "seconds": round(seconds, 1),
        "items": [report.to_dict() for report in reports],
    }


def write(folder: Path, reports: Sequence[ItemReport], seconds: float) -> None:
    """Writes the page: a table of all claims with their status, then a chapter for each.

    Args:
        folder: folder of the report, which is created if need be.
        reports: one for each claim whose experiment ran.
        seconds: duration of all experiments, s.

    Raises:
        OSError: the folder or the page cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for report in reports:
        # Only a claim that is reproduced is coloured: the others are no warnings about the product.
        level = Level.GOOD if report.status is ClaimStatus.REPRODUCED else Level.UNKNOWN
        rows.append([report.claim.title, Rated(report.status.value, level), report.sentence])
    blocks: Blocks = [
        Sentence(INTRODUCTION),
        Table(["item", "status", "findings"], rows, words=True),
        Sentence(f"All numbers are in `{NUMBERS}`. It took {seconds:.0f} s."),
    ]
    html = page(
        "The paper’s experiments, run again",
        f"The experiments of {TITLE} (Anil Meera and Wisse) and of articles that followed, run again.",
        blocks,
        [report.chapter() for report in reports],
    )
    (folder / PAGE).write_text(html, "utf-8")
