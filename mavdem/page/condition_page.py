"""The page of a flight without a model: why there is none, and the vehicle's condition."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mavdem.page.document import Chapter, render_page
from mavdem.report.blocks import Block, Sentence
from mavdem.report.log_contents import log_blocks


def condition_page(heading: Sentence, blocks: Sequence[Block], held: dict[str, Any]) -> str:
    """The HTML of a flight without a model.

    Args:
        heading: which log, and what of it.
        blocks: the report on the screen.
        held: the log's inventory, of ``mavdem.condition.inventory``.
    """
    return render_page(
        heading.lead.rstrip(":"),
        heading.text[:1].upper() + heading.text[1:],
        blocks,
        [Chapter("What was read from the log, and repaired", log_blocks(held), folded=True)],
    )
