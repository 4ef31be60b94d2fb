"""The library: what is acknowledged stays, whatever ends a server, and several may share a folder."""

import errno
import json
import os
import re
import shutil
import sqlite3
import threading
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from unittest.mock import Mock

from date_searches import FLIGHT_DATES, FOUND_BY_DATE
from filelock import FileLock, Timeout
from fleet_rows import flight_row
from patience import until
from pytest import approx, fixture, mark, raises
from recorded_flights import SLOW
from refusals import unreadable
from serving import LIMITS, AtOnce, log, read_made_up, serving
from standin_logs import fleet_of, rows_of_log

from mavdem.assessment.flown_flights import FlownFlight
from mavdem.errors import Refusal, Unreadable
from mavdem.facts import Fact, Level
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.lights import Light
from mavdem.facts.serve import ListingOrder, Stage, StartFailure
from mavdem.facts.urgency import Urgency, urgency_of_headline
from mavdem.fleet.names import GivenNames
from mavdem.fleet.row import FlightRow
from mavdem.fleet.stored_rows import brief_json, read_rows
from mavdem.fleet.workers import KEY_HASH_DIGITS, Job, JobLimits, outcome_of
from mavdem.ingest import read_log
from mavdem.report.pages.library_page import (
    LINK_TO_FLEET_HTML,
    render_server_page,
    vehicle_id_on_page,
)
from mavdem.report.pages.page import PageLink, render_document
from mavdem.results import PAGE_FILE, RECORDING_FILE, REPORT_FILE
from mavdem.serve.compared_motors import entry_compared_with_fleet, order_sql
from mavdem.serve.index import (
    LibraryEntry,
    columns_of_flight,
    create_or_update_table,
    entry_of_fleet_log,
    insert_entry,
)
from mavdem.serve.library import Library
from mavdem.serve.reading import read_for_library
from mavdem.serve.reading_threads import ReadingThreads
from mavdem.serve.recovery import dead_servers, recover
from mavdem.serve.rights import Rights
from mavdem.serve.run import ServerOptions, serve
from mavdem.serve.search import (
    half_typed_terms,
    search_condition,
    search_problems,
    unknown_terms,
)
from mavdem.serve.similar_flight import most_similar_flight
from mavdem.serve.stored_files import PROGRESS, stored_file_name
from mavdem.serve.uploads import require_log_file
from mavdem.serve.visible_library import VisibleLibrary

ALL = search_condition("")


def test_a_search_says_which_value_is_no_number_and_which_no_level():
    assert search_problems("quad wind>5 Wind:5 wind:bad motors:watch motor:3 MC_ROLL_P<6") == []
    assert search_problems("Wind>x") == ["x is not a number"]
    number, level = search_problems("wind>abc level:foo")
    assert number == "abc is not a number"
    assert level == "foo is no level: these are good, watch, bad and unknown"
    assert search_problems("MC_ROLL_P<x stage:done") == ["x is not a number"]
    assert search_problems("motors:bad,foo") == [
        "foo is no level: these are good, watch, bad and unknown"
    ]
    assert search_problems("mc_roll_p<6 BATT_CAPACITY>0") == [
        "BATT_CAPACITY is not searched: of the parameters, only gains and filters of rate and attitude control are"
    ]
    assert search_problems("motors:bad, motors:bad,,watch") == []
    assert len(search_problems("motors:foo,foo,,")) == 1
    (sharing,) = search_problems("sharing:mine")
    assert sharing == "mine is no sharing: these are private, link and public"


def test_a_term_that_is_still_typed_limits_no_search_and_says_what_it_lacks():
    assert search_condition("quad motors: motors:,,") == search_condition("quad")
    assert search_condition("motors:bad,,bad") == search_condition("motors:bad,")
    level, number, choice = half_typed_terms("motors: Wind> sharing= colour: quad 12:30 motors:bad")
    assert level == "motors: lacks its level: these are good, watch, bad and unknown"
    assert number == "Wind> lacks its number"
    assert choice == "sharing= lacks its value: these are private, link and public"


def test_motors_are_searched_for_as_pages_show_them():
    """The column has the level by the log alone; a fault or a drift is known from other flights of the vehicle.

    One that is to be compared again, such as after a new baseline, is not known at present.
    """
    db = sqlite3.connect(":memory:")
    db.row_factory = sqlite3.Row
    create_or_update_table(db)
    db.execute("create table flights (log, vehicle, file, judged, row, brief)")
    db.execute("create table healthy (row)")
    db.execute("create table logs (log, tracked)")
    for name, level, health in (
        ("own", "bad", "drift"),
        ("fault", "good", "fault"),
        ("drift", "unknown", "drift"),
        ("sound", "good", "ok"),
        ("outdated", "good", "fault"),
    ):
        digest = sha256(name.encode()).hexdigest()
        entry = LibraryEntry(name, name, digest, name, vehicle="quad", motors=level)
        insert_entry(db, entry)
        row = [f"{digest[:KEY_HASH_DIGITS]}-1", "quad", "a.bin", json.dumps({"health": health})]
        judged = None if name == "outdated" else ""
        db.execute("insert into logs values (?, 1)", row[:1])
        db.execute(
            "insert into flights (log, vehicle, file, brief, judged, row) values (?, ?, ?, ?, ?, ?)",
            [*row, judged, '{"balance": [0]}'],
        )
    db.execute("insert into healthy values (?)", ['{"vehicle": "quad"}'])
    motors = []
    for search in ("motors:bad", "motors:watch", "motors:good", "motors:unknown"):
        condition = search_condition(search)
        query = f"select id from entries where {condition.expression} order by rowid"
        motors.append([row["id"] for row in db.execute(query, condition.values)])
    assert motors == [["own", "fault"], ["drift"], ["sound"], ["outdated"]]


