"""Golden files: a whole screen each, compared line by line."""

from collections.abc import Iterable
from pathlib import Path

import pytest

from mavdem.report.blocks import Block, text_of


def is_golden(request: pytest.FixtureRequest, name: str, blocks: Iterable[Block]) -> None:
    """Asserts that blocks read as the golden file of this name, which ``--write-golden`` writes."""
    path, text = Path(__file__).parent / "report" / "golden" / f"{name}.txt", text_of(blocks) + "\n"
    if request.config.getoption("--write-golden"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    assert text.splitlines() == path.read_text().splitlines()
