"""Changed parameters of the autopilot in words, the gains of rate control first."""

from collections.abc import Sequence

from mavdem.fleet.calibration_changes import calibration_changes
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS, RATE_PID_GAINS
from mavdem.report.blocks import Blocks, Sentence, Table
from mavdem.report.difference.gain_table import tabled_gains
from mavdem.report.difference.parameter_rows import parameter_rows, parameter_text
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.templates import render_section

MAX_COUNTED_NAMES = 5
"""Largest number of parameters set anew whose names stand beside their number: a choice, one line of a terminal."""


def parameter_sentences(
    reviewed: ReviewedDifference, headline: Sequence[Sentence] = ()
) -> list[Sentence]:
    """Returns the sentences on parameters: those that changed, how many are equal, and what is not known of them.

    Args:
        reviewed: comparison of two states, with the changed parameters.
        headline: sentences shown above; parameters that they name are left out.
    """
    changed = changed_parameter_sentences(reviewed, headline)
    return [*changed, *parameter_count_sentences(reviewed, headline)]


def changed_parameter_sentences(
    reviewed: ReviewedDifference, headline: Sequence[Sentence] = ()
) -> list[Sentence]:
    """Returns the sentence that names the changed parameters with both values; empty where the headline names all.

    Args:
        reviewed: comparison of two states, with the changed parameters.
        headline: sentences shown above; parameters that they name, or the table of gains below them, are left out.
    """
    texts_above = " ".join(sentence.text for sentence in headline)
    gains_above = tabled_gains(reviewed) if headline else []
    parameters = []
    for parameter in _gains_first(reviewed.parameters):
        text = parameter_text(parameter)
        if text not in texts_above and parameter not in gains_above:
            parameters.append(text)
    return render_section(
        "difference_parameters",
        parameters=parameters,
        are_two_vehicles=reviewed.are_two_vehicles,
    )


def parameter_blocks(reviewed: ReviewedDifference, *, verbose: bool) -> Blocks:
    """Returns a table of changed parameters with both values and the change of gains, and how many are equal.

    Args:
        reviewed: comparison of two states, with the changed parameters.
        verbose: whether the table has all of them; otherwise those of control, and a sentence says how many more.
    """
    shown_parameters = []
    for parameter in reviewed.parameters:
        if verbose or CONTROL_PARAMETERS.match(parameter.name):
            shown_parameters.append(parameter)
    rows = parameter_rows(shown_parameters, has_percentages=True)
    tables = [Table(["parameter", *STATE_NAMES, "change"], rows)] if rows else []
    further_count = len(reviewed.parameters) - len(shown_parameters)
    return [
        *tables,
        *parameter_count_sentences(reviewed),
        *render_section("difference_more_parameters", count=further_count),
    ]


def parameter_count_sentences(
    reviewed: ReviewedDifference, headline: Sequence[Sentence] | None = None
) -> list[Sentence]:
    """Returns how many parameters are equal, and who set the others: a person, a calibration, or the autopilot itself.

    Args:
        reviewed: comparison of two states, with the changed parameters of both kinds.
        headline: sentences shown above. A few changed parameters that they do not name are named here; None where a
            table names them.

    Returns:
        The sentence with these numbers, which add up to all parameters that both sides have, and a sentence on
        parameters that could not be compared; empty if neither side has parameters.
    """
    calibrations = calibration_changes(reviewed.parameters_set_by_autopilot)
    changed_count = len(reviewed.parameters)
    set_by_autopilot_count = len(reviewed.parameters_set_by_autopilot)
    common_count = reviewed.common_parameter_count
    return render_section(
        "difference_parameter_counts",
        common_count=common_count,
        equal_count=common_count - changed_count - set_by_autopilot_count,
        changed_count=changed_count,
        # The table of gains below the headline may have all that changed.
        are_others_equal=headline is not None
        and not set_by_autopilot_count
        and 0 < changed_count == len(tabled_gains(reviewed)),
        changed_names=[] if headline is None else _few_further_names(reviewed, headline),
        calibrations=calibrations,
        are_two_vehicles=reviewed.are_two_vehicles,
        sides_without_parameters=reviewed.sides_without_parameters,
        has_two_autopilots=reviewed.has_two_autopilots,
        are_of_control=reviewed.has_only_control_parameters,
        tracked_sides=reviewed.tracked_sides,
        outdated_sides=reviewed.outdated_sides,
    )


def _few_further_names(reviewed: ReviewedDifference, headline: Sequence[Sentence]) -> list[str]:
    """Returns the names of the changed parameters; empty if they are many, or if the headline or its table names one.

    Args:
        reviewed: comparison of two states, with the changed parameters.
        headline: sentences shown above.
    """
    names = [parameter.name for parameter in reviewed.parameters]
    text_above = " ".join(sentence.text for sentence in headline)
    if tabled_gains(reviewed):
        return []
    if len(names) > MAX_COUNTED_NAMES or any(name in text_above for name in names):
        return []
    return names


def _gains_first(parameters: Sequence[ParameterChange]) -> list[ParameterChange]:
    """Returns the changed parameters with the gains of rate control before all others."""
    return sorted(parameters, key=lambda parameter: not RATE_PID_GAINS.match(parameter.name))
