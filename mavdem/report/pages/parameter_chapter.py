"""The chapter of a flight's page on the autopilot's parameters: changed in flight, of its control, and all."""

import re
from collections.abc import Mapping
from functools import cache

from mavdem.facts import Level
from mavdem.files import load_adjacent_toml
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS
from mavdem.report.blocks import Blocks, Linked, Rated, Table
from mavdem.report.numbers import number_with_unit, parameter_value_text
from mavdem.report.pages.page import Chapter
from mavdem.report.templates import render_section

AXIS_IN_PARAMETER = re.compile(r"RLL|ROLL|PITCH|PIT|YAW")
"""The part of a parameter's name that says its axis, in ArduPilot and PX4; its first letter names the axis."""

GEOMETRY_PREFIX = "CA_"
"""Beginning of PX4's parameters of the motors' positions, which the drawing of the motors shows already."""

AXIS_COLUMNS = {"R": "roll", "P": "pitch", "Y": "yaw"}
"""Columns of the table of parameters of axes, by the first letter of the axis in a parameter's name."""

PARAMETER_REFERENCES = {
    "PX4": "https://docs.px4.io/main/en/advanced_config/parameter_reference",
    "ARDUPILOTMEGA": "https://ardupilot.org/copter/docs/parameters.html",
}
"""Page of an autopilot's makers that describes every parameter, by the autopilot's name."""

MEANINGS = {
    re.compile(pattern): meaning
    for pattern, meaning in load_adjacent_toml(__file__, "../parameter_meanings.toml").items()
}
"""What parameters set, by a pattern of their whole name; the first that fits counts."""


UNIT_OF_MEANING = re.compile(r" \(([^()\d][^()]*)\)$")
"""The unit of a parameter, in brackets at the end of what it sets, and the space before it.

A unit that begins with a digit, such as "1/s", would look like a second number beside the value.
"""


def meaning_of(name: str) -> str:
    """Returns what a parameter sets, in a few words; empty if ``parameter_meanings.toml`` lacks it."""
    return UNIT_OF_MEANING.sub("", _meaning_with_unit(name))


def value_with_unit(name: str, value: float) -> str:
    """Returns the value of a parameter as text, with its unit if ``parameter_meanings.toml`` has one: "10 s"."""
    text = parameter_value_text(value)
    unit = UNIT_OF_MEANING.search(_meaning_with_unit(name))
    return text if unit is None else number_with_unit(text, unit[1])


@cache
def _meaning_with_unit(name: str) -> str:
    """Returns what a parameter sets as ``parameter_meanings.toml`` has it, with the unit in brackets at its end."""
    for pattern, meaning in MEANINGS.items():
        if pattern.fullmatch(name):
            return meaning
    return ""


def reference_address(autopilot: str, parameter: str) -> str:
    """Returns the web address where an autopilot's makers describe a parameter.

    Args:
        autopilot: name of the autopilot, such as "PX4".
        parameter: name of the parameter.

    Returns:
        The address of the reference of all parameters, with the anchor of this one; empty for an unknown autopilot.
    """
    page = PARAMETER_REFERENCES.get(autopilot)
    if page is None:
        return ""
    if autopilot == "PX4":
        return f"{page}#{parameter}"
    # ArduPilot's page, made by Sphinx, has its anchors in small letters and with hyphens.
    anchor = parameter.lower().replace("_", "-")
    return f"{page}#{anchor}"


def parameters_chapter(telemetry: Telemetry, *, is_full: bool) -> Chapter:
    """Returns the chapter on the autopilot's parameters, as tables of these groups and a list of all parameters.

    The groups are the parameters that were changed in the flight, those of rate and attitude control, and those that
    differ from their default. Changes that the autopilot makes by itself, such as counters and learned offsets, are
    only marked in the list of all parameters.

    Args:
        telemetry: telemetry of the vehicle, with the parameters at the beginning and at the end of the log.
        is_full: whether all parameters are listed, and whether a further table links parameters that differ from the
            default to their description.

    Returns:
        The chapter; all parameters are in a table that readers can search.
    """
    blocks: Blocks = []
    changes = []
    # The initial values are those of the parameters that changed during the log.
    for name, initial_value in sorted(telemetry.initial_parameters.items()):
        if not AUTOPILOT_SET_PARAMETERS.search(name):
            last_value = telemetry.parameters[name]
            row = [name, value_with_unit(name, initial_value), value_with_unit(name, last_value)]
            changes.append(row)
    if changes:
        blocks.append(Table(["changed in flight", "from", "to"], changes))
    blocks += _control_parameter_tables(telemetry)
    if not is_full:
        return Chapter("Parameters", blocks)
    blocks += _changed_defaults(telemetry)
    searchable = _all_parameters(telemetry) if telemetry.parameters else None
    return Chapter("Parameters", blocks, searchable=searchable)


