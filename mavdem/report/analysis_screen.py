"""The screen of a log's analysis, whatever its tier: with a model, with one of the slow motion, or without."""

from __future__ import annotations

from mavdem.analysis import LogAnalysis
from mavdem.report.blocks import Block, Sentence
from mavdem.report.condition import condition_sentences, identity_sentence, tier_sentences
from mavdem.report.screen import screen


def analysis_blocks(found: LogAnalysis) -> list[Block]:
    """What is reported of one vehicle and axis: the screen of its model, else what is known without one, and why."""
    model: list[Block] = []
    if found.learned is not None:
        model = screen(found.learned, found.held_out, found.vehicle.hover)
    if found.tier.name == "a" and model:
        return model
    tier = tier_sentences(found.tier.as_dict())
    # What to do next is to record faster, whatever the findings.
    why = [] if model else [Sentence(found.reason, "No model:")]
    remedy = [Sentence(found.remedy, "What to do:")] if found.remedy else []
    identity = identity_sentence(found.identity.as_dict())
    return [*why, *remedy, *tier, *model[:-1], identity, *condition_sentences(found.condition.as_dict())]
