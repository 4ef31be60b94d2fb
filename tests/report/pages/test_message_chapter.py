"""The chapter of what the autopilot wrote: as it wrote it, repetitions once, and what warns on paper."""

import numpy as np
from browsing import HOSTILE
from pytest import mark

from mavdem.facts import Level
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import NO_SEVERITY
from mavdem.report.blocks import Moment
from mavdem.report.pages.message_chapter import MAX_MESSAGES, MAX_TEXT_LENGTH, messages_chapter
from mavdem.report.pages.page import MAX_PRINTED_ROWS, render_document


def vehicle_that_wrote(*texts, errors=()):
    """A vehicle that wrote texts (time, boot, severity, text) and errors (time, subsystem, code)."""
    messages = {}
    if texts:
        time, boot, severity, text = zip(*texts, strict=True)
        messages["STATUSTEXT"] = {
            "time": np.array(time),
            "boot": np.array(boot),
            "severity": np.array(severity),
            "text": np.array(text, dtype=object),
        }
    if errors:
        time, subsystem, code = zip(*errors, strict=True)
        messages["ERR"] = {
            "time": np.array(time),
            "boot": np.zeros(len(time), int),
            "Subsys": np.array(subsystem),
            "ECode": np.array(code),
        }
    return Telemetry(1, 1, "QUADROTOR", "ARDUPILOTMEGA", messages)


def test_messages_have_time_level_and_text_and_those_in_a_row_a_count():
    chapter = messages_chapter(
        vehicle_that_wrote(
            (1.0, 0, 6, "Init"),
            (2.0, 0, 4, "GPS bad"),
            (3.0, 0, 4, "GPS bad"),
            (4.0, 0, 6, "Init"),
            (2.0, 1, 6, "Init"),
        ),
        charts_boot=1,
    )
    table = chapter.searchable
    assert table.header == ["time", "level", "text", "in a row"]
    assert table.rows == [
        ["boot 1, 1.0 s", "info", "Init", ""],
        ["boot 1, 2.0 s", "warning", "GPS bad", "2 times"],
        ["boot 1, 4.0 s", "info", "Init", ""],
        ["boot 2, 2.0 s", "info", "Init", ""],
    ]
    assert table.rows[1][1].level is Level.WATCH
    # Plots are of one boot.
    assert [isinstance(row[0], Moment) for row in table.rows] == [False, False, False, True]
    assert not messages_chapter(vehicle_that_wrote(), charts_boot=0).has_content


def test_an_error_is_written_as_its_numbers_with_the_name_of_its_subsystem():
    errors = [(5.0, 16, 2), (6.0, 16, 0), (7.0, 99, 1)]
    chapter = messages_chapter(vehicle_that_wrote((5.5, 0, NO_SEVERITY, "EKF"), errors=errors), 0)
    assert [row[1:] for row in chapter.searchable.rows] == [
        ["error", "ERR: Subsys 16 (EKFCHECK), ECode 2"],
        ["", "EKF"],
        ["", "ERR: Subsys 16 (EKFCHECK), ECode 0"],
        ["error", "ERR: Subsys 99, ECode 1"],
    ]


def test_warnings_are_kept_and_printed_of_more_messages_than_a_page_lists():
    many = [(float(number), 0, 6, f"text {number}") for number in range(MAX_MESSAGES + 5)]
    chapter = messages_chapter(vehicle_that_wrote(*many, (1000.0, 0, 3, HOSTILE)), 0)
    assert len(chapter.searchable.rows) == MAX_MESSAGES
    assert chapter.searchable.rows[-1][2] == HOSTILE
    page = render_document("a.bin", "", [], [chapter])
    assert f"{MAX_MESSAGES} of {MAX_MESSAGES + 6} messages are listed" in page
    assert HOSTILE not in page
    rows = page.split("<tbody>")[1].split("</tbody>")[0]
    assert rows.count("<tr") == MAX_MESSAGES and rows.count('class="on-screen"') == MAX_MESSAGES - 1
    assert 'data-at="1000.0"' in rows and 'href="#t=1000.00"' in rows


@mark.parametrize("total, is_printed", [(MAX_PRINTED_ROWS, True), (MAX_PRINTED_ROWS + 1, False)])
def test_messages_without_a_warning_are_printed_where_they_are_few(total, is_printed):
    texts = [(float(number), 0, 6, f"text {number}") for number in range(total)]
    chapter = messages_chapter(vehicle_that_wrote(*texts), 0)
    assert bool(chapter.printed_rows) is is_printed
    page = render_document("a.bin", "", [], [chapter])
    assert (f"{total} rows, none of them a warning" in page) is not is_printed


def test_a_text_of_a_damaged_log_does_not_fill_the_page():
    chapter = messages_chapter(vehicle_that_wrote((1.0, 0, 4, "x" * 1_000_000)), charts_boot=0)
    text = chapter.searchable.rows[0][-1]
    assert len(text) == MAX_TEXT_LENGTH
    assert text.endswith("x…")