@mark.slow
def test_a_fault_that_only_other_flights_show_is_sorted_searched_and_reported_as_it_is_shown(
    library,
):
    """By their logs alone nothing is wrong with two of three flights."""
    anomalies = {
        "sound": {"health": "ok", "health_reason": "As in other flights."},
        "weak": {"health": "fault", "health_reason": "Motor 1 lost thrust.", "suspect_motor": 1},
        "crashed": {"health": "fault", "health_reason": "Motor 2 lost thrust.", "suspect_motor": 2},
    }
    good = {"level": "good", "headline": "Nothing wrong found.", "urgency": Urgency.GOOD}
    crash = {"level": "bad", "headline": "Crash.", "urgency": Urgency.LOST}
    ids = {}
    for name, anomaly in anomalies.items():
        part = library.new_incoming_path()
        part.write_bytes(log(name))
        entry = library.add(part, "a.ulg")
        judgement = crash if name == "crashed" else good
        columns = {"stage": Stage.DONE, "motors": "good", "vehicle": "quad", "next_step": "Fly."}
        ids[library.change(entry.id, **columns, **judgement).id] = name
        row = flight_row("quad", 0, file=str(library.log_path(entry)), **anomaly)
        library.db.execute("insert into logs (path, log) values (?, ?)", [row.file, entry.digest])
        library.db.execute(
            "insert into flights (log, vehicle, file, brief) values (?, ?, ?, ?)",
            [entry.digest, "quad", row.file, brief_json(row)],
        )
    by_urgency = library.find(*ALL, 3, order=ListingOrder.URGENCY).entries
    assert [ids[entry.id] for entry in by_urgency] == ["crashed", "weak", "sound"]
    for search, expected in (
        ("level:good", {"sound"}),
        ("level:bad", {"weak", "crashed"}),
        ("motor:1", {"weak"}),
        ("lost thrust", {"weak", "crashed"}),
        ("nothing wrong", {"sound"}),
        ("crash.", {"crashed"}),
    ):
        entries = library.find(*search_condition(search), 3).entries
        assert {ids[entry.id] for entry in entries} == expected, search
    visible = VisibleLibrary(library, Rights())
    crashed, weak, sound = visible.documents(by_urgency)
    assert (weak.level, weak.headline, weak.motor) == ("bad", "Motor 1 lost thrust.", 1)
    assert "motor 1" in weak.next_step and weak.lights["motors"] == "bad"
    assert (crashed.headline, crashed.next_step, crashed.motor) == ("Crash.", "Fly.", 2)
    assert (sound.level, sound.headline, sound.motor) == ("good", "Nothing wrong found.", None)


def test_the_words_that_the_list_shows_of_a_simulated_or_unnamed_flight_are_found():
    db = sqlite3.connect(":memory:")
    db.row_factory = sqlite3.Row
    create_or_update_table(db)
    db.execute("create table flights (log, vehicle, file, judged, row, brief)")
    db.execute("create table healthy (row)")
    db.execute("create table logs (log, tracked)")
    db.execute("create table vehicle_names (vehicle, name)")
    db.execute("create table flight_names (content, name)")
    px4 = {"vehicle_basis": "system id", "autopilot": "PX4", "frame": "QUADROTOR"}
    insert_entry(db, LibraryEntry("sim", "a", "1", "a", vehicle="px4-1", simulated=1, **px4))
    insert_entry(db, LibraryEntry("named", "b", "2", "b", vehicle="quad 7", frame="QUADROTOR"))

    def found(search):
        """Returns the ids of the entries that a search finds."""
        condition = search_condition(search)
        query = f"select id from entries where {condition.expression} order by id"
        return [row["id"] for row in db.execute(query, condition.values)]

    assert found("simulated") == found("unnamed px4") == ["sim"]
    assert found("quadrotor") == ["named", "sim"]

    assert found("motors:bad,watch") == []
    db.execute("update entries set motors = 'watch' where id = 'named'")
    db.execute("update entries set motors = 'bad' where id = 'sim'")
    assert found("motors:bad,watch") == ["named", "sim"]
    assert found("motors:good,Bad") == ["sim"]
    db.execute("""update entries set gains = '{"MC_ROLLRATE_P": 0.15}' where id = 'named'""")
    assert found("MC_ROLLRATE_P>0.1") == found("mc_rollrate_p:0.15") == ["named"]
    assert found("mc_rollrate_p<0.1") == []


def test_a_day_month_or_year_of_a_search_is_an_interval():
    db = sqlite3.connect(":memory:")
    db.row_factory = sqlite3.Row
    create_or_update_table(db)
    for number, date in enumerate(FLIGHT_DATES):
        insert_entry(db, LibraryEntry(str(number), "a", "", str(number), date=date))
    for search, numbers in FOUND_BY_DATE.items():
        condition = search_condition(search)
        query = f"select id from entries where {condition.expression} order by id"
        assert [int(row["id"]) for row in db.execute(query, condition.values)] == numbers, search
    assert search_problems("date<2022-03-09 date:2022") == []
    assert search_problems("date:9.3.22") == [
        "9.3.22 is no date: write 2026-05-31, 2026-05 or 2026"
    ]
    # Digits of other scripts are later than all dates as texts, so that a search would find every flight by them.
    for no_date in (
        "\u0662\u0660\u0662\u0666",
        "2022-13",
        "2022-00",
        "2022-03-32",
        "2022-03-09T24",
    ):
        assert len(search_problems(f"date<={no_date}")) == 1, no_date


def test_a_search_by_an_unknown_property_names_the_known_ones():
    assert unknown_terms("quad wind>5 motors:bad tag:race MC_ROLL_P<6 date>2026") == []
    (sentence,) = unknown_terms("foo:bar quad")
    assert sentence.startswith("No such term: foo. Terms are vehicle, mode, tag, wind,")
    assert sentence.endswith(", and gains")


def library_page(entries, anomalous_rows=None, **values):
    """The page with the list of these flights, as somebody who may read sees it."""
    template_values = {
        "entries": entries,
        "total": len(entries),
        "query": "",
        "order": "upload",
        "offset": 0,
    }
    template_values |= {
        "page": 50,
        "is_empty": False,
        "sample": None,
        "is_live": False,
        "vehicles": [],
    }
    template_values |= {
        "anomalous_rows": anomalous_rows or {},
        "may_read": True,
        "key": "",
        "has_token": False,
    }
    template_values |= {"address": "", "upload": "", "given": GivenNames(), "frames": {}}
    return render_server_page("library", **template_values | values)


def plain_line(html):
    """Returns the text of some HTML, without tags, in one line."""
    return " ".join(re.sub("<[^>]*>", "", html).split())


