"""Summary: the account of a learnt flight as Markdown, and how to read the pictures beside it."""

from __future__ import annotations

from mavdem import evaluate
from mavdem.account import Sentence, Table, account
from mavdem.dem import Learned
from mavdem.flight import Flight

READING = (
    "**To read the pictures:** in those by iteration, +1s on the axis is iteration 10 (or choose the timeline "
    "*iteration* below); in the others, 0 s is {start:.2f} s on the autopilot's clock. "
    "Thin lines beside a thick one are its 90 % band, for A and B that of DEM's own posterior, which is narrower than "
    "the ± above; y ← x is the entry of A, B or C by which x "
    "drives y, in the model's units. "
    "λ of z is about measurement noise, λ of w about process noise: higher means less noise."
)


def summary(train: Flight, test: Flight, learned: Learned) -> str:
    """What a reader must know before, and can know from, the pictures."""
    told = account(evaluate.report(train, test, learned), train, test, learned)
    return "\n\n".join([*map(_markdown, told), READING.format(start=train.time[0])])


def _markdown(block: Sentence | Table) -> str:
    if isinstance(block, Sentence):
        return f"**{block.lead}** {block.text}".rstrip() if block.lead else block.text
    rule = ["---", *["---:"] * (len(block.header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [block.header, rule, *block.rows])
