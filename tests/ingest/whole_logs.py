"""Whole logs to compare: everything a file holds, read as usual or in blocks of a few bytes and messages."""

import tempfile

from mavdem.errors import Unreadable
from mavdem.ingest import read_log


def read(content):
    """The log; None where it is refused as it should be."""
    with tempfile.NamedTemporaryFile(suffix=".tlog") as file:
        file.write(content)
        file.flush()
        try:
            return read_log(file.name)
        except Unreadable:
            return None