@mark.parametrize("health, level", [("ok", "good"), ("drift", "watch"), ("fault", "bad")])
def test_the_list_has_the_lights_of_the_pages_and_the_interval_of_the_wind(health, level):
    """A fault or drift by other flights replaces the good light of the motors in the list."""
    lights = dict.fromkeys(Light, "good") | {"wind": "unknown"}
    wind = {"wind_speed": 5.7, "wind_low": 2.9, "wind_high": 10.4}
    entry = LibraryEntry("id", "a.bin", stage=Stage.DONE, level="good", **wind, **lights)
    row = flight_row("quad", 0, health=health, health_reason="Motor 3 works harder.")
    anomalous_rows = {} if health == "ok" else {"id": row}
    page = library_page(
        [entry_compared_with_fleet(entry, anomalous_rows.get("id"))], anomalous_rows
    )
    assert f'aria-label="motors {level}"' in page
    assert ">2.9 to 10.4 m/s<" in page
    # An interval that is narrow is shown as well, since searches compare it.
    narrow = replace(entry, wind_speed=6.1, wind_low=4.98, wind_high=7.37)
    assert ">5.0 to 7.4 m/s<" in library_page([narrow], {})
    # A phone has all lights in one line, in which no unknown one is left out.
    on_phone = page.partition('<span class="phone">')[2].partition("</td>")[0]
    good_count = 7 if health == "ok" else 6
    assert plain_line(on_phone).endswith(f"{good_count} good ○ 1 unknown")
    motors_unknown = replace(entry, motors="unknown")
    on_phone = library_page([motors_unknown]).partition('<span class="phone">')[2]
    assert "○ motors and 1 more unknown" in plain_line(on_phone.partition("</td>")[0])
    # A vehicle without a name has one line.
    by_calibration = replace(
        entry, vehicle="accelerometer-39ca5c6f6923", vehicle_basis="accelerometer"
    )
    unnamed = ">…\N{WORD JOINER}6f6923</a>"
    assert unnamed in library_page([by_calibration], {})


@mark.parametrize(
    "name, sentence",
    [
        ("notalog.bin", "notalog.bin contains no DataFlash messages."),
        ("notalog.ulg", "notalog.ulg is no PX4 ULog:"),
        ("notalog.tlog", "notalog.tlog contains no MAVLink:"),
        ("README.md", "README.md is no flight log:"),
    ],
)
def test_what_is_no_log_is_refused_as_its_name_says(tmp_path, name, sentence):
    path = tmp_path / "incoming"
    # A DataFlash log whose definitions are missing is a log: its reading says what it lacks.
    path.write_bytes((b"\xa3\x95N" + bytes(range(1, 60))) * 40)
    if name.endswith(".bin"):
        require_log_file(path, name)
    path.write_bytes(bytes(range(1, 200)) * 20)
    with raises(Unreadable) as refusal:
        require_log_file(path, name)
    assert refusal.value.fact.replace(path=name).sentence.startswith(sentence)


def stored_entry(library, said="One.", name="a.ulg", **columns):
    """Returns the entry of a made-up log with this headline that a library has received."""
    part = library.new_incoming_path()
    part.write_bytes(log(said))
    return library.add_with_digest(part, said.encode().hex().zfill(64), name, **columns)


@fixture
def library(tmp_path):
    """A new one."""
    return Library(tmp_path)


def release_lock(library):
    """Leaves a library as a killed process does: without its lock, and otherwise unchanged."""
    library._lock.release()


@mark.slow
def test_what_was_acknowledged_outlives_a_killed_server_and_half_uploads_do_not(library, tmp_path):
    """A server is killed with a waiting log, a log being read, a half upload and a live recording."""
    waiting, working = stored_entry(library), stored_entry(library, "Two.")
    library.change(waiting.id, stage=Stage.READING, claimed=library.name)
    library.new_incoming_path().write_bytes(b"half of a log")
    library.new_incoming_path("session.tlog").write_bytes(log("Three."))
    library.new_incoming_path("empty.tlog").touch()
    for folder in (
        "logs/mine",
        "results/mine",
        f"results/.{working.digest}",
        "results/" + 64 * "d",
        "results/copy_of_" + 64 * "d",
    ):
        (tmp_path / folder).mkdir()
    (tmp_path / "servers" / "mine").touch()
    release_lock(library)

    again = Library(tmp_path)
    entries, total = again.find(*ALL, 10)
    assert total == 3 and {entry.stage for entry in entries} == {Stage.WAITING}
    assert "session.tlog" in {entry.name for entry in entries}
    assert all(again.log_path(entry).is_file() for entry in entries)
    file_counts = {
        part: len(list((tmp_path / part).iterdir()))
        for part in ("incoming", "logs", "results", "servers")
    }
    assert file_counts == {"incoming": 0, "logs": 4, "results": 2, "servers": 3}
    AtOnce(again).run()
    assert {entry.stage for entry in again.find(*ALL, 10)[0]} == {Stage.DONE}


