"""Titles of the columns of tables that compare two states of a vehicle."""

from mavdem.report.numbers import counted


def side_title(side: str, log_count: int) -> str:
    """Returns the title of a column with means or counts over all logs of a state, such as "B, 9 logs".

    Args:
        side: name of the state, "A" or "B".
        log_count: number of its logs. For a single one the title is the name of the state alone.
    """
    return side if log_count == 1 else f"{side}, {counted(log_count, 'log')}"


def last_log_title(side: str, log_count: int) -> str:
    """Returns the title of a column about the last log of a state, such as "B, last of 9 logs".

    Args:
        side: name of the state, "A" or "B".
        log_count: number of its logs. For a single one the title is the name of the state alone.
    """
    return side if log_count == 1 else f"{side}, last of {counted(log_count, 'log')}"
