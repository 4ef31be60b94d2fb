"""The worker: what becomes of a log whose reader wants more memory than there is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mavdem.errors import Unreadable
from mavdem.fleet.reading.outcome import Job
from mavdem.fleet.reading.worker import perform
from mavdem.fleet.row import FlightRow


def unfit(path: Path, page: Any, pages: str, key: str) -> list[FlightRow]:
    try:
        raise MemoryError
    except MemoryError:
        raise Unreadable(f"{path} does not fit into memory.") from None


def damaged(path: Path, page: Any, pages: str, key: str) -> list[FlightRow]:
    raise Unreadable(f"{path} is damaged, and {path} is cut.")


def test_want_of_memory_is_the_limit_s_however_the_reader_says_it(tmp_path):
    (tmp_path / "x.bin").write_bytes(b"?")
    outcome = perform(Job(str(tmp_path / "x.bin")), unfit, 600)
    assert (outcome.ended, outcome.rows[0].status) == ("memory", "It needs more memory than its limit of 600 MB.")


def test_a_sentence_about_a_log_leaves_its_name_to_its_column(tmp_path):
    (tmp_path / "x.bin").write_bytes(b"?")
    outcome = perform(Job(str(tmp_path / "x.bin")), damaged, 600)
    assert (outcome.ended, outcome.rows[0].file) == ("read", str(tmp_path / "x.bin"))
    assert outcome.rows[0].key == outcome.key != "" and outcome.rows[0].status.startswith("It is damaged, and ")
