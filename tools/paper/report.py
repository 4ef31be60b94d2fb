"""Report: a folder with a page, its figures, the numbers and a recording."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, select_autoescape
from paper import benchmark, coordinates, demonstrations, noise, oracle, order, prediction
from paper.item import Found, Item
from paper.laboratory import PAPER, Laboratory
from paper.verdict import Verdict, found, sentence, verdict

import mavdem
from mavdem.cli.output import json_text
from mavdem.view import write_recording

ITEMS: tuple[Item, ...] = (
    noise.ITEM,
    prediction.ITEM,
    coordinates.ITEM,
    benchmark.ITEM,
    order.ITEM,
    oracle.ITEM,
    demonstrations.ITEM,
)
"""In the order of the paper, and then what it rests on."""

PAGE, NUMBERS, RECORDING, FIGURES = "index.html", "numbers.json", "experiment.rrd", "figures"


@dataclass(frozen=True)
class Judged:
    """An item with what was found.

    Attributes:
        item: which.
        found: what came of it.
    """

    item: Item
    found: Found

    @property
    def verdict(self) -> Verdict:
        """What its checks come to."""
        return verdict(self.found.checks)

    @property
    def sentence(self) -> str:
        """The verdict and why."""
        return sentence(self.found.checks) if self.found.checks else f"Not tried: {' '.join(self.found.remarks)}"

    @property
    def beyond(self) -> str:
        """What was found of settings that are not the paper's; empty where nothing was asked."""
        return f"Beyond the paper: {found(self.found.beyond)}." if self.found.beyond else ""

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name."""
        return {
            "name": self.item.name,
            "title": self.item.title,
            "paper": self.item.published._asdict(),
            "verdict": self.verdict.value,
            "sentence": self.sentence,
            "checks": [check._asdict() for check in self.found.checks],
            "beyond": {"sentence": self.beyond, "checks": [check._asdict() for check in self.found.beyond]},
            "numbers": self.found.numbers,
            "remarks": list(self.found.remarks),
        }


def document(judged: Sequence[Judged], seconds: float) -> dict[str, Any]:
    """All numbers as plain JSON values.

    Args:
        judged: the items.
        seconds: that they took.
    """
    return {
        "paper": "A Brain Inspired Learning Algorithm for the Perception of a Quadrotor in Wind",
        "mavdem": version("mavdem"),
        "python": platform.python_version(),
        "seconds": round(seconds, 1),
        "items": [one.to_dict() for one in judged],
    }


def write(
    folder: Path,
    judged: Sequence[Judged],
    laboratory: Laboratory,
    seconds: float,
) -> None:
    """Writes the page, figures, numbers and the recording of the experiment that figures of one flight show.

    Args:
        folder: to write into; made if it is not there.
        judged: the items.
        laboratory: where they were done.
        seconds: that they took.
    """
    figures = folder / FIGURES
    figures.mkdir(parents=True, exist_ok=True)
    files = {
        picture.name: {theme: f"{FIGURES}/{name}" for theme, name in picture.write(figures).items()}
        for one in judged
        for picture in one.found.pictures
    }
    window = laboratory.sample
    write_recording(folder / RECORDING, window.train, window.test, mavdem.learn(window.train, PAPER))
    told = document(judged, seconds)
    (folder / NUMBERS).write_text(json_text(told) + "\n")
    (folder / PAGE).write_text(_page(judged, files, told, window.flight))


def _page(judged: Sequence[Judged], files: dict[str, dict[str, str]], told: dict[str, Any], recorded: str) -> str:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=select_autoescape(),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(
        judged=judged, files=files, told=told, numbers=NUMBERS, recording=RECORDING, recorded=recorded
    )
