"""Rows of a table of changed parameters; those of several outputs that changed alike share one."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from mavdem.containers import group_by
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.ingest.vocabulary import CODED_PARAMETERS, CONTROL_PARAMETERS, RATE_PID_GAINS
from mavdem.report.numbers import parameter_value_text

NUMBERED_NAME = re.compile(r"(?P<start>.*?)(?P<number>\d+)(?P<end>\D*)")
"""Name of a parameter with a number in it, the last one if there are several, such as "SERVO12_MIN"."""


class _SharedRow(NamedTuple):
    """What parameters of one row have in common: all but the number in their names."""

    start: str
    """Name up to the number; the whole name of a parameter without one."""

    end: str
    """Name after the number."""

    before: str
    """Value in A."""

    after: str
    """Value in B."""

    percentage: str
    """The change in percent; empty for what is no gain or filter, or is a choice or count, and from or to 0."""


def parameter_rows(
    parameters: Sequence[ParameterChange], *, has_percentages: bool = False
) -> list[list[str]]:
    """Returns the rows of a table of changed parameters: the name, the value in A and that in B.

    Parameters that changed alike and whose names differ by consecutive numbers have one row, such as "SERVO1–4_MIN".

    Args:
        parameters: the changed parameters; a row stands in the place of its first parameter.
        has_percentages: whether the rows have a fourth cell, with the change of gains and filters in percent.
    """
    rows = []
    for shared, members in group_by(parameters, _shared_row).items():
        for name in _names_of_runs(shared, members):
            row = [name, shared.before, shared.after]
            if has_percentages:
                row.append(shared.percentage)
            rows.append(row)
    return rows


def percentage_text(parameter: ParameterChange) -> str:
    """Returns the relative change of a parameter, such as "−20 %"; empty if one of its values is 0."""
    if parameter.before == 0 or parameter.after == 0:
        return ""
    percentage = round(100 * (parameter.after / parameter.before - 1))
    return f"{percentage:+d} %".replace("-", "−")


def parameter_text(parameter: ParameterChange) -> str:
    """Returns a changed parameter as text, such as "ATC_RAT_RLL_P 0.135 → 0.108".

    Args:
        parameter: the parameter with both values.
    """
    before, after = parameter_value_texts(parameter)
    return f"{parameter.name} {before} → {after}"


def parameter_value_texts(parameter: ParameterChange) -> tuple[str, str]:
    """Returns both values of a changed parameter as texts, such as "0.135" and "0.108".

    Gains of rate control have three significant digits, unless these are equal before and after the change. Other
    parameters, and such gains, have all digits.

    Args:
        parameter: the parameter with both values.
    """
    rounded_before = f"{parameter.before:.3g}"
    rounded_after = f"{parameter.after:.3g}"
    is_rate_gain = bool(RATE_PID_GAINS.match(parameter.name))
    if is_rate_gain and rounded_before != rounded_after:
        return rounded_before, rounded_after
    return parameter_value_text(parameter.before), parameter_value_text(parameter.after)


def _shared_row(parameter: ParameterChange) -> _SharedRow:
    """Returns what parameters that share a row have in common: their values, and their names without the number.

    For ``SERVO3_MIN`` the parts of the name are "SERVO" and "_MIN".
    """
    numbered_name = NUMBERED_NAME.fullmatch(parameter.name)
    is_of_control = CONTROL_PARAMETERS.match(parameter.name) is not None
    is_amount = CODED_PARAMETERS.match(parameter.name) is None
    return _SharedRow(
        start=parameter.name if numbered_name is None else numbered_name["start"],
        end="" if numbered_name is None else numbered_name["end"],
        before=parameter_value_text(parameter.before),
        after=parameter_value_text(parameter.after),
        percentage=percentage_text(parameter) if is_of_control and is_amount else "",
    )


def _names_of_runs(shared: _SharedRow, parameters: Sequence[ParameterChange]) -> list[str]:
    """Returns a name for each run of consecutive numbers, such as "SERVO1–4_MIN" and "SERVO9_MIN".

    Args:
        shared: the parts of the name around the number.
        parameters: parameters with these parts and different numbers, or a single one without a number.
    """
    numbers = _numbers_in_names(shared, parameters)
    if not numbers:
        return [shared.start]
    names = []
    for run in _consecutive_runs(numbers):
        first, last = run[0], run[-1]
        range_text = str(first) if first == last else f"{first}–{last}"
        names.append(f"{shared.start}{range_text}{shared.end}")
    return names


def _consecutive_runs(numbers: Sequence[int]) -> list[list[int]]:
    """Divides numbers into runs of consecutive ones, in rising order: [1, 2, 3], [9] from 9, 1, 3 and 2."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and runs[-1][-1] == number - 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return runs


def _numbers_in_names(shared: _SharedRow, parameters: Sequence[ParameterChange]) -> list[int]:
    """Returns the numbers in the names of parameters of one row, such as 3 and 4 of SERVO3_MIN and SERVO4_MIN.

    Args:
        shared: start and end of the names, "SERVO" and "_MIN" in the example.
        parameters: parameters whose names have this start and end. A name without a number between them adds none.
    """
    numbers = []
    for parameter in parameters:
        number = parameter.name.removeprefix(shared.start).removesuffix(shared.end)
        if number:
            numbers.append(int(number))
    return numbers
