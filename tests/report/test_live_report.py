"""The report of a live session: what its time was spent on."""

from mavdem.facts.session import TimeUse
from mavdem.live.history import LiveHistory
from mavdem.live.session_status import SessionStatus
from mavdem.report.blocks import Table
from mavdem.report.live import live_report


def test_the_table_of_time_adds_up():
    account = dict.fromkeys(TimeUse, 0.0)
    first, second, third = list(TimeUse)[:3]
    account |= {first: 12.2, second: 30.0, third: 0.3}
    blocks = live_report(LiveHistory(), SessionStatus(), account, "roll")
    [table] = [block for block in blocks if isinstance(block, Table)]
    assert table.header == ["of 42 s", "time"]
    assert [row[1] for row in table.rows] == ["12 s", "30 s"]
