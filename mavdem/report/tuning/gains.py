"""The gains to change on an axis: their table, and sentences on what to expect of them."""

from collections.abc import Mapping

from mavdem.facts.loops import GainFact
from mavdem.loops.advice import GAIN_REDUCTION, Advice, Gain
from mavdem.loops.gain_design import MAX_GAIN_STEP, round_gain
from mavdem.report.blocks import Sentence, Table
from mavdem.report.templates import render_section

REASONS_FOR_GAINS = (GainFact.STEP_BOUND, GainFact.INTEGRAL_FALLS)
"""Notes on gains that say why they are no others; they stand beside the gains. The remaining ones are details."""


def gain_table(advice: Advice) -> list[Table]:
    """Returns a table of the controller gains to change on one axis.

    The table has a row for each changed gain: its value now, the value to set, and the factor between them.

    Args:
        advice: gains ``now`` and to ``set`` by name of the parameter, and the control loop before and after.

    Returns:
        A list with the table; empty if no gain changes.
    """
    rows = []
    for name, gain in advice.gains.items():
        row = gain_row(name, gain)
        _, text_now, text_to_set, _ = row
        # Two values that look equal in the table, which shows four digits, are no change to a reader.
        if text_now != text_to_set:
            rows.append(row)
    if not rows:
        return []
    return [Table(["gain", "now", "set", "times"], rows)]


def gain_row(name: str, gain: Gain) -> list[str]:
    """Returns the row of a gain: its name, value now, value to set, and the factor between them (1 for a gain of 0)."""
    factor = gain.set / gain.now if gain.now else 1.0
    # Gains are rounded to three digits: 0.2 is lowered to 0.133, by the same factor as all others.
    is_lowered_by_rule = round_gain(gain.set) == round_gain(GAIN_REDUCTION * gain.now)
    if gain.now and is_lowered_by_rule:
        factor = GAIN_REDUCTION
    return [name, f"{gain.now:.4g}", f"{gain.set:.4g}", f"{factor:.2f}"]


def axes_by_gain_sentence(
    advice_by_axis: Mapping[str, Advice], *, has_gains_above: bool
) -> dict[Sentence, list[str]]:
    """Returns sentences on what the advised gains are expected to do, each with the axes of which it is said.

    Args:
        advice_by_axis: gains by name of the parameter, and the control loop before and after, by axis.
        has_gains_above: whether the page has the gains and how to try them at its top, which is not repeated.
    """
    axes_by_sentence = dict[Sentence, list[str]]()
    for axis, advice in advice_by_axis.items():
        for sentence in gain_sentences(advice, has_gains_above=has_gains_above):
            axes_by_sentence.setdefault(sentence, []).append(axis)
    return axes_by_sentence


def gain_sentences(advice: Advice, *, has_gains_above: bool = False) -> list[Sentence]:
    """Returns sentences on what to expect of the advised gains of one axis, such as how far wind will tilt the vehicle.

    Further ones state what comes after this step if it does not reach the margins, unusual ratios of the gains, and how
    much noise of the gyro heats the motors. The template "loop_gains" makes them.

    Args:
        advice: the gains that flew and the advised ones, with the control loop that has each of them, and notes.
        has_gains_above: whether the page begins with the gains to load and how to try them. That includes to check the
            motors' temperature, which is then not repeated here.
    """
    # Notes on why the gains are not others are shown with the gains themselves.
    unusual_notes = [note for note in advice.notes if note.code not in REASONS_FOR_GAINS]
    return render_section(
        "loop_gains",
        advice=advice,
        unusual_notes=unusual_notes,
        largest_step=MAX_GAIN_STEP,
        has_gains_above=has_gains_above,
    )
