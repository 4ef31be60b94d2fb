"""Cautions on how far the margins of identified loops, and gains computed from them, can be trusted."""

from collections.abc import Iterable
from operator import attrgetter
from typing import NamedTuple

from mavdem.facts import Fact
from mavdem.facts.loops import LoopFact
from mavdem.loops.advice import Advice, AdviceByAxis
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.templates import sentences_by_axes


class _SharedCaution(NamedTuple):
    """A sentence on how far the margins and advised gains of some axes can be trusted."""

    axes: tuple[str, ...]
    """The axes that it is about."""

    sentence: Sentence

    is_about_gains_to_set: bool
    """Whether it limits the gains that are computed from the loop (:func:`is_about_gains_to_set`)."""


def loop_cautions(advice_by_axis: AdviceByAxis) -> Blocks:
    """Returns the cautions on how far the stability margins and the advised gains of each axis can be trusted.

    They are about the identified loops, from which both follow. Axes with the same caution share a sentence.

    Args:
        advice_by_axis: advice by axis, or the fact (coded finding) that says why there is none, for which no caution is
            returned.
    """
    return [caution.sentence for caution in shared_cautions(advice_by_axis)]


def shared_cautions(advice_by_axis: AdviceByAxis) -> list[_SharedCaution]:
    """Returns sentences on how far the margins of identified loops, and gains computed from them, can be trusted.

    Such a caution may hold for several axes. If their texts differ by the name of the axis only, and so agree in all
    figures as printed, one sentence names these axes.

    Args:
        advice_by_axis: advice for each axis, or the fact (coded finding) that says why there is none.

    Returns:
        The sentences with their axes, in the order of the first axis.
    """
    cautions_by_text: dict[str, list[tuple[str, Fact]]] = {}
    for axis, advice in advice_by_axis.items():
        if isinstance(advice, Fact):
            continue
        for caution in advice.before.cautions:
            text_without_axis = caution.replace(axis="").sentence_and_remedy
            cautions_by_text.setdefault(text_without_axis, []).append((axis, caution))
    cautions = []
    for axes_and_cautions in cautions_by_text.values():
        # Cautions with the same text make one sentence, which names all their axes.
        (sentence,) = sentences_by_axes(axes_and_cautions, attrgetter("sentence_and_remedy"))
        axes = tuple(axis for axis, _ in axes_and_cautions)
        _, first_caution = axes_and_cautions[0]
        is_about_gains = is_about_gains_to_set(first_caution)
        cautions.append(_SharedCaution(axes, sentence, is_about_gains))
    return cautions


def is_about_gains_to_set(caution_of_loop: Fact) -> bool:
    """Returns whether a caution about an identified loop also holds for the gains that are computed from the loop.

    All do but one: that an AutoTune flight left these gains says something about the present gains only.

    Args:
        caution_of_loop: one of the loop's cautions.
    """
    return caution_of_loop.code is not LoopFact.AUTOTUNED


def caution_sentences(
    cautions: Iterable[_SharedCaution], advice: Advice, *, has_gains_elsewhere: bool
) -> list[Sentence]:
    """Returns the sentences on how far the identified loop of one axis can be trusted, as its report shows them.

    A sentence that several axes share is shown with the first of them only.

    Args:
        cautions: the cautions about the loops of all axes.
        advice: advice on the axis.
        has_gains_elsewhere: whether a page has a table of the gains to set elsewhere. Beside it stand the cautions
            about these gains.
    """
    are_gains_elsewhere = has_gains_elsewhere and bool(advice.parameters)
    sentences = []
    for caution in cautions:
        is_elsewhere = are_gains_elsewhere and caution.is_about_gains_to_set
        if caution.axes[0] == advice.before.axis and not is_elsewhere:
            sentences.append(caution.sentence)
    return sentences
