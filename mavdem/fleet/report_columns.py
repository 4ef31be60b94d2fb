"""Columns of a fleet's row that follow from the document ``report.json``: values at a path, and a few computed ones.

The document describes the analysis of one vehicle and axis, as ``mavdem learn`` writes it.
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
    # The wind torque is computed with the motors' control effectiveness ("effect"), and not known without that. The
    # document has a reason in the place of a wind torque that is not larger than its error.
    is_effect_unknown = columns.get("effect_status") in (None, NOT_IDENTIFIABLE)
    reason_for_no_torque = value_at(report, "wind.reason")
    if is_effect_unknown or reason_for_no_torque:
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
        report: figures of one axis of a log, as in the document ``report.json``.
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
    """Returns the columns on the inputs of the model: "inputs", "input_unit", and perhaps "motors", their names.

    Inputs are the motor outputs or the controller's demand before the mixer.

    Args:
        report: figures of one axis of a log, as in the document ``report.json``.
        columns: columns of the row so far, perhaps with the names of the motors, which are then not returned again.
    """
    if not _has_model(report):
        # The trim, the mean outputs in steady flight, needs no model. It shows whether motor outputs were logged.
        trim_unit = columns.get("trim_unit")
        if trim_unit is None:
            return {"inputs": None, "input_unit": None}
        return {"inputs": MOTORS, "input_unit": trim_unit}
    input_unit = value_at(report, "flight.scale.unit")
    if value_at(report, "flight.scale.name") == DEMAND:
        return {"inputs": DEMAND, "input_unit": input_unit}
    input_columns = {"inputs": MOTORS, "input_unit": input_unit}
    if "motors" not in columns:
        input_columns["motors"] = report["inputs"]
    return input_columns


def _warning_columns(report: Mapping[str, Any]) -> JsonValues:
    """Returns the columns with the warnings about a flight: first reasons to doubt all its figures, then cautions.

    Args:
        report: the document ``report.json`` before it is written, so that facts (coded findings) in it are not yet
            sentences. Under the key "overrides" it has the facts that make all figures of the flight doubtful, such as
            an oscillation.

    Returns:
        ``overrides``, the codes of these facts; ``warnings``, all warnings as facts; and ``warning_codes``.
    """
    overrides = report.get("overrides", ())
    path_of_cautions = "cautions"
    if not _has_model(report):
        # The key "verdict" has the learnability of the log, with cautions of its own.
        path_of_cautions = "verdict.cautions"
    cautions = value_at(report, path_of_cautions) or ()
    warnings = [*overrides, *cautions]
    return {
        "overrides": [override.code for override in overrides],
        "warnings": warnings,
        "warning_codes": [warning.code for warning in warnings],
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
        if isinstance(value, Mapping):
            value = value.get(key)
        else:
            value = getattr(value, key, None)
    is_array = hasattr(value, "tolist")
    if is_array:
        return value.tolist()
    return value
