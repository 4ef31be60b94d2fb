"""The page of a learnt flight: the screen's report, pictures, and in folded chapters what was read and how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mavdem.dem import Settings
from mavdem.flight import Flight
from mavdem.page.document import Chapter, render_page
from mavdem.report.blocks import Block, Table
from mavdem.report.log_contents import log_blocks


def learned_page(
    flight: Flight, blocks: Sequence[Block], details: Sequence[Block], settings: Settings, held: dict[str, Any]
) -> str:
    """The HTML of a learnt flight.

    Args:
        flight: that was learnt from; its provenance names the log.
        blocks: the report on the screen.
        details: what the screen leaves out.
        settings: of the model.
        held: the log's inventory, of ``mavdem.alignment.inventory``.
    """
    source = Path(str(flight.provenance.get("source", "arrays"))).name
    return render_page(
        source,
        f"What {flight.output_names[0]} does in wind: a linear model learnt from this flight.",
        blocks,
        [
            Chapter("The model, and how it was learnt", details, folded=True),
            Chapter("What was read from the log, and repaired", log_blocks(held), folded=True),
            Chapter("Settings", [settings_table(settings)], folded=True),
        ],
    )


def settings_table(settings: Settings) -> Table:
    """Every setting by name; ``mavdem.Settings`` says what each means."""
    return Table(["setting", "value"], [[name, str(value)] for name, value in asdict(settings).items()])
