"""Fields of a log that a server plots: listed, thinned, and refused where the log has none, or may not be seen."""

import os
import tempfile
import threading

import numpy as np
import pytest
from recorded_flights import FLIGHT
from serving import TOKEN, serving

from mavdem.errors import Refusal
from mavdem.facts import Fact, Level
from mavdem.facts.event import Event
from mavdem.facts.session import VehicleFact
from mavdem.fleet.workers import outcome_of
from mavdem.report.blocks import Sentence
from mavdem.report.charts.chart import Line, Span, over_time
from mavdem.report.charts.timeline import Timeline
from mavdem.report.pages.page import Head, render_document
from mavdem.report.palette import PREDICTED
from mavdem.results import PAGE_FILE
from mavdem.serve import stored_columns
from mavdem.serve.field_store import FOLDER_PREFIX, SERVER_FILE, FieldRequest, FieldStore
from mavdem.serve.stored_files import register_server


class ReaderInThisProcess:
    """Reads logs at once, and counts them."""

    def __init__(self):
        self.logs = 0
        self.may_read = threading.Event()
        self.may_read.set()
        self.has_begun = threading.Event()

    def read(self, job, limits, read):
        self.logs += 1
        self.has_begun.set()
        self.may_read.wait(10)
        return outcome_of(job, read)

    def stop(self):
        pass


@pytest.fixture
def reader():
    return ReaderInThisProcess()


@pytest.fixture
def served(tmp_path, reader):
    with serving(tmp_path, fields=FieldStore(reader=reader)) as server:
        yield server