def _changed_defaults(telemetry: Telemetry) -> Blocks:
    """Returns a sentence on how many parameters differ from the autopilot's defaults, and a table of these.

    Parameters that the autopilot sets by itself, such as calibrations, are not counted.

    Args:
        telemetry: telemetry of the vehicle, with the parameters and their defaults.

    Returns:
        The sentence and the table; empty if no parameter differs.
    """
    changed_names = [
        name for name in telemetry.changed_defaults if not AUTOPILOT_SET_PARAMETERS.search(name)
    ]
    if not changed_names:
        return []
    blocks: Blocks = [
        *render_section(
            "parameter_defaults", count=len(changed_names), total=len(telemetry.parameters)
        )
    ]
    rows = _changed_default_rows(telemetry)
    if rows:
        header = ["not the default", "value", "default", "about"]
        blocks.append(Table(header, rows, words=True))
    return blocks


def _changed_default_rows(telemetry: Telemetry) -> list[list[str]]:
    """Returns the rows of the table of parameters that differ from the firmware's default.

    Parameters that the autopilot sets by itself, such as calibrations, are left out.

    Args:
        telemetry: messages of the vehicle as columns, and its parameters.

    Returns:
        Rows of name, with a link to its description, value, default and meaning, empty if that is not known here.
    """
    rows: list[list[str]] = []
    for name, default in sorted(telemetry.changed_defaults.items()):
        if not AUTOPILOT_SET_PARAMETERS.search(name):
            linked_name = _linked_name(telemetry, name)
            value = value_with_unit(name, telemetry.parameters[name])
            rows.append([linked_name, value, value_with_unit(name, default), meaning_of(name)])
    return rows


def _all_parameters(telemetry: Telemetry) -> Table:
    """Returns all parameters with their values at the end of the log, and their meanings.

    Parameters that changed in flight are marked. So are parameters that differ from the default, if the log has
    defaults.

    Args:
        telemetry: messages of the vehicle, with its parameters.
    """
    rows: list[list[str]] = []
    defaults = telemetry.changed_defaults
    for name, value in sorted(telemetry.parameters.items()):
        has_changed_in_flight = name in telemetry.initial_parameters
        # ``changed_defaults`` has the defaults of those parameters only that differ from them.
        differs_from_default = name in defaults and not AUTOPILOT_SET_PARAMETERS.search(name)
        remarks = []
        if has_changed_in_flight:
            remarks.append(
                f"changed in flight, from {parameter_value_text(telemetry.initial_parameters[name])}"
            )
        if differs_from_default:
            remarks.append(f"not the default, {parameter_value_text(defaults[name])}")
        remark = "; ".join(remarks)
        if has_changed_in_flight:
            remark = Rated(remark, Level.WATCH)
        rows.append([name, value_with_unit(name, value), remark, meaning_of(name)])
    header = ["parameter", "value", "remark", "about"]
    return Table(header, rows, words=True, is_printed=False)


def _control_parameter_tables(telemetry: Telemetry) -> Blocks:
    """Returns tables of the autopilot's control parameters, such as its gains: those of axes, and those of no axis.

    Parameters that are 0 are left out: 0 mostly switches off what a parameter sets.

    Args:
        telemetry: messages of the vehicle as columns, and its parameters.
    """
    names_of_axes = dict[str, dict[str, str]]()
    rows_of_no_axis: list[list[str]] = []
    for name, value in sorted(telemetry.parameters.items()):
        is_control = CONTROL_PARAMETERS.match(name) and not name.startswith(GEOMETRY_PREFIX)
        if not value or not is_control:
            continue
        axis_in_name = AXIS_IN_PARAMETER.search(name)
        if axis_in_name is None:
            rows_of_no_axis.append([_linked_name(telemetry, name), value_with_unit(name, value)])
        else:
            # For ATC_RAT_RLL_P the name for all axes is "ATC_RAT_…_P", and "R" is the column of roll.
            name_for_all_axes = AXIS_IN_PARAMETER.sub("…", name, count=1)
            column = axis_in_name[0][0]
            names_of_axes.setdefault(name_for_all_axes, {})[column] = name
    blocks: Blocks = []
    if names_of_axes:
        rows = [_row_of_axes(telemetry, names) for names in names_of_axes.values()]
        blocks.append(Table(["parameter (of its first axis)", *AXIS_COLUMNS.values()], rows))
    if rows_of_no_axis:
        blocks.append(Table(["parameter", "value"], rows_of_no_axis))
    return blocks


def _row_of_axes(telemetry: Telemetry, name_by_column: Mapping[str, str]) -> list[str]:
    """Returns the row of parameters that differ only in their axis, such as the P gains of roll, pitch and yaw.

    Args:
        telemetry: the vehicle, with its parameters.
        name_by_column: name of the parameter of each axis, by the keys of ``AXIS_COLUMNS``; at least one.

    Returns:
        The whole name of the parameter of the first axis, which can be searched for, and the value for each axis. A
        cell is empty where the axis has no such parameter.
    """
    columns_with_value = [column for column in AXIS_COLUMNS if column in name_by_column]
    first_name = name_by_column[columns_with_value[0]]
    row: list[str] = [_linked_name(telemetry, first_name)]
    for column in AXIS_COLUMNS:
        if column in name_by_column:
            name = name_by_column[column]
            row.append(value_with_unit(name, telemetry.parameters[name]))
        else:
            row.append("")
    return row


def _linked_name(telemetry: Telemetry, name: str) -> Linked:
    """Returns the name of a parameter with a link to its description by the makers of the autopilot."""
    return Linked(name, reference_address(telemetry.autopilot, name))
