"""The report of `mavdem reproduce`: a page with its figures, the numbers, and a recording for Rerun."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mavdem.dem import learn
from mavdem.evaluate import held_out_test
from mavdem.paper import benchmark, coordinates, noise, oracle, order, prediction
from mavdem.paper.checks import ClaimStatus, claim_status, findings, sentence
from mavdem.paper.item import Item, ItemResult
from mavdem.paper.landscape import experiment
from mavdem.paper.runner import PAPER, Runner
from mavdem.report.page import environment
from mavdem.view import write_recording

ITEMS: tuple[Item, ...] = (
    noise.ITEM,
    prediction.ITEM,
    coordinates.ITEM,
    benchmark.ITEM,
    order.ITEM,
    oracle.ITEM,
    experiment.ITEM,
)
"""In the order of the paper, then its preliminaries."""

PAGE, NUMBERS, RECORDING, FIGURES = "index.html", "numbers.json", "experiment.rrd", "figures"


@dataclass(frozen=True)
class ItemReport:
    """An item and its result."""

    item: Item
    result: ItemResult

    @property
    def status(self) -> ClaimStatus:
        """Whether the claim is reproduced, from the checks."""
        return claim_status(self.result.checks)

    @property
    def sentence(self) -> str:
        """The status and the findings behind it."""
        return sentence(self.result.checks) if self.result.checks else f"Not tried: {' '.join(self.result.remarks)}"

    @property
    def beyond(self) -> str:
        """The findings with settings that are not the paper's; empty where there are none."""
        return f"Beyond the paper: {findings(self.result.beyond)}." if self.result.beyond else ""

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        claim = self.item.claim
        return {
            "name": claim.name,
            "title": claim.title,
            "paper": {"section": claim.section, "labels": claim.labels, "claim": claim.quote},
            "verdict": self.status.value,
            "sentence": self.sentence,
            "checks": [check._asdict() for check in self.result.checks],
            "beyond": {"sentence": self.beyond, "checks": [check._asdict() for check in self.result.beyond]},
            "numbers": self.result.numbers,
            "remarks": list(self.result.remarks),
        }


def document(reports: Sequence[ItemReport], seconds: float) -> dict[str, Any]:
    """All numbers as plain JSON values, the content of ``numbers.json``."""
    return {
        "paper": "A Brain Inspired Learning Algorithm for the Perception of a Quadrotor in Wind",
        "mavdem": version("mavdem"),
        "python": platform.python_version(),
        "seconds": round(seconds, 1),
        "items": [one.to_dict() for one in reports],
    }


def write(folder: Path, reports: Sequence[ItemReport], runner: Runner, seconds: float) -> None:
    """Writes the page, its figures, and the recording of the experiment in the figures of one flight."""
    figures = folder / FIGURES
    figures.mkdir(parents=True, exist_ok=True)
    files = {
        picture.name: {theme: f"{FIGURES}/{name}" for theme, name in picture.write(figures).items()}
        for one in reports
        for picture in one.result.pictures
    }
    window = runner.sample
    learned = learn(window.train, PAPER)
    held_out = held_out_test(window.train, window.test, learned)
    write_recording(folder / RECORDING, (window.train,), learned, held_out)
    (folder / PAGE).write_text(_page(reports, files, document(reports, seconds), window.flight))


def _page(
    reports: Sequence[ItemReport], files: dict[str, dict[str, str]], summary: dict[str, Any], recorded: str
) -> str:
    template = environment("mavdem.paper").get_template("page.html")
    return template.render(
        reports=reports, files=files, summary=summary, numbers=NUMBERS, recording=RECORDING, recorded=recorded
    )
