"""Rows of a table of changed parameters; those of several outputs that changed alike share one."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from mavdem.containers import group_by
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.report.numbers import parameter_value_text

NUMBERED_NAME = re.compile(r"(?P<start>.*?)(?P<number>\d+)(?P<end>\D*)")
"""Name of a parameter with a number in it, the last one if there are several, such as "SERVO12_MIN"."""


class _SharedRow(NamedTuple):
    """What parameters have in common that share a row, since only the number in their name differs."""

    start: str
    """Name up to the number; the whole name of a parameter without one."""

    end: str
    """Name after the number."""

    before: str
    """Value in A."""

    after: str
    """Value in B."""


def parameter_rows(parameters: Sequence[ParameterChange]) -> list[list[str]]:
    """Returns the rows of a table of changed parameters: the name, the value in A and that in B.

    Parameters that changed alike and whose names differ by consecutive numbers have one row, such as "SERVO1–4_MIN".

    Args:
        parameters: the changed parameters; a row stands in the place of its first parameter.
    """
    rows = []
    for shared, members in group_by(parameters, _shared_row).items():
        for name in _names_of_runs(shared, members):
            rows.append([name, shared.before, shared.after])
    return rows


def _shared_row(parameter: ParameterChange) -> _SharedRow:
    """Returns what a parameter has in common with others of its row."""
    numbered = NUMBERED_NAME.fullmatch(parameter.name)
    start, end = (parameter.name, "") if numbered is None else numbered.group("start", "end")
    before = parameter_value_text(parameter.before)
    after = parameter_value_text(parameter.after)
    return _SharedRow(start, end, before, after)


def _names_of_runs(shared: _SharedRow, parameters: Sequence[ParameterChange]) -> list[str]:
    """Returns a name for each run of consecutive numbers, such as "SERVO1–4_MIN" and "SERVO9_MIN".

    Args:
        shared: the parts of the name around the number.
        parameters: parameters with these parts and different numbers, or a single one without a number.
    """
    runs: list[list[int]] = []
    for number in sorted(_numbers(shared, parameters)):
        if runs and runs[-1][-1] == number - 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    if not runs:
        return [shared.start]
    names = []
    for run in runs:
        numbers = f"{run[0]}–{run[-1]}" if len(run) > 1 else str(run[0])
        names.append(f"{shared.start}{numbers}{shared.end}")
    return names


def _numbers(shared: _SharedRow, parameters: Sequence[ParameterChange]) -> list[int]:
    """Returns the numbers in the names of parameters with the same start and end; none of a name without a number."""
    numbers = []
    for parameter in parameters:
        number = parameter.name.removeprefix(shared.start).removesuffix(shared.end)
        if number:
            numbers.append(int(number))
    return numbers
