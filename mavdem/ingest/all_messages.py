"""All messages of a log under the names of the log, so that any field can be plotted."""

from dataclasses import replace

import numpy as np

from mavdem.files import PathName
from mavdem.ingest.formats import detect_format
from mavdem.ingest.telemetry import Fields, Tables, Telemetry, concatenated_columns, selected_rows
from mavdem.log_formats import Format

INSTANCE = "instance"
"""Column with the instance of the topic to which a message belongs; MAVLink's definitions use the same name."""


# Damaged files hold numbers that overflow or are NaN, which plots leave out.
@np.errstate(all="ignore")
def with_all_messages(telemetry: Telemetry, path: PathName) -> Telemetry:
    """Returns a vehicle with all messages of its log, and all their fields.

    Of DataFlash and ULog, ``read_log`` translates to MAVLink only what mavdem uses. These logs are read again here, and
    keep the names and units of the log. Other formats were read completely before.

    Args:
        telemetry: the vehicle, as ``read_log`` returns it.
        path: path of its log, or of an archive of it.

    Returns:
        A copy of the vehicle with all messages; the vehicle itself where it has them already.
    """
    _, log_format = detect_format(path)
    if log_format is Format.DATAFLASH:
        from mavdem.ingest.dataflash.log import all_tables

        return replace(telemetry, messages=all_tables(path), source_names={})
    if log_format is Format.ULOG:
        from mavdem.ingest.ulog import all_topics

        return replace(telemetry, messages=_joined_instances(all_topics(path)), source_names={})
    return telemetry


def _joined_instances(topics: dict[str, dict[int, Fields]]) -> Tables:
    """Makes one table of each topic, with the rows of all its instances in the order of time.

    Args:
        topics: Columns with ``time`` by topic and by number of the instance.

    Returns:
        Columns by topic, with ``boot``, which is 0, and with the number of the instance if a topic has several.
    """
    tables = {}
    for name, columns_by_instance in topics.items():
        tables_of_instances = []
        for number, columns in columns_by_instance.items():
            count = len(columns["time"])
            table = columns | {"boot": np.zeros(count, np.int64)}
            if len(columns_by_instance) > 1:
                table[INSTANCE] = np.full(count, number)
            tables_of_instances.append(table)
        joined_columns = concatenated_columns(tables_of_instances)
        tables[name] = selected_rows(
            joined_columns, np.argsort(joined_columns["time"], kind="stable")
        )
    return tables
