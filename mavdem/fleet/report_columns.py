"""Columns of a fleet's row that follow from the document ``report.json``: values at a path, and a few computed ones.

The document is that of the analysis of one vehicle and axis, as ``mavdem learn`` writes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import Field, field
from typing import Any

from mavdem.containers import JsonValues
from mavdem.dataset.motor_outputs import INPUT_KINDS
from mavdem.facts.identifiability import Status

NOT_IDENTIFIABLE = Status.NOT_IDENTIFIABLE
"""Status of a physical parameter that the flight does not determine."""

MOTORS, DEMAND = INPUT_KINDS

REPORT_PATH = "report_path"
"""Key of a column's metadata: where the document ``report.json`` has its value."""


def report_column(path: str, default: str | None = None) -> Any:
    """Defines a column of a row, a field of its dataclass, that is copied from the document ``report.json``.

    Args:
        path: dotted path of the value in the document, such as "identity.firmware".
        default: value of the column where the document has none.

    Returns:
        A dataclass field with the path in its metadata.
    """
    return field(default=default, metadata={REPORT_PATH: path})


def columns_of_report(
    report: Mapping[str, Any], columns_of_row: Iterable[Field[Any]]
) -> JsonValues:
    """Returns the columns of a row that follow from the report of an analysis, the content of ``report.json``.

    Most columns are values of the document at the path in their metadata. The wind torque, the inputs and the warnings
    depend on several values.

    Args:
        report: the document; with the key "flight" if a model was learned.
        columns_of_row: the fields of the row's dataclass.

    Returns:
        Values by name of the column; a column that is not known is missing or None.
    """
    columns = _columns_at_paths(report, columns_of_row)
    # The wind torque is computed with the motors' effect. If that is not identifiable, or the wind was not resolved,
    # the wind torque is not known.
    is_effect_unknown = columns.get("effect_status") in (None, NOT_IDENTIFIABLE)
    if value_at(report, "wind.reason") or is_effect_unknown:
        for name in list(columns):
            if name.startswith("wind_torque"):
                del columns[name]
    return columns | _input_columns(report, columns) | _warning_columns(report)


def _columns_at_paths(
    report: Mapping[str, Any], columns_of_row: Iterable[Field[Any]]
) -> JsonValues:
    """Copies those columns of a row that are single values of the document ``report.json``.

    The metadata of such a column have the dotted path of its value (:func:`report_column`). Other columns are computed,
    and have no path.

    Args:
        report: the document ``report.json``.
        columns_of_row: the fields of the row's dataclass.

    Returns:
        Values by name of the column, without those that are missing or empty in the document.
    """
    columns = {}
    for column in columns_of_row:
        path = column.metadata.get(REPORT_PATH)
        if path is None:
            continue
        value = value_at(report, path)
        if value not in (None, "", [], ()):
            columns[column.name] = value
    return columns


def _has_model(report: Mapping[str, Any]) -> bool:
    """Returns whether a model was learned from the log: only then the document has the key "flight"."""
    return "flight" in report


def _input_columns(report: Mapping[str, Any], columns: JsonValues) -> JsonValues:
    """Returns the columns on the inputs of the model: whether they are motors or demand, their unit, and their names.

    If no model was learned, the motors count as inputs, in the unit of their trim; without a trim there are none.

    Args:
        report: the document ``report.json``.
        columns: columns of the row so far. If these have the names of the motors already, no others are returned.

    Returns:
        "inputs" and "input_unit", and "motors" where the names follow from the inputs of the model.
    """
    if not _has_model(report):
        trim_unit = columns.get("trim_unit")
        return {"inputs": None if trim_unit is None else MOTORS, "input_unit": trim_unit}
    input_columns = {"inputs": MOTORS, "input_unit": value_at(report, "flight.scale.unit")}
    if value_at(report, "flight.scale.name") == DEMAND:
        input_columns["inputs"] = DEMAND
    elif "motors" not in columns:
        # The inputs of this model are the motors.
        input_columns["motors"] = report["inputs"]
    return input_columns


def _warning_columns(report: Mapping[str, Any]) -> JsonValues:
    """Returns the columns with the doubts about a flight, as sentences and as codes.

    Facts that make the figures of the flight invalid ("overrides"), such as an oscillation, come first. Then follow the
    cautions about the model or, without a model, those about the log.

    Args:
        report: the document ``report.json``, in which facts are still objects.

    Returns:
        ``overrides``, ``warnings`` and ``warning_codes``.
    """
    overrides = report.get("overrides", ())
    path_of_cautions = "cautions" if _has_model(report) else "verdict.cautions"
    cautions = value_at(report, path_of_cautions) or ()
    warnings = [*overrides, *cautions]
    return {
        "overrides": [override.code for override in overrides],
        "warnings": warnings,
        "warning_codes": [fact.code for fact in warnings],
    }


def value_at(report: Mapping[str, Any], path: str) -> Any:
    """Returns the value at a dotted path of a document, such as "condition.hover.trim".

    Args:
        report: the document. Its parts may be mappings by key, or objects whose attributes are the keys.
        path: keys from the outermost to the innermost.

    Returns:
        The value, arrays as lists; None if a key of the path is missing.
    """
    value: Any = report
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else getattr(value, key, None)
    return value.tolist() if hasattr(value, "tolist") else value