@mark.slow
@mark.parametrize("moment", ["os.replace", "sync_folder", "insert_entry"])
def test_an_upload_that_breaks_off_at_any_moment_is_whole_or_not_there(
    library, tmp_path, monkeypatch, moment
):
    """The process ends at one of three moments of an upload."""
    part = library.new_incoming_path()
    part.write_bytes(log())

    def end(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(f"mavdem.serve.library.{moment}", end)
        with raises(KeyboardInterrupt):
            library.add_with_digest(part, 64 * "d", "a.ulg")
    release_lock(library)
    again = Library(tmp_path)
    there = [*(tmp_path / "logs").rglob("*.ulg")]
    assert [again.log_path(entry) for entry in again.find(*ALL, 1)[0]] == there
    if moment == "sync_folder":
        assert len(there) == 1
    else:
        assert len(there) == 0


@mark.slow
def test_logs_outlive_a_lost_index(tmp_path):
    before = stored_entry(Library(tmp_path))
    for path in tmp_path.glob("fleet.sqlite*"):
        path.unlink()
    (entry,), _ = Library(tmp_path).find(*ALL, 2)
    assert (entry.name, entry.stage) == ("a.ulg", Stage.WAITING)
    assert entry.received == approx(before.received, abs=60)


@mark.slow
def test_a_library_whose_folder_is_moved_lists_each_flight_once_with_its_rows(tmp_path):
    """The folder of the library is renamed between two runs of the server."""
    with serving(tmp_path / "before") as server:
        id = server.add("a.ulg", "A weak motor.")
    (tmp_path / "before").rename(tmp_path / "after")
    with serving(tmp_path / "after") as server:
        assert server.get("/api/flights").json["total"] == 1
        entry = server.library.entry(id)
        rows = server.library.flight_rows([entry])
        assert {row.file for row in rows} == {str(server.library.log_path(entry))}
        assert "Motor 3 lost thrust." in server.get("/").text


@mark.slow
def test_a_folder_that_is_named_by_its_parent_lists_each_flight_once(tmp_path):
    (tmp_path / "here").mkdir()
    with serving(tmp_path / "here" / ".." / "library") as server:
        server.add("a.ulg", "A weak motor.")
        assert server.library.folder == tmp_path / "library"
    with serving(tmp_path / "here" / ".." / "library") as server:
        assert server.get("/api/flights").json["total"] == 1


@mark.slow
def test_servers_that_share_a_folder_leave_each_other_alone(tmp_path):
    """Two servers claim logs in turn; the logs of a server that ended are claimed by the other."""
    first_library, other_library = Library(tmp_path), Library(tmp_path)
    entries = [stored_entry(first_library, f"{number}.") for number in range(4)]
    for library, entry in zip(
        (first_library, other_library, first_library, other_library), entries, strict=True
    ):
        assert library.claim().id == entry.id
    assert first_library.claim() is None
    part = first_library.new_incoming_path()
    part.write_bytes(b"half of a log")
    recover(other_library)
    assert part.is_file() and other_library.claim() is None
    release_lock(first_library)
    recover(other_library)
    assert not part.is_file()
    assert [other_library.claim().id for _ in range(2)] == [entries[0].id, entries[2].id]


@mark.slow
@mark.skipif(os.name != "posix", reason="earlier versions ran on POSIX only")
def test_servers_of_earlier_versions_are_seen_and_see_this_one(library, tmp_path):
    """They locked the server's file itself, and had none beside it."""
    path = tmp_path / "servers" / "0123456789abcdef"
    with FileLock(path):
        assert dead_servers(library) == []
    assert dead_servers(library) == [path.name]
    with raises(Timeout):
        FileLock(tmp_path / "servers" / library.name, blocking=False).acquire()


@mark.slow
def test_a_log_that_comes_again_while_it_is_deleted_stays(library, monkeypatch):
    """The same log is uploaded while another thread deletes it."""
    first = stored_entry(library)
    claimed = library.claim()
    outcome = outcome_of(Job(str(library.log_path(claimed))), read_made_up)
    again = threading.Thread(target=stored_entry, args=(library,))
    remove = shutil.rmtree

    def late(path, **how):
        if again.ident is None:
            again.start()
            again.join(1.0)
        remove(path, **how)

    monkeypatch.setattr(shutil, "rmtree", late)
    library.delete(first.id)
    again.join()
    (entry,), _ = library.find(*ALL, 10)
    assert library.log_path(entry).is_file()
    AtOnce(library).run()
    library.finish_reading(claimed, outcome, LIMITS)
    assert (library.results_folder(entry) / PAGE_FILE).is_file()


@mark.slow
def test_a_whole_log_takes_over_what_users_added_to_its_part(library):
    """A name, a note and sharing that the first minutes of a flight were given stay when the whole flight is stored."""
    stored = []
    for content in (log("first minutes"), log("whole flight")):
        path = library.new_incoming_path()
        path.write_bytes(content)
        stored.append(library.add(path, "a.ulg"))
    part, whole = stored
    library.name_flight(part, "Search in the wood")
    part = library.change(part.id, note="Seen last at the lake", sharing="link", log_shared=1)
    whole = library.replace_part(part.id, whole)
    (entry,), _ = library.find(*ALL, 10)
    assert entry == whole == library.entry(whole.id)
    assert library.names.flights == {whole.content_hash: "Search in the wood"}
    assert (entry.note, entry.sharing, entry.log_shared) == ("Seen last at the lake", "link", 1)
    with raises(Refusal):
        library.replace_part(part.id, whole)


@mark.slow
def test_only_flights_of_an_earlier_track_are_counted_as_incomplete(tmp_path):
    """A flight that has neither modes nor gains is complete once the present version has read it."""
    flight = FlightRow(file="/logs/a.bin", vehicle="quad 7", axis="roll", status="ok")
    fleet_of(tmp_path, [replace(flight, control_parameters=None)])
    library = Library(tmp_path)
    library.add_fleet_logs()
    assert library.incomplete_count() == 1
    fleet_of(tmp_path, [replace(flight, control_parameters="{}")])
    library.add_fleet_logs()
    assert library.incomplete_count() == 0


@mark.slow
def test_a_fleet_is_shown_as_it_is(tmp_path):
    """A library opens the folder of a fleet, adds its logs, and follows its changes."""
    tmp_path /= "\udcff"  # The name of the folder is not UTF-8.
    rows = [FlightRow(file=f"/logs/{name}.bin", vehicle=name, axis="roll") for name in "abc"]
    fleet_of(tmp_path, rows[:2])
    library = Library(tmp_path)
    library.add_fleet_logs()
    fleet_of(tmp_path, rows[1:])
    library.add_fleet_logs()
    entries, total = library.find(*ALL, 100)
    assert total == 3 and {entry.name for entry in entries} == {"a.bin", "b.bin", "c.bin"}
    (fleet_entry,), _ = library.find(*search_condition("vehicle:b"), 100)
    assert [row.vehicle for row in library.flight_rows([fleet_entry])] == ["b"]
    (least,), _ = library.find(*search_condition("vehicle<b"), 100)
    assert least.name == "a.bin", "a vehicle without a given name is compared by its own"
    assert library.find(*search_condition("date<2100"), 100)[1] == 0, "no log has a date"
    library.delete(fleet_entry.id)
    library.add_fleet_logs()
    assert library.find(*ALL, 100)[1] == 2 and len(read_rows(tmp_path)) == 2
    library.change(entries[0].id, note="mine")
    # The store is so while `mavdem track` reads a log that has changed.
    for change in ("update flights set log = 'other'", "delete from logs"):
        library.db.execute(change)
    library._thread_state.fleet_version = None
    library.add_fleet_logs()
    assert library.entry(entries[0].id).note == "mine"
    library.db.execute("update flights set row = '['")
    with serving(tmp_path) as server:
        for path in ("/", f"/f/{entries[0].id}"):
            assert server.get(path).status == 200


@mark.slow
def test_a_vehicle_without_a_name_is_called_by_its_type_and_the_end_of_its_serial(tmp_path):
    serial = "001a002f3039511333333539"
    reason = "Motor 1 lost about 25 % of its thrust (20 to 29 %). Some motor lost thrust."
    anomaly = {"health": "fault", "health_reason": reason, "fault_probability": 0.995}
    flights = [flight_row(serial, 0), flight_row(serial, 1, suspect_motor=1, **anomaly)]
    flights = [replace(flight, frame="HEXAROTOR") for flight in flights]
    unread = flight_row("quad 8", 2, status="No flight.", flight_time=None, headline_level=None)
    crash = {
        "headline": "It fell.",
        "headline_level": "bad",
        "next_step": "Do not fly. Set A to 1.",
    }
    fleet_of(tmp_path, [*flights, unread, flight_row("quad 9", 0, **crash)])
    assert Library(tmp_path).vehicle_frames[serial] == "HEXAROTOR"
    with serving(tmp_path) as server:
        assert '<a href="/vehicles">Vehicles (3)</a>' in server.get("/").text
        page = server.get("/vehicles").text
        page_of_vehicle = server.get(f"/vehicle?name={serial}").text
    # The page of the vehicle states the motor once.
    page_of_vehicle = page_of_vehicle.replace("\N{NO-BREAK SPACE}", " ")
    blocks = page_of_vehicle.partition('<section class="blocks">')[2].partition("</section>")[0]
    assert "<strong>Motor 1 lost about 25 % of its thrust (20 to 29 %).</strong>" in blocks
    assert "Why:" not in blocks and "probability" not in blocks
    assert blocks.count("Motor 1 lost") == 1
    assert ">Hexarotor 001a…\N{WORD JOINER}333539</a>" in page and f'title="{serial}"' in page
    assert '<td data-label="logs">2</td>' in page
    # The table of vehicles has the first action of a long next step.
    assert '<td class="next" title="Do not fly. Set A to 1.">Do not fly. Set A to 1.</td>' in page
    # An anomaly of the motors is stated as on the flight's page.
    assert '<span class="said bad">Motor 1 lost about 25' in page
    assert (
        'href="/vehicle?name=quad%208" title="quad 8">quad 8</a><span class="said unknown">No flight.'
        in page
    )


def test_a_date_in_the_future_is_no_date():
    future = datetime.now(UTC) + timedelta(days=500)
    entry = LibraryEntry("id", "a.bin", stage=Stage.DONE, level="good")
    row = flight_row("quad", 0, date=future, simulated=1)
    entry = replace(entry, **columns_of_flight([row]))
    assert entry.date == "" and entry.future_date.startswith(f"{future.year}-")
    page = library_page([entry])
    assert f">clock in {future.year}<" in page and ">simulated<" in page
    soon = datetime.now(UTC) + timedelta(hours=14)
    assert columns_of_flight([flight_row("quad", 0, date=soon)])["future_date"] == ""


@mark.slow
def test_a_library_of_an_earlier_version_knows_which_vehicles_are_unnamed(tmp_path):
    """Three columns on the vehicle are missing in the index, and are filled from the fleet's rows."""
    fleet_of(
        tmp_path,
        [
            flight_row("px4-1", 1, vehicle_basis="system id", frame="QUADROTOR", autopilot="PX4"),
            flight_row("serial", 2, vehicle_basis="board"),
        ],
    )
    library = Library(tmp_path)
    library.add_fleet_logs()
    columns = ("vehicle_basis", "frame", "autopilot")
    for column in columns:
        library.db.execute(f"alter table entries drop column {column}")
    library.close()
    entries = {entry.vehicle: entry for entry in Library(tmp_path).find(*ALL, 9).entries}
    assert [getattr(entries["px4-1"], column) for column in columns] == [
        "system id",
        "QUADROTOR",
        "PX4",
    ]
    assert not entries["serial"].is_vehicle_unnamed


@mark.slow
def test_an_altered_index_removes_and_shows_nothing_outside(tmp_path):
    """The index of the library is altered to name files outside its folder.

    They are neither deleted nor shown, and the entries are mended.
    """
    (tmp_path / "photos" / "mine").mkdir(parents=True)
    (tmp_path / "secret.html").write_text("<main>\nSecret")
    library = Library(tmp_path / "served")
    away, unkept, outside_log, page, lost = (
        stored_entry(library, f"{number}.", keep=number != 1) for number in range(5)
    )
    claimed = library.claim(), library.claim()
    for entry in (away, unkept):
        library.change(entry.id, digest="../../photos", path=f"../photos/mine/{entry.id}.ulg")
    library.change(outside_log.id, path="")
    library.change(page.id, digest="", path="../secret.html", files="../secret.html")
    library.change(lost.id, digest="", note="of mine")
    assert library.claim().id == outside_log.id and library.claim() is None
    library.delete(away.id)
    library.delete(outside_log.id)
    for entry in (claimed[0], library.entry(unkept.id)):
        library.finish_reading(entry, outcome_of(Job("none.ulg"), read_made_up), LIMITS)
    assert (tmp_path / "photos" / "mine").is_dir()
    remaining_names = {path.name for path in (library.folder / "logs").iterdir()}
    assert remaining_names == {entry.digest for entry in (unkept, page, lost)}
    with serving(library.folder) as server:
        mended = server.library.entry(lost.id)
        assert (mended.digest, mended.note) == (lost.digest, "of mine")
        server.library.change(page.id, stage=Stage.DONE)
        for address in ("", "/log"):
            assert "Secret" not in server.get(f"/f/{page.id}{address}").text
        compare = f"/compare?a={page.id}&b={lost.id}"
        # The log of one of them is only now read again.
        assert "is still being read" in server.get(compare).text
        server.library.change(lost.id, stage=Stage.DONE)
        assert server.get(compare).status == 200


@mark.parametrize("order", ListingOrder)
def test_no_row_is_read_that_is_not_shown(library, order):
    """What it takes in time is in tools/bench/serve.py."""
    query = f"explain query plan select rowid from entries where 1 order by {order_sql(order)}"
    steps = [row["detail"] for row in library.db.execute(query)]
    (step,) = [step for step in steps if step.startswith(("SCAN entries", "SEARCH entries"))]
    assert "COVERING INDEX" in step
    for step in steps:
        if step.startswith(("SCAN flights", "SEARCH flights")):
            # Rows of flights that are no anomaly are not read either.
            assert "flights_with_anomaly" in step


@mark.slow
def test_flights_are_listed_by_upload_or_by_date_with_undated_ones_last(library):
    dates = ("2026-01-02T00:00:00", "", "2026-01-03T00:00:00")
    ids = []
    for number, date in enumerate(dates):
        entry = stored_entry(library, f"{number}.")
        ids.append(library.change(entry.id, date=date, received=float(number)).id)
    by_upload, total = library.find(*ALL, 2, offset=1)
    assert [entry.id for entry in by_upload] == [ids[1], ids[0]] and total == 3
    by_flight, _ = library.find(*ALL, 3, order=ListingOrder.FLIGHT)
    assert [entry.id for entry in by_flight] == [ids[2], ids[0], ids[1]]
    oldest_first, _ = library.find(*ALL, 3, order=ListingOrder.FLIGHT, is_reversed=True)
    assert [entry.id for entry in oldest_first] == [ids[0], ids[2], ids[1]]


@mark.slow
def test_the_most_urgent_flights_come_first_and_unread_logs_last_in_every_order(library):
    """A library of an earlier version has the levels of headlines only."""
    levels = (Level.GOOD, Level.BAD, Level.WATCH)
    ids = []
    for number, level in enumerate(levels):
        entry = stored_entry(library, f"{number}.")
        urgency = urgency_of_headline(level, None)
        columns = {"stage": Stage.DONE, "level": level, "urgency": urgency}
        ids.append(library.change(entry.id, **columns, received=float(number)).id)
    unread = stored_entry(library, "unread.")
    library.change(unread.id, stage=Stage.FAILED, received=9.0)
    # In lists a new log, without a verdict, comes after the flights that have one.
    new = stored_entry(library, "new.")
    for order in (ListingOrder.URGENCY, ListingOrder.UPLOAD):
        listed = library.find(*ALL, 5, order=order, judged_first=True).entries
        assert [entry.id for entry in listed[3:]] == [new.id, unread.id]
    assert library.find(*ALL, 1).entries[0].id == new.id
    library.delete(new.id)
    for order, expected in (
        (ListingOrder.URGENCY, [ids[1], ids[2], ids[0], unread.id]),
        (ListingOrder.UPLOAD, [ids[2], ids[1], ids[0], unread.id]),
    ):
        assert [entry.id for entry in library.find(*ALL, 4, order=order).entries] == expected
    library.db.execute("drop index by_urgency_and_flight")
    library.db.execute("alter table entries drop column urgency")
    create_or_update_table(library.db)
    by_urgency = library.find(*ALL, 4, order=ListingOrder.URGENCY).entries
    assert [entry.id for entry in by_urgency] == [ids[1], ids[2], ids[0], unread.id]


@mark.slow
def test_flights_are_sorted_and_found_by_flight_time_distance_and_height(library):
    """Flights without a value come last in each order, and are not found by it."""
    figures = ((80.0, 500.0, None), (None, None, None), (620.0, 40.0, 12.0), (61.0, None, 90.0))
    ids = []
    for number, (flight_time, distance, height) in enumerate(figures):
        entry = stored_entry(library, f"{number}.")
        columns = {"flight_time": flight_time, "distance": distance, "height": height}
        columns |= {"wind_speed": height, "vehicle": "ab"[number % 2]}
        ids.append(library.change(entry.id, **columns, received=float(number)).id)
    # The list shows 2.0 to 3.0 m/s.
    library.change(ids[0], wind_low=1.98, wind_high=3.04)
    for order, expected in (
        (ListingOrder.TIME, [2, 0, 3, 1]),
        (ListingOrder.DISTANCE, [0, 2, 3, 1]),
        (ListingOrder.HEIGHT, [3, 2, 1, 0]),
        (ListingOrder.WIND, [3, 2, 1, 0]),
        (ListingOrder.VEHICLE, [3, 1, 2, 0]),
    ):
        entries = library.find(*ALL, 4, order=order).entries
        assert [ids.index(entry.id) for entry in entries] == expected
    shortest_first = library.find(*ALL, 4, order=ListingOrder.TIME, is_reversed=True).entries
    assert [ids.index(entry.id) for entry in shortest_first] == [3, 0, 2, 1]
    for search, expected in (
        ("time>60", {0, 2, 3}),
        ("time>60 height<50", {2}),
        ("distance>100", {0}),
        ("wind>=2 wind<=3", {0}),
    ):
        entries = library.find(*search_condition(search), 4).entries
        assert {ids.index(entry.id) for entry in entries} == expected


def test_a_vehicle_is_found_by_a_part_of_its_serial_number_or_of_its_given_name(library):
    entry = stored_entry(library, "a.")
    library.change(entry.id, vehicle="001a002f3039511333333539")
    library.name_vehicle("001a002f3039511333333539", "Red quad")
    for search, count in (
        ("vehicle:333539", 1),
        ('vehicle:"Red quad"', 1),
        ('vehicle:"Red hexa"', 0),
        ("vehicle=333539", 0),
    ):
        assert library.find(*search_condition(search), 1).total == count, search


@mark.slow
def test_a_log_of_several_flights_has_a_line_of_each_which_leads_to_its_time(library):
    """The log has three flights, the last two after a restart."""
    flights = [FlownFlight(0, 32.0, 45.0, None, 3.1), FlownFlight(1, 12.5, 72.5, 1250.0, None)]
    flights.append(FlownFlight(1, 80.0, 90.0, 5.0, None))
    entry = LibraryEntry(
        *("id", "a.bin"),
        stage=Stage.DONE,
        level="good",
        flight_time=73.0,
        distance=1250.0,
        height=3.1,
        flights=json.dumps([asdict(flight) for flight in flights]),
    )
    page = library_page([entry])
    assert ">1:13<" in page and page.count(">1.2 km<") == 2 and page.count(">3 m<") == 2
    assert 'href="/f/id#t=12.5">Flight 2</a>' in page and page.count("after restart 1") == 1
    assert page.count('title="Not known: the log has no position of most of the flight."') == 1
    alone = replace(entry, flights=json.dumps([asdict(flights[0])]))
    assert "Flight 1" not in library_page([alone])
    # So has one of several vehicles a line of each further one, which leads to its page.
    shared = replace(alone, files="report.html,vehicle_3_1.html")
    assert '<a href="/f/id?vehicle=3_1">Vehicle 3:1</a>' in library_page([shared])
    page = "<p>Vehicle 2:1, one of 2 in the log: quadrotor.</p>"
    assert vehicle_id_on_page(page) == "2:1" and vehicle_id_on_page("<p>Quadrotor.</p>") == ""


@mark.slow
def test_a_library_of_an_earlier_version_opens_and_what_is_new_stands_first(library, tmp_path):
    """The index lacks a column, has another, or is a separate file."""
    first = stored_entry(library)
    AtOnce(library).run()
    library.db.execute("alter table entries drop column next_step")
    library.db.execute("alter table entries add column sorted_by default ''")
    library.close()
    again = Library(tmp_path)
    second = stored_entry(again, "Two.")
    assert [entry.id for entry in again.find(*ALL, 2)[0]] == [second.id, first.id]
    assert again.entry(first.id).next_step == ""
    again.db.execute("attach ? as earlier", [str(tmp_path / "library.sqlite")])
    again.db.execute("create table earlier.entries as select * from main.entries")
    again.db.execute("detach earlier")
    again.db.execute("drop table entries")
    release_lock(again)
    last = Library(tmp_path)
    assert last.find(*ALL, 2) == ([last.entry(second.id), last.entry(first.id)], 2)
    assert not (tmp_path / "library.sqlite").exists()


def test_stored_file_names_cannot_leave_their_folder():
    """Names with paths, control characters, excessive length or reserved words become plain names.

    Others stay as they are.
    """
    for name in (
        "../../x",
        "..",
        "",
        "/",
        "a/b.ulg",
        "\0",
        "x" * 5000,
        "ü\udcff" * 200,
        "CON",
        ".hidden",
    ):
        plain = stored_file_name(name)
        assert plain not in ("", ".", "..") and not set(plain) & set("/\\\0")
        assert len(plain.encode()) <= 150
    assert stored_file_name("Flug über (2).ulg") == "Flug über (2).ulg"
    assert stored_file_name("C:\\logs\\a b.tlog") == "C__logs_a b.tlog"
    assert [
        stored_file_name(name) for name in ("NUL", "aux.tlog", "Com1.bin.", "auxiliary.bin")
    ] == [
        "_NUL",
        "_aux.tlog",
        "_Com1.bin",
        "auxiliary.bin",
    ]


def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    assert unreadable(Library, tmp_path / "file").code is StartFailure.FOLDER_NOT_WRITABLE


@mark.slow
def test_an_address_that_is_taken_is_refused(tmp_path):
    with serving(tmp_path / "one") as server, raises(Unreadable) as refused:
        options = ServerOptions(
            tmp_path / "two", "127.0.0.1", server.port, "", False, None, 1, LIMITS, None, None
        )
        serve(options, print, print, print, print, opens_browser=False)
    assert refused.value.fact.code is StartFailure.ADDRESS_NOT_FREE
    assert not (tmp_path / "two").exists()


@mark.slow
def test_a_log_is_read_with_its_page_rows_and_index(library, tmp_path, monkeypatch):
    """A real log is read in this process, with a second vehicle added to it."""
    monkeypatch.setattr("mavdem.serve.reading.lower_priority", lambda _: None)
    entry = library.add(Path(shutil.copy(SLOW, library.new_incoming_path())), SLOW.name)
    log = read_log(SLOW)
    other_vehicle = replace(log.vehicles[0], system=2)
    log_of_two = replace(log, source=SLOW.name, vehicles=(*log.vehicles, other_vehicle))
    monkeypatch.setattr("mavdem.serve.reading.read_log", lambda _: log_of_two)
    outcome = outcome_of(Job(str(library.log_path(entry))), read_for_library)
    library.finish_reading(library.claim(), outcome, LIMITS)
    entry = library.entry(entry.id)
    # The dashboard, which is made when it is asked for, has the flight alone.
    files_in_order = [RECORDING_FILE, PAGE_FILE, REPORT_FILE, "vehicle_2_1.html"]
    assert entry.file_names == files_in_order
    assert entry.headline and entry.lights["log"] == "watch" and entry.next_step
    assert entry.flight_time == sum(flight.duration for flight in entry.flown_flights) > 10
    rows = library.flight_rows([entry])
    assert [(row.system, row.axis) for row in rows[1:3]] == [(1, "pitch"), (2, "roll")]
    assert (
        "ehicle 1:1, one of 2 in the log" in (library.results_folder(entry) / PAGE_FILE).read_text()
    )
    assert rows[0].headline == entry.headline and rows[0].page.endswith(
        f"{entry.digest}/{PAGE_FILE}"
    )
    for path in library.results_folder(entry).iterdir():
        assert str(tmp_path).encode() not in path.read_bytes()
    assert (
        f"<h1>{SLOW.name.replace('_', '_<wbr>')}</h1>"
        in (library.results_folder(entry) / PAGE_FILE).read_text()
    )
    assert library.progress_columns(entry) == {}


@mark.slow
def test_a_log_whose_package_is_missing_is_kept_and_read_when_it_comes_again(library):
    entry = stored_entry(library, name="extra.ulg")
    path = library.log_path(entry)
    library.finish_reading(library.claim(), outcome_of(Job(str(path)), rows_of_log), LIMITS)
    failed = library.entry(entry.id)
    assert failed.stage == Stage.FAILED and path.is_file() and failed.size == path.stat().st_size
    assert failed.problem == "The log needs mcap: pip install 'mavdem[mcap]'."
    assert stored_entry(library, name="extra.ulg").stage == Stage.WAITING


@mark.slow
def test_a_log_whose_page_fails_keeps_headline_lights_and_log(library):
    entry = stored_entry(library, name="bug.ulg")
    path = library.log_path(entry)
    unfinished_folder = library.results_folder(entry).with_name(f".{entry.digest}")
    unfinished_folder.mkdir()
    judgement = {"headline": "Motor 3 lost thrust.", "level": "bad", **dict.fromkeys(Light, "good")}
    (unfinished_folder / PROGRESS).write_text(json.dumps(judgement))
    library.finish_reading(library.claim(), outcome_of(Job(str(path)), rows_of_log), LIMITS)
    failed = library.entry(entry.id)
    assert failed.stage == Stage.FAILED and failed.size == path.stat().st_size
    page = library_page([failed], {})
    assert "Motor 3 lost thrust." in page and 'aria-label="power good"' in page
    assert "Its page is missing. This should not have happened" in page


@mark.slow
def test_a_log_waits_for_a_cluster_that_has_gone(library, tmp_path, monkeypatch):
    """The cluster cannot be reached twice, and then has too many open files twice."""
    monkeypatch.setattr("mavdem.serve.reading_threads.RETRY_SECONDS", 0.01)
    stored_entry(library)
    tries = []

    def read(job, limits, function):
        tries.append(function)
        if len(tries) < 3:
            raise Unreadable(Fact(ReadingFact.NO_SCHEDULER, address="tcp://a:1"))
        if len(tries) < 5:
            raise OSError(errno.EMFILE, "Too many open files")
        return outcome_of(job, read_made_up)

    work = ReadingThreads(library, 1, LIMITS, cluster=Mock(read=read))
    work.start()
    until(lambda: library.find(*search_condition("stage:done"), 1)[1])
    work.stop()
    assert {*tries} == {read_for_library}
    work._publish_table(None)
    assert [*tmp_path.rglob("*.parquet")]


@mark.slow
def test_a_log_that_the_disk_had_no_room_for_does_not_hold_up_others(library):
    large, small = stored_entry(library), stored_entry(library, "Two.")
    library.change(large.id, received="2026-11-20T10:00:00", problem="The disk is full.")
    library.change(small.id, received="2026-11-21T10:00:00")
    assert [library.claim().id for _ in range(2)] == [small.id, large.id]


@mark.slow
def test_a_log_that_the_disk_had_no_room_for_is_read_when_there_is_some(library, monkeypatch):
    """The disk is full, and then the quota is used up, before the log can be read."""
    monkeypatch.setattr("mavdem.serve.reading_threads.RETRY_SECONDS", 0.01)
    monkeypatch.setattr("mavdem.serve.reading_threads.FULL_DISK_SECONDS", 0.05)
    entry = stored_entry(library)
    read_logs = []

    def read_with_little_room(path, key, page):
        read_logs.append((library.entry(entry.id).stage, library.entry(entry.id).problem))
        if len(read_logs) == 1:
            raise OSError(errno.ENOSPC, "No space left on device")
        if len(read_logs) == 2:
            raise Unreadable(Fact(ReadingFact.NO_VEHICLE)) from OSError(errno.EDQUOT, "Quota")
        return read_made_up(path, key, page)

    def read(job, limits, function):
        return outcome_of(job, read_with_little_room)

    work = ReadingThreads(library, 1, LIMITS, cluster=Mock(read=read))
    work.start()
    until(lambda: library.find(*search_condition("stage:done"), 1)[1])
    work.stop()
    full = (Stage.READING, "The disk of the server is full.")
    assert read_logs == [(Stage.READING, ""), full, full]
    assert library.entry(entry.id).problem == ""


@mark.in_full
def test_processes_read_logs_within_limits_and_go_on_after_a_hostile_one(library):
    """The first of two logs makes its process crash."""
    names = ("crash.ulg", "sound.ulg")
    for name in names:
        stored_entry(library, name, name, keep=1)
    work = ReadingThreads(library, 1, JobLimits(1, 600), read=rows_of_log)
    work.start()
    work.notify()
    until(lambda: library.find(*search_condition("stage:failed"), 10)[1] == len(names))
    work.stop()
    entries, _ = library.find(*ALL, 10)
    assert all(entry.problem for entry in entries if entry.name != "sound.ulg")


def test_the_suspected_motor_of_a_fleet_log_is_that_of_any_of_its_rows():
    rows = [flight_row("quad", 1), flight_row("quad", 1, axis="pitch", suspect_motor=3)]
    assert entry_of_fleet_log("flight.ulg", rows).motor == 3


def test_a_motor_that_failed_in_a_flight_comes_before_a_suspected_one():
    row = flight_row("quad", 1, suspect_motor=3, failed_motor=2)
    assert entry_of_fleet_log("flight.ulg", [row]).motor == 2


def test_a_motor_that_failed_on_the_second_vehicle_of_a_log_is_shown():
    rows = [flight_row("quad", 1, suspect_motor=3), flight_row("hexa", 1, failed_motor=2)]
    assert entry_of_fleet_log("flight.tlog", rows).motor == 2


def test_the_link_of_a_fleet_s_page_to_its_index_is_what_the_server_takes_out():
    page = render_document("a.bin", "", [], back=PageLink("Fleet", "../index.html"))
    assert page.count(LINK_TO_FLEET_HTML) == 1


def test_a_flight_is_best_compared_with_a_sound_one_in_like_conditions():
    """A hover is compared with a hover, and a straight flight with a straight one; a finding counts for more."""

    def flight(name, distance, wind_speed=2.0, **columns):
        columns = {"flight_time": 60.0, "level": "good", "motors": "good"} | columns
        wind = {"wind_low": wind_speed - 1, "wind_high": wind_speed + 1}
        return LibraryEntry(name, name, distance=distance, content=name, **wind | columns)

    hover = flight("hover", 5.0)
    straight, windy = flight("straight", 300.0), flight("windy", 300.0, wind_speed=9.0)
    watched = flight("watched", 305.0, level="watch", vibration="watch")
    weak = flight("weak", 305.0, motors="watch", level="watch")
    others = [hover, straight, windy, watched, weak]
    assert most_similar_flight(flight("x", 310.0), others) is straight
    assert most_similar_flight(flight("x", 310.0, wind_speed=8.0), others) is windy
    assert most_similar_flight(flight("x", 4.0), others) is hover
    assert most_similar_flight(flight("x", 310.0), [hover, watched, weak]) is hover
    assert most_similar_flight(flight("x", 310.0), [watched, weak]) is watched
    # What a user marked as healthy counts as sound.
    assert most_similar_flight(flight("x", 305.0), others, {"watched"}) is watched
    # A simulated flight is no partner of a real one, nor is one in a wind that is not known if another's is.
    simulated = replace(straight, simulated=1)
    assert most_similar_flight(straight, [simulated, hover]) is hover
    unknown_wind = replace(straight, wind_low=None, wind_high=None)
    assert most_similar_flight(flight("x", 310.0), [unknown_wind, straight]) is straight
    # Where nothing is known of the flight, the first of the sound ones is taken, which is the latest.
    assert most_similar_flight(LibraryEntry("x", "x"), [windy, straight]) is windy
    assert most_similar_flight(hover, []) is None
