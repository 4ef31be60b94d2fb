"""Titles of the columns of tables that compare two states of a vehicle."""

from mavdem.report.numbers import counted


def side_title(side: str, flight_count: int) -> str:
    """Returns the title of a column with means or counts over all flights of a state, such as "B, 9 flights".

    Args:
        side: name of the state, "A" or "B".
        flight_count: number of its flights. For a single one the title is the name of the state alone.
    """
    return side if flight_count == 1 else f"{side}, {counted(flight_count, 'flight')}"


def last_flight_title(side: str, flight_count: int) -> str:
    """Returns the title of a column about the last flight of a state, such as "B, last of 9 flights".

    Args:
        side: name of the state, "A" or "B".
        flight_count: number of its flights. For a single one the title is the name of the state alone.
    """
    return side if flight_count == 1 else f"{side}, last of {counted(flight_count, 'flight')}"
