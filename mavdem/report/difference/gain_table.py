"""The gains that changed between two states: a phrase for the headline, and a table with both values below it."""

from collections.abc import Collection, Sequence
from math import inf, log

from mavdem.containers import group_by
from mavdem.dataset.axes import AXES
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.parameter_changes import ParameterChange, axes_of_parameter
from mavdem.ingest.vocabulary import (
    ATTITUDE_GAIN,
    AXIS_RATE_LOOP_PARAMETERS,
    FLIGHT_INDEPENDENT_PARAMETERS,
    RATE_PID_GAINS,
)
from mavdem.report.blocks import Table
from mavdem.report.difference.parameter_rows import parameter_value_texts, percentage_text
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.numbers import listed

MAX_TABLE_ROWS = 10
"""Rows of the table below the headline: P, I and D of three axes, and one more. A choice, half of a terminal."""

MAX_CHANGES_IN_PHRASE = 4
"""Largest number of different changes that the headline states in percent: a choice, one line of a terminal."""


def changed_rate_gains(
    parameters: Sequence[ParameterChange], axes: Collection[str]
) -> list[ParameterChange]:
    """Returns the gains of the rate controllers that changed, the one with the largest factor of change first.

    Args:
        parameters: all parameters of the autopilot that changed.
        axes: only gains that act on one of these axes are returned; empty for the gains of all axes.
    """
    gains = []
    for parameter in parameters:
        is_of_axes = not axes or not set(axes).isdisjoint(axes_of_parameter(parameter.name))
        if RATE_PID_GAINS.match(parameter.name) and is_of_axes:
            gains.append(parameter)
    return sorted(gains, key=_log_factor, reverse=True)


def _log_factor(parameter: ParameterChange) -> float:
    """Returns the magnitude of the logarithm of the factor by which a parameter changed; infinite from or to 0."""
    if parameter.before == 0 or parameter.after == 0:
        return inf
    return abs(log(abs(parameter.after / parameter.before)))


def rate_gains_in_order(parameters: Sequence[ParameterChange]) -> list[ParameterChange]:
    """Returns the gains of rate control among changed parameters, by axis, and on each axis in the order P, I, D."""
    return sorted(changed_rate_gains(parameters, ()), key=_axis_and_term)


def tabled_gains(reviewed: ReviewedDifference) -> list[ParameterChange]:
    """Returns the gains and filters that the table below the headline has; empty if no gain of rate control changed.

    Of two vehicles, gains are no change, and the headline has no table of them.

    Args:
        reviewed: comparison of two states, with the changed parameters.

    Returns:
        The gains of rate control, and then other gains and filters of the loops if all of them have room. Of more gains
        than the table has rows, those that changed most are in it.
    """
    rate_gains = rate_gains_in_order(reviewed.parameters)
    if not rate_gains or reviewed.are_two_vehicles:
        return []
    if len(rate_gains) > MAX_TABLE_ROWS:
        largest_changes = changed_rate_gains(reviewed.parameters, ())[:MAX_TABLE_ROWS]
        return rate_gains_in_order(largest_changes)
    other_gains = []
    for parameter in reviewed.parameters:
        is_of_loop = AXIS_RATE_LOOP_PARAMETERS.match(parameter.name) or ATTITUDE_GAIN.match(
            parameter.name
        )
        if is_of_loop and not RATE_PID_GAINS.match(parameter.name):
            other_gains.append(parameter)
    if len(rate_gains) + len(other_gains) > MAX_TABLE_ROWS:
        return rate_gains
    return [*rate_gains, *other_gains]


def further_parameters(reviewed: ReviewedDifference) -> list[ParameterChange]:
    """Returns the changed parameters that can change how the vehicle flies and that the table of gains does not have.

    Args:
        reviewed: comparison of two states, with the changed parameters.
    """
    stated = tabled_gains(reviewed) or changed_rate_gains(reviewed.parameters, ())
    parameters = []
    for parameter in reviewed.parameters:
        if parameter not in stated and not FLIGHT_INDEPENDENT_PARAMETERS.match(parameter.name):
            parameters.append(parameter)
    return parameters


def gain_table(reviewed: ReviewedDifference) -> list[Table]:
    """Returns the table of the gains that changed, with both values and the change in percent; empty without any.

    Args:
        reviewed: comparison of two states, with the changed parameters.
    """
    rows = []
    for gain in tabled_gains(reviewed):
        rows.append([gain.name, *parameter_value_texts(gain), percentage_text(gain)])
    return [Table(["gain", *STATE_NAMES, "change"], rows)] if rows else []


def gain_phrase(gains: Sequence[ParameterChange]) -> str:
    """Returns which gains of rate control changed, such as "roll and pitch P, I and D −50 %" or "P and D of roll".

    Args:
        gains: the changed gains, in the order of :func:`rate_gains_in_order`; may be empty.

    Returns:
        The phrase, in percent where these are few. From or to 0 there is no percentage, and both values stand there.
    """
    changes_by_axis = {}
    for axis, gains_of_axis in group_by(gains, _axis).items():
        changes_by_axis[axis] = _terms_by_change(gains_of_axis)
    axes_by_changes = group_by(changes_by_axis, lambda axis: changes_by_axis[axis])
    if sum(map(len, axes_by_changes)) > MAX_CHANGES_IN_PHRASE:
        axes_by_terms = group_by(
            changes_by_axis, lambda axis: tuple(map(_term, _gains_of_axis(gains, axis)))
        )
        return listed(f"{listed(terms)} of {listed(axes)}" for terms, axes in axes_by_terms.items())
    texts = []
    for changes, axes in axes_by_changes.items():
        texts.append(f"{listed(axes)} {listed(changes)}")
    return "; ".join(texts)


def _terms_by_change(gains: Sequence[ParameterChange]) -> tuple[str, ...]:
    """Returns the terms of an axis with their changes, such as "P and I −50 %" and "D −30 %".

    Args:
        gains: the changed gains of one axis.
    """

    def change_of_gain(gain: ParameterChange) -> str:
        """Returns the change in percent, or both values."""
        return percentage_text(gain) or " → ".join(parameter_value_texts(gain))

    texts = []
    for change, gains_of_change in group_by(gains, change_of_gain).items():
        texts.append(f"{listed(map(_term, gains_of_change))} {change}")
    return tuple(texts)


def _gains_of_axis(gains: Sequence[ParameterChange], axis: str) -> list[ParameterChange]:
    """Returns those gains that are of one axis, such as "roll"."""
    return [gain for gain in gains if _axis(gain) == axis]


def _axis(gain: ParameterChange) -> str:
    """Returns the axis of a gain of rate control, such as "roll"."""
    (axis,) = axes_of_parameter(gain.name)
    return axis


def _term(gain: ParameterChange) -> str:
    """Returns the term of a gain of rate control, with which its name ends: "P" of "ATC_RAT_RLL_P"."""
    return gain.name[-1]


def _axis_and_term(gain: ParameterChange) -> tuple[int, int]:
    """Returns the key that sorts gains of rate control by axis, and on each axis in the order P, I, D."""
    return AXES.index(_axis(gain)), "KPID".index(_term(gain))
