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
from mavdem.ingest.telemetry import (
    Columns,
    Parameters,
    Tables,
    concatenated_columns,
    selected_rows,
)

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
    """Returns the names of all messages of cores, also of old versions of ArduPilot."""
    names = []
    for prefix in FILTERS.values():
        for number in CORE_MESSAGES:
            for core in range(MAX_OLD_CORES):
                names.append(f"{prefix}{number + OLD_CORE_STEP * core}")
    return tuple(names)


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
        """Returns the names of messages of several filters, those of the filter that flies first."""
        names_of_preferred_filter = [name for name in names if self._is_of_preferred_filter(name)]
        return names_of_preferred_filter + [
            name for name in names if name not in names_of_preferred_filter
        ]

    def _is_of_preferred_filter(self, name: str) -> bool:
        """Returns whether a message is of the filter that flies by the parameter."""
        return bool(self.preferred_filter) and name.startswith(self.preferred_filter)


def flown_estimates(tables: Tables, parameters: Parameters) -> FlownEstimates:
    """Selects, at each time, the messages of the estimator core whose estimates the autopilot used.

    ArduPilot runs several instances (cores) of its Kalman filter, one per IMU, and uses those of the primary core. If
    the log has no row of the primary core, the core with most rows replaces it.

    Args:
        tables: DataFlash's messages by name, with ``time`` and ``boot``.
        parameters: The autopilot's parameters by name.

    Returns:
        All messages, those of filters (EKF) only of the core that flew; and separately the messages of all cores.
    """
    flown_messages: dict[str, Columns] = dict(tables)
    all_cores: dict[str, Columns] = {}
    primary_cores: dict[str, NDArray[np.integer]] = {}
    names: dict[str, str] = {}
    for prefix in FILTERS.values():
        status = _with_cores(tables, f"{prefix}{STATUS_MESSAGE}")
        for number in CORE_MESSAGES:
            name = f"{prefix}{number}"
            logged_columns = _with_cores(tables, name)
            if not message_count(logged_columns):
                continue
            primary = _primary_cores(logged_columns, status)
            core = logged_columns["C"].astype(np.int64)
            is_flown = core == primary
            if not is_flown.any():
                cores, counts = np.unique(core, return_counts=True)
                most_logged_core = int(cores[counts.argmax()])
                is_flown = core == most_logged_core
                names[name] = f"{name}[{most_logged_core}]"
            flown_messages[name] = selected_rows(logged_columns, is_flown)
            all_cores[name] = logged_columns
            primary_cores[name] = primary
    return FlownEstimates(
        flown_messages,
        all_cores,
        primary_cores,
        names,
        FILTERS.get(int(parameters.get(FILTER_PARAMETER, 0)), ""),
    )


def _with_cores(tables: Tables, name: str) -> Columns:
    """Returns the messages of all cores with the number of each as ``C``.

    Args:
        tables: DataFlash's messages by name.
        name: Name of the first core's message.

    Returns:
        The messages; empty if there are none.
    """
    logged_columns = tables.get(name, {})
    if "C" in logged_columns:
        return logged_columns
    # In old versions each core has a separate message, whose name ends with a higher number: EKF1, EKF6 and so on.
    prefix, number = name[:-1], int(name[-1])
    parts = []
    for core in range(MAX_OLD_CORES):
        columns = tables.get(f"{prefix}{number + OLD_CORE_STEP * core}", {})
        count = message_count(columns)
        if count:
            parts.append({**columns, "C": np.full(count, core)})
    if not parts:
        return {}
    cores = concatenated_columns(parts)
    return selected_rows(cores, np.argsort(continuous_time(cores), kind="stable"))


def _primary_cores(logged_columns: Columns, status: Columns) -> Integers:
    """Returns the primary core at each row of a message: the last one that the status named.

    Args:
        logged_columns: The message (N rows).
        status: The message with the primary core (``PI``), of all cores. If it has none, core 0 is primary.

    Returns:
        Numbers of the cores (N,).
    """
    count = message_count(logged_columns)
    named = status.get("PI", np.zeros(0))
    is_named = named >= 0
    if not is_named.any():
        return np.zeros(count, np.int64)
    time = continuous_time(status)[is_named]
    order = np.argsort(time, kind="stable")
    status_rows = np.searchsorted(time[order], continuous_time(logged_columns), side="right") - 1
    # Before the first status, the core is taken from that status.
    status_rows = np.maximum(status_rows, 0)
    return named[is_named][order][status_rows].astype(np.int64)
