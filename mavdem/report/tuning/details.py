"""Details of a tuning: further figures of the loops, and what they and the gains are based on."""

from collections.abc import Container

from mavdem.assessment.axis.tuning import Tuning
from mavdem.facts import Fact
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import Loop
from mavdem.loops.filters import gyro_delay, gyro_filters
from mavdem.report.blocks import Blocks, Sentence, headline_sentence
from mavdem.report.templates import render_section
from mavdem.report.tuning.figures import TUNED_FIGURES
from mavdem.report.tuning.gains import gain_sentences
from mavdem.report.tuning.goal import warning_of_unchecked_effects
from mavdem.report.tuning.outcomes import has_doubtful_margins
from mavdem.report.tuning.tables import compared_loops, loop_columns, margin_tables


def tune_details(tuning: Tuning) -> Blocks:
    """Returns the details of a tuning: further figures of the loops, and what they and the gains are based on.

    Axes without an identified loop are left out, and figures that :func:`tuned_loops_table` has.

    Args:
        tuning: advice for each axis, or the fact (coded finding) that says why there is none.
    """
    compared = loop_columns(tuning)
    blocks = Blocks()
    if compared.by_header:
        blocks += margin_tables(
            compared.by_header, compared.doubtful_headers, omitted_figures=TUNED_FIGURES
        )
    for axis, advice in tuning.axes.items():
        if isinstance(advice, Fact):
            continue
        is_doubtful = has_doubtful_margins(tuning, axis)
        blocks.append(headline_sentence(axis.capitalize()))
        blocks += gain_sentences(advice)
        blocks += _basis_sentences(advice.before, is_doubtful=is_doubtful)
    return [*blocks, *warning_of_unchecked_effects(tuning)]


def axis_details(advice: Advice, *, is_doubtful: bool) -> Blocks:
    """Returns the details of a tuning on one axis: sentences on its gains, tables of its margins, what both rest on.

    The tables compare the loops as flown with those with the advised gains. The last sentences are about the filters of
    the gyro, and about how well the identified loop predicts the measured response of the rate.

    Args:
        advice: advice on the axis, with its loops.
        is_doubtful: whether a measured response contradicts the identified loop, and so all its margins.
    """
    # The loops as flown and with the advised gains, by the header of their column in the tables.
    loops = compared_loops(advice)
    # Both loops come from the same identified model, so that either all of them are doubtful or none.
    doubtful_loops: Container[str] = ()
    if is_doubtful:
        doubtful_loops = loops
    blocks: Blocks = list(gain_sentences(advice))
    blocks += margin_tables(loops, doubtful_loops)
    blocks += _basis_sentences(advice.before, is_doubtful=is_doubtful)
    return blocks


def _basis_sentences(loop: Loop, *, is_doubtful: bool) -> list[Sentence]:
    """Returns sentences on the gyro's filters of a loop, and on how well its prediction fits the measured response.

    Args:
        loop: the loop of an axis as it flew. It may have been compared with a measured step response.
        is_doubtful: whether any measured response contradicts it.
    """
    sentences = filter_sentences(loop)
    # Without a comparison the template says that no response was measured. That would be wrong if the loop is doubtful,
    # since a response of another kind was measured then.
    was_compared = loop.agrees is not None
    if was_compared or not is_doubtful:
        sentences += render_section("loop_measured", loop=loop)
    return sentences


def filter_sentences(loop: Loop) -> list[Sentence]:
    """Returns the sentence on the gyro's filters of a loop, their delay and phase lag; none without filters.

    Args:
        loop: a rate loop, with the filters of its controller. The phase lag is stated at its crossover frequency.
    """
    return render_section(
        "loop_filters",
        filters=gyro_filters(loop.controller, loop.crossover),
        delay=gyro_delay(loop.controller),
        crossover=loop.crossover,
    )