@pytest.fixture
def store(tmp_path, reader, monkeypatch):
    """A store whose columns lie in the folder of the test."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    store = FieldStore(reader=reader)
    yield store
    store.stop()


def column_files(folder):
    """The files of columns of all servers whose temporary files are in a folder."""
    return list(folder.glob(f"{FOLDER_PREFIX}*/*/{stored_columns.COLUMNS_FILE}"))


ROLL = FieldRequest("ATTITUDE", "roll")
LOG = FLIGHT.read_bytes()[:100_000]
"""The beginning of a recorded flight."""


def written(path):
    """Writes the log to a path, and returns that."""
    path.write_bytes(LOG)
    return path


def flight_with_log(server, content, headline="One."):
    """Uploads a log of the given content after its made-up reading, and returns the beginning of its addresses."""
    id = server.add("flight.tlog", headline)
    server.library.log_path(server.library.entry(id)).write_bytes(content)
    return f"/api/flights/{id}"


@pytest.mark.slow
def test_fields_are_listed_and_plotted_from_one_reading_of_the_log(served, reader):
    """A field is plotted with all samples, thinned with its extremes, and over a range of time."""
    flight = flight_with_log(served, LOG)
    messages = {
        message["message"]: message for message in served.get(f"{flight}/fields").json["messages"]
    }
    assert "roll" in messages["ATTITUDE"]["fields"]
    all_samples = served.get(f"{flight}/samples?message=ATTITUDE&field=roll&points=20000").json
    assert all_samples["count"] == len(all_samples["values"]) == messages["ATTITUDE"]["messages"]
    thinned = served.get(f"{flight}/samples?message=ATTITUDE&field=roll&points=10").json
    assert thinned["is_thinned"] and len(thinned["time"]) <= 20
    assert max(thinned["values"]) == max(all_samples["values"])
    assert min(thinned["values"]) == min(all_samples["values"])
    start = all_samples["time"][10]
    part = served.get(
        f"{flight}/samples?message=ATTITUDE&field=roll&start={start}&end={start}"
    ).json
    assert part["time"] == [start]
    assert reader.logs == 1


@pytest.mark.slow
def test_requests_for_unknown_fields_are_refused_with_a_sentence(served):
    """Message, field, instance, time or vehicle of the request are wrong."""
    flight = flight_with_log(served, LOG)
    refused = {
        "message=NONE&field=roll": (404, "The log has no NONE: it has "),
        "message=ATTITUDE&field=none": (404, "ATTITUDE has no field none: it has "),
        "message=ATTITUDE&field=roll&instance=7": (404, "ATTITUDE has no instance 7"),
        "message=ATTITUDE&field=roll&instance=x": (400, "The request cannot be understood"),
        "message=ATTITUDE&field=roll&start=nan": (400, "The request cannot be understood"),
        "message=ATTITUDE&field=roll&vehicle=9_9": (404, "The log has no vehicle 9_9"),
    }
    for query, (status, beginning) in refused.items():
        answer = served.get(f"{flight}/samples?{query}")
        assert answer.status == status
        assert answer.json["error"]["reason"].startswith(beginning)
    damaged = flight_with_log(served, b"no log", "Two.")
    assert served.get(f"{damaged}/fields").refusal == (415, "log_not_read")


@pytest.mark.slow
def test_fields_need_the_right_to_the_log(tmp_path, reader):
    with serving(tmp_path, TOKEN, fields=FieldStore(reader=reader)) as server:
        id = server.add("flight.tlog", "One.", token=TOKEN)
        path = f"/api/flights/{id}"
        assert server.get(f"{path}/fields").status == 404
        server.ask("PATCH", path, {"sharing": "link"}, TOKEN, Content_Type="application/json")
        assert server.get(path).status == 200
        assert server.get(f"{path}/fields").refusal == (401, "no_right")
    assert reader.logs == 0


@pytest.mark.slow
def test_a_log_that_was_read_is_plotted_while_another_is_read(tmp_path, store, reader):
    """A second log hangs while it is read, and is deleted meanwhile."""
    first, second = written(tmp_path / "1.tlog"), written(tmp_path / "2.tlog")
    count = len(store.samples(first, ROLL).time)
    reader.may_read.clear()
    reader.has_begun.clear()
    other_reader = threading.Thread(target=store.messages, args=(second,))
    other_reader.start()
    assert reader.has_begun.wait(10)
    assert len(store.samples(first, ROLL).time) == count
    assert other_reader.is_alive()
    # The log is deleted while it is read: its columns go when the request that waits for them is answered.
    store.remove(second)
    reader.may_read.set()
    other_reader.join()
    assert len(column_files(tmp_path)) == 1


@pytest.mark.slow
def test_a_changed_log_is_read_anew_and_a_deleted_one_leaves_nothing(tmp_path, store, reader):
    log = written(tmp_path / "flight.tlog")
    store.messages(log)
    os.utime(log, (0, 0))
    store.messages(log)
    assert reader.logs == 2
    store.remove(log)
    assert not column_files(tmp_path)


@pytest.mark.slow
def test_the_columns_of_a_flight_go_with_it(tmp_path, reader, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with serving(tmp_path / "library", fields=FieldStore(reader=reader)) as server:
        flight = flight_with_log(server, LOG)
        server.get(f"{flight}/fields")
        assert len(column_files(tmp_path)) == 1
        server.ask("DELETE", flight)
        assert not column_files(tmp_path)


@pytest.mark.slow
def test_too_many_fields_or_bytes_are_refused_after_one_reading(
    tmp_path, store, reader, monkeypatch
):
    monkeypatch.setattr(stored_columns, "MAX_FIELDS", 3)
    large_log = written(tmp_path / "many.tlog")
    for _ in range(2):
        with pytest.raises(Refusal, match="fields are plotted of logs with at most 3"):
            store.messages(large_log)
    assert reader.logs == 1
    monkeypatch.undo()
    monkeypatch.setattr(stored_columns, "MAX_COLUMN_BYTES", 1 << 10)
    with pytest.raises(Refusal, match="the limit for plotting them"):
        store.messages(written(tmp_path / "large.tlog"))
    assert not column_files(tmp_path)


@pytest.mark.slow
def test_columns_of_killed_servers_are_removed_and_those_of_others_stay(tmp_path, store):
    killed, alive = tmp_path / f"{FOLDER_PREFIX}1", tmp_path / f"{FOLDER_PREFIX}2"
    for folder in (killed, alive):
        folder.mkdir()
    (killed / SERVER_FILE).touch()
    lock = register_server(alive / SERVER_FILE)
    store.messages(written(tmp_path / "flight.tlog"))
    assert not killed.exists() and alive.exists()
    lock.release()


def page_of_a_flight(start, end):
    """The page of a flight from start to end, s, with a strip of modes and a chart with an event."""
    time = np.linspace(start, end, 60)
    height = over_time("Height", "m", [Line("height", PREDICTED, time, np.sin(time))])
    modes = (Span(start, end, "Hold"),)
    events = (Event(start + 1, Fact(VehicleFact.NO_VEHICLE_YET)),)
    timeline = Timeline((height,), (start, end), modes=modes, events=events)
    head = Head(Level.GOOD, {}, timeline=timeline)
    return render_document("flight.tlog", "", [Sentence("", "One.")], head=head)


@pytest.mark.slow
def test_a_field_is_searched_plotted_linked_to_and_removed_in_a_browser(served, browser):
    """The script of a flight's page lists, searches and plots the log's fields; without Chromium it is not tested."""
    flight = flight_with_log(served, LOG)
    entry = served.library.entry(flight.rsplit("/", 1)[1])
    page_path = served.library.results_folder(entry) / PAGE_FILE
    samples = served.get(f"{flight}/samples?message=ATTITUDE&field=roll&points=10").json
    page_path.write_text(page_of_a_flight(samples["time"][0], samples["time"][-1]))
    status = "document.getElementById('fieldstatus').textContent"
    listed = "[...document.querySelectorAll('#fieldlist button')].map(one => one.textContent)"
    drawn = "document.documentElement.charts.groups.flight?.charts.filter(one => one.data_.lines.length)"
    charts = f"{drawn}.length"
    with browser.tab() as tab:
        tab.open(f"{served.address}/f/{entry.id}")
        tab.until(f"{charts} === 1")
        tab.run("document.querySelector('#fields summary').click()")
        tab.until(f"{status}.includes('messages. Choose a field')")
        assert any(text.startswith("ATTITUDE") for text in tab.run(listed))
        search = "document.getElementById('fieldsearch')"
        tab.run(f"{search}.value = 'no such field'; {search}.dispatchEvent(new Event('input'))")
        assert tab.run("document.getElementById('fieldlist').textContent").startswith("No field")
        tab.run(f"{search}.focus(); {search}.value = ''")
        tab.command("Input.insertText", text="attitude rollspeed")
        (field,) = tab.run(listed)
        assert field.startswith("ATTITUDE.rollspeed")
        tab.command("Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter")
        tab.until(f"{charts} === 2 && {status}.includes('samples, below the other plots')")
        pressed = "document.querySelector('#fieldlist button').getAttribute('aria-pressed')"
        assert tab.run(pressed) == "true"
        assert tab.run(f"{drawn}.map(one => one.data_.marks.length)") == [1, 1]
        # With Shift a second field joins the plot of the first.
        tab.run(
            f"{search}.value = 'attitude pitchspeed'; {search}.dispatchEvent(new Event('input'))"
        )
        tab.command(
            "Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter", modifiers=8
        )
        title = "[...document.querySelectorAll('#flight figure h3')].at(-1).textContent"
        both = "ATTITUDE.rollspeed (rad/s), ATTITUDE.pitchspeed (rad/s)"
        tab.until(f"{charts} === 2 && {title} === {both!r}")
        address = tab.run("location.href")
        assert "plot=ATTITUDE" in address
        # Who gets the link sees the same plot.
        tab.open(address)
        tab.until(f"{charts} === 2 && {title} === {both!r}")
        tab.run("document.querySelector('button.close').click()")
        tab.until(f"{charts} === 1 && !location.search.includes('plot=')")
        assert tab.said == []


STUBBED_FIELDS = """(() => {
  const message = (name, fields) => (
    { message: name, name_in_source: name, fields, units: fields.map(() => ""), instances: [], rate: 220 }
  );
  const messages = [
    message(
      "battery_status", ["voltage_cell_v[0]", "voltage_cell_v[1]", "voltage_filtered_v", "voltage_v"]
    ),
    message("system_power", ["voltage5v_v"]),
    message("vehicle_status", ["condition_battery_healthy"]),
    message("sensor_combined", ["gyro_integral_dt", "gyro_rad[0]", "gyro_rad[1]"]),
    message("actuator_outputs", ["instance", "noutputs", "output[0]", "output[1]"]),
    message("RATE", ["TimeUS", "RDes", "R", "P"]),
    message("GPS", ["Status", "Lat", "Lng"]),
  ];
  const answer = { ok: true, status: 200, json: async () => ({ messages }) };
  window.requested = [];
  window.fetch = address => {
    requested.push(address);
    return new Promise(resolve => { window.answerFields = () => resolve(answer); });
  };
})()"""
"""Script that replaces the server's list of fields by a made-up one, which comes when ``answerFields`` is called."""


