"""State estimators in DataFlash logs: which Kalman filter and which of its cores was used, and their messages.

ArduPilot has had three filters (EKF1, NKF1 and XKF1 are their first messages). The second and the third run one core
per IMU, of which one is primary: its states fly the vehicle. Each core is an instance of the messages or, in old
versions, has messages of its own: XKF6 is XKF1 of core 1, XKF11 that of core 2.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Integers
from mavdem.ingest.dataflash.tables import continuous_time, message_count
from mavdem.ingest.telemetry import Columns, Parameters, Tables, concatenated_columns, selected_rows

FILTERS = {3: "XKF", 2: "NKF", 1: "EKF"}
"""Beginning of the names of each filter's messages, by the value of AHRS_EKF_TYPE; the latest filter first."""

FILTER_PARAMETER = "AHRS_EKF_TYPE"
"""Parameter with the filter that flies."""

CORE_MESSAGES = (1, 2, 4)
"""Numbers of the messages of a filter that are read: motion, wind and biases, and test ratios with its status."""

OLD_CORE_STEP = 5
"""Step in the number of a message from one core to the next in old versions: XKF1, XKF6, XKF11."""

MAX_OLD_CORES = 3
"""Number of cores that have messages of their own in old versions."""

STATUS_MESSAGE = 4
"""Number of the message with the primary core (``PI``)."""


def core_message_names() -> tuple[str, ...]:
    """Returns the names of the messages of all filters and cores that may be in a log.

    In new versions of ArduPilot all cores share a message, such as XKF1. In old versions each core has a message of its
    own, whose number is ``OLD_CORE_STEP`` higher than for the core before: XKF1, XKF6, XKF11.
    """
    names = []
    for prefix in FILTERS.values():
        for number in CORE_MESSAGES:
            for core in range(MAX_OLD_CORES):
                names.append(_message_of_core(prefix, number, core))
    return tuple(names)


def _message_of_core(prefix: str, number: int, core: int) -> str:
    """Returns the name that a message of a core has in old versions of ArduPilot, such as XKF6 for XKF1 of core 1.

    Args:
        prefix: Beginning of the names of the filter's messages ("XKF").
        number: Number of the message of core 0.
        core: Number of the core, from 0.
    """
    return f"{prefix}{number + OLD_CORE_STEP * core}"


class FlownEstimates(NamedTuple):
    """The messages of a log, in which those of the filters are of the core that flew."""

    tables: Tables
    """All messages by name."""
    all_cores: Tables
    """Messages of the filters by name ("XKF4"), with rows of all cores and their number as ``C``."""
    primary_cores: Mapping[str, NDArray[np.integer]]
    """For messages of the filters that have a primary core: its number at each row of ``all_cores``, by name."""
    names: Mapping[str, str]
    """Name of a message with the number of its core ("XKF1[1]"), where only another than the primary was logged."""
    preferred_filter: str
    """Beginning of the names of the messages of the filter that flies by the parameter; empty where that is unknown."""

    def preferred_names(self, names: Sequence[str]) -> list[str]:
        """Returns the names of messages of several filters, those of the filter in use first."""
        preferred_names = []
        other_names = []
        for name in names:
            if self._is_of_preferred_filter(name):
                preferred_names.append(name)
            else:
                other_names.append(name)
        return preferred_names + other_names

    def _is_of_preferred_filter(self, name: str) -> bool:
        """Returns whether a message is of the filter that flies by the parameter."""
        return bool(self.preferred_filter) and name.startswith(self.preferred_filter)


def flown_estimates(tables: Tables, parameters: Parameters) -> FlownEstimates:
    """Selects, at each time, the messages of the estimator core whose estimates the autopilot used to fly.

    ArduPilot runs several instances (cores) of its Kalman filter, one per IMU, and uses the estimates of the primary
    core. If the log has no row of the primary core, the core with most rows replaces it.

    Args:
        tables: DataFlash's messages by name, with ``time`` and ``boot``.
        parameters: The autopilot's parameters by name.

    Returns:
        All messages, of filters (EKF) only of the core that was used; and separately the messages of all cores.
    """
    used_messages: dict[str, Columns] = dict(tables)
    all_cores: dict[str, Columns] = {}
    primary_cores: dict[str, NDArray[np.integer]] = {}
    names_with_core: dict[str, str] = {}
    for prefix in FILTERS.values():
        status = _with_cores(tables, f"{prefix}{STATUS_MESSAGE}")
        for number in CORE_MESSAGES:
            name = f"{prefix}{number}"
            logged_columns = _with_cores(tables, name)
            if not message_count(logged_columns):
                continue
            primary_core_of_rows = _primary_cores(logged_columns, status)
            core_of_rows = logged_columns["C"].astype(np.int64)
            is_used = core_of_rows == primary_core_of_rows
            if not is_used.any():
                cores, row_counts = np.unique(core_of_rows, return_counts=True)
                most_logged_core = int(cores[row_counts.argmax()])
                is_used = core_of_rows == most_logged_core
                names_with_core[name] = f"{name}[{most_logged_core}]"
            used_messages[name] = selected_rows(logged_columns, is_used)
            all_cores[name] = logged_columns
            primary_cores[name] = primary_core_of_rows
    filter_number = int(parameters.get(FILTER_PARAMETER, 0))
    return FlownEstimates(
        tables=used_messages,
        all_cores=all_cores,
        primary_cores=primary_cores,
        names=names_with_core,
        preferred_filter=FILTERS.get(filter_number, ""),
    )


def _with_cores(tables: Tables, name: str) -> Columns:
    """Returns one message of a Kalman filter, such as XKF1, with the rows of all instances (cores) of the filter.

    New versions of ArduPilot log the rows of all cores under one name, with the number of the core in the column ``C``.
    Old versions log each core under a name of its own; these tables are merged, and the column is added.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        name: Name of the first core's message, such as "XKF1".

    Returns:
        The rows in the order of time, with the column ``C``; empty if there are none.
    """
    logged_columns = tables.get(name, {})
    if "C" in logged_columns:
        return logged_columns
    prefix, message_number = name[:-1], int(name[-1])
    tables_of_cores = []
    for core in range(MAX_OLD_CORES):
        columns = tables.get(_message_of_core(prefix, message_number, core), {})
        row_count = message_count(columns)
        if row_count:
            tables_of_cores.append({**columns, "C": np.full(row_count, core)})
    if not tables_of_cores:
        return {}
    all_rows = concatenated_columns(tables_of_cores)
    time_order = np.argsort(continuous_time(all_rows), kind="stable")
    return selected_rows(all_rows, time_order)


def _primary_cores(logged_columns: Columns, status: Columns) -> Integers:
    """Returns the primary core at each row of a message: the last one that the status named.

    Args:
        logged_columns: The message (N rows).
        status: The message with the primary core (``PI``), of all cores. If it has none, core 0 is primary.

    Returns:
        Numbers of the cores (N,).
    """
    count = message_count(logged_columns)
    core_of_status = status.get("PI", np.zeros(0))
    is_named = core_of_status >= 0
    if not is_named.any():
        return np.zeros(count, np.int64)
    time = continuous_time(status)[is_named]
    order = np.argsort(time, kind="stable")
    status_rows = np.searchsorted(time[order], continuous_time(logged_columns), side="right") - 1
    # Before the first status, the core is taken from that status.
    status_rows = np.maximum(status_rows, 0)
    return core_of_status[is_named][order][status_rows].astype(np.int64)