@pytest.mark.slow
def test_the_best_match_comes_first_and_an_early_enter_is_of_the_words_before_it(served, browser):
    """A scalar with the fewest other words precedes an array; Enter without words plots nothing that is typed later."""
    flight = flight_with_log(served, LOG)
    entry = served.library.entry(flight.rsplit("/", 1)[1])
    page_path = served.library.results_folder(entry) / PAGE_FILE
    page_path.write_text(page_of_a_flight(0.0, 60.0))
    with browser.tab() as tab:
        tab.open(f"{served.address}/f/{entry.id}")
        tab.until("document.querySelector('#fields summary') !== null")
        tab.run(STUBBED_FIELDS)
        tab.run("document.querySelector('#fields summary').click()")
        tab.until("window.answerFields !== undefined")
        search = "document.getElementById('fieldsearch')"
        tab.run(f"{search}.focus()")
        tab.command("Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter")
        tab.command("Input.insertText", text="battery voltage")
        tab.run("answerFields()")
        names = "[...document.querySelectorAll('#fieldlist button span:first-child')].map(one => one.textContent)"
        tab.until(f"{names}.length === 5")
        assert tab.run(names) == [
            "battery_status.voltage_v",
            "battery_status.voltage_filtered_v",
            "battery_status.voltage_cell_v[all 2]",
            "battery_status.voltage_cell_v[0]",
            "battery_status.voltage_cell_v[1]",
        ]
        for words, best_field in (
            ("battery", "battery_status.voltage_v"),
            ("gyro", "sensor_combined.gyro_rad[all 2]"),
            ("actuator_outputs", "actuator_outputs.output[all 2]"),
            ("rate roll", "RATE.R"),
            ("position", "GPS.Lat"),
        ):
            tab.run(f"{search}.value = {words!r}; {search}.dispatchEvent(new Event('input'))")
            assert tab.run(names)[0] == best_field
        assert len(tab.run("requested")) == 1
