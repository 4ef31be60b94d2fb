"""The server: uploads in Flight Review's form, the library, sharing, and what is refused."""

import asyncio
import errno
import json
import os
import re
import resource
import shutil
import socket
import sqlite3
import time
from contextlib import ExitStack, contextmanager
from http.client import HTTPResponse
from pathlib import Path
from shutil import rmtree
from types import SimpleNamespace
from unittest.mock import Mock
from urllib.parse import urlencode

import command_line
import numpy as np
from browsing import HOSTILE
from patience import until
from pytest import fixture, mark, raises
from recorded_flights import FLIGHT
from refusals import unreadable
from serving import BOUNDARY, LIMITS, TOKEN, form, log, serving

from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.serve import RefusalReason, Sharing, Stage, StartFailure
from mavdem.facts.sources import SourceFact
from mavdem.fleet.row import FlightRow
from mavdem.fleet.workers import Job, failed
from mavdem.report.pages.library_page import interface_words
from mavdem.results import PAGE_FILE
from mavdem.serve import api, listening, uploads, visible_library
from mavdem.serve.guard import POLICY_HEADER
from mavdem.serve.index import columns_of_flight
from mavdem.serve.library import Library
from mavdem.serve.rights import Rights, rights_for_host
from mavdem.serve.stored_files import refuse_full_disk
from mavdem.serve.stored_parameters import write_parameters
from mavdem.serve.viewers import RecordingViewer
from mavdem.serve.visible_library import VisibleLibrary


@fixture
def served(tmp_path):
    with serving(tmp_path) as server:
        yield server


@fixture
def guarded(tmp_path, monkeypatch):
    """A server with a token; how late it answers a wrong one has a test of its own."""
    monkeypatch.setattr("mavdem.serve.rights.WRONG_TOKEN_DELAY", 0.01)
    with serving(tmp_path, TOKEN) as server:
        yield server


UPLOAD_LOG = {"type": "flightreport", "description": "A walk", "feedback": "", "public": "true"}
"""What PX4's upload_log.py sends; QGroundControl sends the same fields and more."""
LOGLOADER = {"source": "auto", "email": "", "public": "false", "version": "1"}


@mark.slow
@mark.parametrize("fields", [UPLOAD_LOG, LOGLOADER])
def test_an_upload_as_flight_review_has_it_is_answered_by_the_page(served, fields):
    answer = served.upload(("a.ulg", log("Sound.")), path="/upload", fields=fields)
    assert answer.status == 302 and not answer.text
    location = answer.headers["Location"]
    assert re.fullmatch(r"/f/[\w-]{22}", location)
    assert "Sound." in served.get(location).text
    entry = served.library.entry(location.removeprefix("/f/"))
    assert entry.sharing == (Sharing.PUBLIC if fields["public"] == "true" else Sharing.LINK)
    assert entry.note == fields.get("description", "")


@mark.slow
def test_an_uploaded_log_is_listed_with_its_review(served):
    """Two made-up logs are uploaded: list, document, log and report have what the first one contains."""
    answer = served.upload(("a.ulg", log("One.")), ("b.ulg", log("Two.")))
    assert answer.status == 201 and [entry["name"] for entry in answer.json["flights"]] == [
        "a.ulg",
        "b.ulg",
    ]
    listed = served.get("/api/flights").json
    assert listed["total"] == 2
    entry = next(flight for flight in listed["flights"] if flight["name"] == "a.ulg")
    assert (entry["stage"], entry["level"], entry["lights"]["motors"]) == (
        Stage.DONE,
        "bad",
        "watch",
    )
    assert (entry["modes"], entry["vehicle"]) == (["Loiter", "Land"], "quad 7")
    flight_document = served.get(f"/api/flights/{entry['id']}").json
    assert flight_document["flight"] == entry and flight_document["review"]["headline"] == "One."
    assert served.get(f"/f/{entry['id']}/log").text == log("One.").decode()
    assert served.get(f"/f/{entry['id']}/report.json").json == {"headline": "One."}
    assert {"model.json", "../fleet.sqlite"}.isdisjoint(entry["files"])


@mark.slow
def test_the_same_log_again_has_the_same_link_which_only_who_may_write_opens(guarded):
    """A private log is uploaded again. The link for uploads must not open it, while its owner shares it."""
    id = guarded.add("a.ulg", "Same.", token=TOKEN)
    key = rights_for_host("", TOKEN, is_behind_proxy=False).derived_key("upload")
    for path, token, expected_flags in (
        (f"/{key}/upload", "", ("private", "")),
        ("/upload", TOKEN, ("link", "A walk")),
    ):
        fields = {"description": "A walk"}
        answer = guarded.upload(("b.ulg", log("Same.")), path=path, token=token, fields=fields)
        entry = guarded.library.entry(id)
        assert (
            answer.headers["Location"] == f"/f/{id}"
            and (entry.sharing, entry.note) == expected_flags
        )


@mark.slow
def test_a_log_that_cannot_be_read_says_why_and_is_kept_as_asked(served):
    """A damaged log is stored only if its uploader wants that."""
    kept_answer, gone = (
        served.upload((f"{keep}.ulg", log(f"damaged {keep}")), fields={"keep": keep}).json[
            "flights"
        ][0]["id"]
        for keep in ("true", "false")
    )
    entries = [served.library.entry(id) for id in (kept_answer, gone)]
    assert [entry.stage for entry in entries] == [Stage.FAILED] * 2
    assert all(entry.problem for entry in entries)
    assert served.library.log_path(entries[0]).is_file() and entries[1].size == 0
    assert [served.get(f"/f/{id}/log").status for id in (kept_answer, gone)] == [200, 404]
    assert len(list((served.library.folder / "logs").iterdir())) == 1
    assert entries[1].problem in served.get(f"/f/{gone}").text


@mark.slow
def test_a_file_that_is_no_log_is_refused_with_its_name(served):
    letters = [(name, b"Dear all, this is text.") for name in ("a.txt", "b.txt")]
    for path in ("/api/logs", "/upload"):
        answer = served.upload(*letters, path=path)
        assert answer.status == 415 and answer.code == SourceFact.FORMAT_UNKNOWN
    answer_to_both = served.upload(("letter.txt", b"text"), ("a.ulg", log("One."))).json
    assert [refusal["name"] for refusal in answer_to_both["refused"]] == ["letter.txt"] and len(
        answer_to_both["flights"]
    ) == 1
    assert list((served.library.folder / "incoming").iterdir()) == []


@mark.slow
def test_other_files_are_refused_at_once_whatever_their_name(served):
    """Other formats, noise and an empty file are refused, but a log with damage at its beginning is not."""
    noise = np.random.default_rng(1).bytes(100_000)
    files = {
        "letter.pdf": b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n" + noise,
        "picture.jpg": b"\xff\xd8\xff\xe0" + noise,
        "flight.tlog": noise,
        "empty.bin": b"",
    }
    for name, content in files.items():
        refused = served.upload((name, content))
        assert refused.status == 415 and name in refused.json["error"]["reason"]
    assert refused.json["error"]["reason"] == "empty.bin is empty: nothing was recorded."
    assert served.get("/api/flights").json["total"] == 0
    # The frames of a telemetry log begin after some damage.
    assert served.upload(("a", noise[:1000] + FLIGHT.read_bytes()[:100_000])).status == 201
    assert served.upload(("", b"")).code == RefusalReason.UPLOAD_WITHOUT_LOG


@mark.slow
def test_a_log_that_cannot_be_read_is_not_kept_unless_asked(served):
    id = served.add("a.ulg", "damaged")
    entry = served.library.entry(id)
    assert (entry.stage, entry.size) == (Stage.FAILED, 0)
    assert "The log was not kept." in served.get(f"/f/{id}").text


@mark.slow
def test_progress_is_streamed_until_all_logs_are_read(tmp_path, monkeypatch):
    """The server limits how many clients may follow the progress at a time."""
    with serving(tmp_path, is_eager=False) as server:
        id = server.add("a.ulg", "One.")
        assert interface_words()["stages"][Stage.WAITING] in server.get(f"/f/{id}").text
        # A log to be read is the newest upload. In other orders it stands last, and is counted above the list.
        note = "1 log is still to be read"
        assert note not in server.get("/").text
        server.library.change(id, stage=Stage.DONE)
        later = server.add("b.ulg", "Two.")
        listed = server.get("/").text
        assert note not in listed and listed.index("b.ulg") < listed.index("a.ulg")
        listed = server.get("/?sort=flight").text
        assert note in listed and listed.index("a.ulg") < listed.index("b.ulg")
        # So do the logs of a whole folder.
        monkeypatch.setattr(visible_library, "MAX_UNREAD_LOGS_ON_TOP", 0)
        listed = server.get("/?sort=upload").text
        assert note in listed and listed.index("a.ulg") < listed.index("b.ulg")
        server.library.delete(later)
        server.library.change(id, stage=Stage.WAITING)
        with monkeypatch.context() as patch:
            patch.setattr(api, "MAX_PROGRESS_STREAMS", 0)
            full = server.get(f"/api/progress?id={id}")
            assert full.refusal == (503, RefusalReason.UPLOADS_TOO_MANY)
        server.work.run()
        monkeypatch.setattr(api, "MAX_PROGRESS_STREAMS", 1)
        for _ in range(2):
            answer = server.get(f"/api/progress?id={id}")
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        first, end, _ = answer.text.split("\n\n")
        (progress,) = json.loads(first.removeprefix("data: "))
        assert (progress["stage"], progress["headline"]) == (Stage.DONE, "One.") and end.startswith(
            "event: end"
        )


def total(served, search):
    return served.get(f"/api/flights?{urlencode({'q': search})}").json["total"]


@mark.slow
def test_a_flight_is_changed_found_and_deleted(served):
    """Searches by note, tag, mode, light, motor, parameter, date and wind find what was stored.

    A deleted flight leaves no file.
    """
    id = served.add("a.ulg", "One.")
    served.add("b.ulg", "Two.")
    tags = ["race", "new"]
    changes = {"note": "Gusty", "tags": tags}
    assert served.ask("PATCH", f"/api/flights/{id}", changes).json["tags"] == tags
    assert "stated on" not in served.get(f"/f/{id}").text
    repair = served.ask("PATCH", f"/api/flights/{id}", {"repaired": True}).json["repaired"]
    assert repair.endswith("+00:00")
    # It is shown with its date, which stays where it is stated again, and can be taken back.
    assert f"stated on {repair[:10]}" in served.get(f"/f/{id}").text
    assert f"Repaired: stated on {repair[:10]}" in served.get("/").text
    served.library.change(id, repaired="2026-11-28T09:15:00+00:00")
    again = served.ask("PATCH", f"/api/flights/{id}", {"repaired": True, "note": "Gusty"})
    assert again.json["repaired"] == "2026-11-28T09:15:00+00:00"
    taken_back = served.ask("PATCH", f"/api/flights/{id}", {"repaired": False})
    assert taken_back.json["repaired"] == ""
    assert [
        total(served, search)
        for search in (
            "gusty",
            "tag:race",
            "mode:loiter one",
            "motors:watch",
            "MC_ROLL_P>6",
            "date>=2026-11",
        )
    ] == [1, 1, 1, 2, 2, 2]
    served.library.change(id, motor=3, wind_speed=4.5)
    assert [total(served, search_term) for search_term in ("motor:3", "motor:2", "wind<5")] == [
        1,
        0,
        1,
    ]
    # The order that was chosen last is kept by the browser, in a cookie.
    cookie = served.get("/?sort=wind").headers["Set-Cookie"]
    chosen = '<option value="wind" selected>'
    assert cookie.startswith("order=wind;") and chosen in served.get("/", Cookie=cookie).text
    assert chosen not in served.get("/").text
    # A second choice of the same heading reverses the order, which the browser keeps, too.
    page = served.get("/", Cookie=cookie).text
    assert 'aria-sort="descending"><a href="?q=&amp;sort=-wind">' in page
    reversed_order = served.get("/?sort=-wind")
    assert reversed_order.headers["Set-Cookie"].startswith("order=-wind;")
    assert 'aria-sort="ascending"><a href="?q=&amp;sort=wind">' in reversed_order.text
    assert served.get("/flights").headers["Location"] == "/"
    # With an interval, the whole of it is above or below, and a speed within it is equal, whatever the light.
    served.library.change(id, wind="unknown", wind_low=3.3, wind_high=5.7)
    assert 'title="wind: unknown, but for the bounds 3.3 to 5.7 m/s"' in served.get("/").text
    searches = ("wind>3", "wind>4", "wind<5", "wind<6", "wind:5", "wind:6")
    assert [total(served, search_term) for search_term in searches] == [1, 0, 0, 1, 1, 0]
    served.library.change(id, motor=None, headline="Motor 12 (rear left) lost 4 to 12 %.")
    assert [total(served, search_term) for search_term in ("motor:12", "motor:2", "motor:1")] == [
        1,
        0,
        0,
    ]
    # A yaw trim suspects no motor, and names the one that deviates most.
    served.library.change(id, headline="Yaw trim 13 %: motor 1 deviates 14 %.")
    assert total(served, "motor:1") == 0
    watched = FlightRow(file="a.bin", watched_motor=1)
    assert columns_of_flight([watched])["motor"] == 1
    assert total(served, "MC_ROLL_P<6") == total(served, "wind>5") == 0
    # A program is told what a browser shows; a word with a colon may be in a note, such as a time of day.
    unknown = served.get("/api/flights?q=foo:bar")
    assert unknown.refusal == (400, RefusalReason.SEARCH_NOT_UNDERSTOOD)
    shown_hint = served.get("/?q=foo:bar").text.partition('id="problems"')[2]
    # There are no headings of columns without a row.
    assert '<div class="scroll" hidden>' in shown_hint
    for sentence in ("No such term: foo. Terms are vehicle, mode,", "and gains."):
        assert sentence in unknown.text and sentence in shown_hint
    assert served.get("/api/flights?q=motors:").status == 400
    served.ask("PATCH", f"/api/flights/{id}", {"note": "Gusty at 12:30"})
    assert total(served, "12:30") == 1
    assert len(served.get("/api/flights?offset=1").json["flights"]) == 1
    assert served.ask("DELETE", f"/api/flights/{id}").status == 204
    assert served.get(f"/f/{id}").status == 404
    assert served.get("/api/flights").json["total"] == 1
    assert [
        len(list((served.library.folder / part).iterdir())) for part in ("logs", "results")
    ] == [1, 1]
    wrong = served.ask("PATCH", f"/api/flights/{id}", {"sharing": "all"})
    assert wrong.status == 400 and wrong.code == RefusalReason.BAD_REQUEST


@mark.slow
def test_names_are_kept_found_shown_and_taken_away(served):
    """The user names a flight and a vehicle. Names are searched for, shown as text, and removed."""
    first = served.add("first.ulg", "Good.")
    second = served.add("second.ulg", "Bad.")
    changed = served.ask("PATCH", f"/api/flights/{first}", {"given_name": "  First\n hover "})
    assert changed.json["given_name"] == "First hover"
    assert "<h1>First hover <small" in served.get(f"/f/{first}").text
    named = {"vehicle": "quad 7", "name": "Red <b> quad"}
    assert served.ask("PUT", "/api/vehicle", named).json["name"] == "Red <b> quad"
    assert total(served, "quad red") == 2
    assert total(served, "hover") == 1
    flight = served.get(f"/api/flights/{first}").json["flight"]
    assert (flight["vehicle"], flight["vehicle_name"]) == ("quad 7", "Red <b> quad")
    for path in ("/", f"/f/{first}", "/vehicle?name=quad+7", f"/compare?a={first}&b={second}"):
        page = served.get(path).text
        assert "<b> quad" not in page
        assert "Red &lt;b&gt; quad" in page
        assert "First hover" in page
    # A flight that is deleted and uploaded again is another one.
    served.ask("DELETE", f"/api/flights/{first}")
    again = served.add("first.ulg", "Good.")
    assert served.get(f"/api/flights/{again}").json["flight"]["given_name"] == ""
    served.ask("PUT", "/api/vehicle", named | {"name": " "})
    assert total(served, "red") == 0


@mark.slow
def test_names_are_limited_and_need_the_right_to_write(guarded):
    id = guarded.add(token=TOKEN)
    named = {"vehicle": "quad 7", "name": "Mine"}
    assert guarded.ask("PUT", "/api/vehicle", named).code == "no_right"
    site = {"Origin": "http://elsewhere.example"}
    assert guarded.ask("PUT", "/api/vehicle", named, TOKEN, **site).code == "other_site"
    long_name = {"name": "x" * 61}
    assert guarded.ask("PUT", "/api/vehicle", named | long_name, TOKEN).code == "bad_request"
    other_names = named | {"vehicle": "quad 8"}
    assert guarded.ask("PUT", "/api/vehicle", other_names, TOKEN).code == "no_such_flight"
    change = {"given_name": "x" * 61}
    assert guarded.ask("PATCH", f"/api/flights/{id}", change, TOKEN).code == "bad_request"


@mark.slow
def test_two_flights_are_compared_and_a_vehicle_has_its_page_and_baseline(served):
    """Flights of one vehicle, one of them with a weak motor, are compared with each other and with a baseline."""
    a, b = (served.add(f"{name}.ulg", name) for name in ("One.", "Two."))
    compared = served.get(f"/compare?a={a}&b={b}")
    assert compared.status == 200 and "<h1>One..ulg and Two..ulg</h1>" in compared.text
    # It has the bar of all pages, whose last entry is the title on a phone.
    assert 'href="/vehicles">Vehicles (1)' in compared.text
    assert '<span aria-current="page">Two flights compared</span>' in compared.text
    # Flights that an earlier version has read have no stored series.
    assert "time series of A and B, which were not stored" in compared.text
    not_compared = "parameters beside those of control"
    assert not_compared in compared.text
    for flight, action in ((a, 0.0), (b, 3.0)):
        folder = served.library.results_folder(served.library.entry(flight))
        write_parameters(folder, {"COM_LOW_BAT_ACT": action})
    compared = served.get(f"/compare?a={a}&b={b}")
    assert "COM_LOW_BAT_ACT 0 → 3" in compared.text and not_compared not in compared.text
    assert served.ask("PUT", "/api/baseline", {"flights": [a]}).status == 200
    assert {row.headline for row in served.library.store.healthy} == {"One."}
    page = served.get("/vehicle?name=quad%207").text
    assert "One." in page and "the latest log, Two." in page and "lost thrust" not in page
    assert "may be of several vehicles" not in page
    served.add("by_id.ulg", "Known by id alone.")
    assert "may be of several vehicles" in served.get("/vehicle?name=ardupilotmega-1").text
    page = served.get("/vehicles").text
    assert "1 log of unnamed vehicles, to be named: " in page
    assert '<a href="/vehicle?name=ardupilotmega-1" title="ardupilotmega-1">' in page
    weak = served.add("weak.ulg", "A weak motor.")
    for path in ("/vehicle?name=quad%207", "/"):
        page = served.get(path).text
        assert page.count('<span class="said bad" title="Motor 3 lost thrust.">') == 1
    headline = '<p class="headline"><strong>Motor 3 lost thrust.</strong></p>'
    assert [headline in served.get(f"/f/{id}").text for id in (a, weak)] == [False, True]
    assert served.get(f"/compare?a={a}&b={served.add('c.ulg', 'damaged')}").status == 200


@mark.slow
def test_a_flight_with_bad_motors_is_no_baseline_which_is_named_and_removed_again(served):
    """The baseline of another vehicle stays; a search and a flight's document have one level of the motors."""
    sound, other = served.add("sound.ulg", "One."), served.add("other.ulg", "Known by id.")
    weak = served.add("weak.ulg", "A weak motor.")
    refused = served.ask("PUT", "/api/baseline", {"flights": [weak]})
    assert refused.refusal == (409, RefusalReason.MOTORS_BAD) and "weak.ulg" in refused.text
    assert served.library.store.healthy == []
    served.ask("PATCH", f"/api/flights/{other}", {"vehicle_name": "Red"})
    for flight in (other, sound):
        served.library.change(flight, motors="good")
        stored = served.ask("PUT", "/api/baseline", {"flights": [flight]})
        assert stored.status == 200 and stored.json == {"flights": [flight], "caution": ""}
    # Motors that are to be watched are no reason to refuse: the answer has the caution of the page's question.
    served.library.change(sound, motors="watch")
    caution = served.ask("PUT", "/api/baseline", {"flights": [sound]}).json["caution"]
    flights_watched, consequence = caution.split(". ")
    assert flights_watched == "The motors light is “watch” in sound.ulg"
    assert consequence in served.get("/static/serve.js").text
    page = served.get("/vehicle?name=quad%207").text
    assert f'Baseline: <a href="/f/{sound}">sound.ulg</a>.' in page
    assert served.ask("DELETE", "/api/baseline?vehicle=quad%207").status == 204
    assert {row.vehicle for row in served.library.store.healthy} == {"Red"}
    assert (
        "No baseline: its first flights are taken for healthy"
        in served.get("/vehicle?name=quad%207").text
    )
    (flight,) = served.get("/api/flights?q=motors:bad").json["flights"]
    assert (flight["id"], flight["lights"]["motors"]) == (weak, "bad")
    assert flight["motor_anomaly"] == "Motor 3 lost thrust."
    review = served.get(f"/api/flights/{weak}").json["review"]
    assert review["headline"]["sentence"] == "Motor 3 lost thrust."
    assert review["next_step"]["sentence"].startswith("Unless they were replaced, check motors")


@mark.slow
def test_a_comparison_that_ends_after_its_verdict_was_read_is_not_missed(served, monkeypatch):
    """The page then waits for it. So it does for a new baseline; the verdict beside the former one is not shown."""
    other, flight = served.add("other.ulg", "One."), served.add("weak.ulg", "A weak motor.")
    read_verdicts = Library._rows_with_motor_anomaly

    def read_before_the_end(library, entries):
        rows = read_verdicts(library, entries)
        with library.transaction() as db:
            db.execute("update flights set judged = 0 where judged is null")
        return rows

    def begin_again():
        with served.library.transaction() as db:
            db.execute("update flights set judged = null, file = null")

    monkeypatch.setattr(Library, "_rows_with_motor_anomaly", read_before_the_end)
    # As it is once a log was read.
    begin_again()
    entry = served.library.entry(flight)
    assert served.library.compared_entries([entry]).uncompared_ids == {flight}
    for path, note in (
        ("/", "the vehicle’s other flights …"),
        (f"/f/{flight}", 'id="comparing"'),
        (f"/compare?a={other}&b={flight}", "other.ulg and weak.ulg are still being compared"),
    ):
        begin_again()
        assert note in served.get(path).text
    # Good motors are unknown until then, in lists, searches and documents.
    begin_again()
    served.library.change(flight, motors="good")
    assert f'data-id="{flight}"' not in served.get("/?q=motors:good").text
    begin_again()
    assert served.get(f"/api/flights/{flight}").json["flight"]["lights"]["motors"] == "unknown"
    monkeypatch.undo()
    served.work.run()
    assert "Motor 3 lost thrust." in served.get("/").text
    served.library.set_baseline([other])
    listed = served.get("/").text
    assert listed.count("being compared with the baseline …") == 2
    assert "Motor 3 lost thrust." not in listed
    assert "Motor 3 lost thrust." not in served.get(f"/api/flights/{flight}").text
    assert "being compared with the baseline …" in served.get("/vehicle?name=quad%207").text
    served.work.run()
    assert "Motor 3 lost thrust." in served.get("/").text
    # The only flight of a vehicle is compared with none, nor is one without a name, or without figures.
    served.library.remove_baseline("quad 7")
    begin_again()
    served.library.delete(other)
    assert "being compared" not in served.get("/").text


@mark.slow
def test_a_flight_with_a_weak_motor_is_compared_with_a_healthy_one_in_like_conditions(served):
    """Two flights of a vehicle have a weak motor. Its first three sound ones are those that show this.

    All pages link from them to the most similar of these, even with an amber light, and not to a later flight.
    """
    dates = {"first": 16, "second": 17, "alike": 18, "later": 19, "weak before": 20, "weak": 21}
    ids = {}
    for name, day in dates.items():
        ids[name] = served.add(f"{name}.ulg", f"{name} 2026-11-{day}: good.")
        distance = 5.0 if name in ("first", "second") else 300.0
        date = f"2026-11-{day}T10:00:00"
        served.library.change(ids[name], date=date, distance=distance, level="good", motors="good")
    served.library.change(ids["alike"], level="watch", vibration="watch")
    listed = served.get("/").text
    address = f"/compare?a={ids['alike']}&amp;b={ids['weak']}"
    for path in ("/", "/vehicle?name=quad%207"):
        page = served.get(path).text
        assert page.count('href="/compare?') == 2
        assert f'href="{address}" aria-label="Compare weak.ulg with alike.ulg"' in page
    assert f"/compare?a={ids['alike']}&amp;b={ids['weak before']}" in listed
    assert f'<a href="{address}">Compare with alike.ulg</a>' in served.get(f"/f/{ids['weak']}").text
    select = served.get(f"/f/{ids['weak']}").text.partition('<select id="partner"')[2]
    partners = re.findall('<option value="([^"]*)">', select.partition("</select>")[0])
    assert partners[:3] == [ids["alike"], ids["weak before"], ids["later"]]
    # The page of two flights has the verdict of the list on their motors, which is by all flights of the vehicle.
    assert "Motor 3 lost thrust." in served.get(address.replace("&amp;", "&")).text
    # A baseline is what flights are compared with, also where an earlier one is sound.
    assert served.ask("PUT", "/api/baseline", {"flights": [ids["later"]]}).status == 200
    assert "Compare with later.ulg" in served.get("/").text
    # A flight that is deleted while its page or a list is made is compared with none.
    entry = served.library.entry(ids["weak"])
    served.library.delete(ids["weak"])
    visible = VisibleLibrary(served.library, Rights())
    assert not visible.healthy_flights_to_compare_with([entry])


@mark.slow
def test_flights_of_unnamed_vehicles_are_not_compared_until_somebody_says_whose_they_are(served):
    """Two logs without a serial number have a system id in common, which is no evidence that one vehicle flew them."""
    a, b = served.add("a.ulg", "Known by id alone."), served.add("b.ulg", "Also by id.")
    served.library.change(a, date="2026-11-19T10:00:00")
    assert served.get(f"/api/flights/{b}").json["flight"]["is_vehicle_unnamed"]
    listed = served.get("/").text
    assert listed.count(">unnamed ArduPilot quadrotor</a>") == 2
    assert "ardupilotmega-1" not in listed[listed.index("<nav>") : listed.index("</nav>")]
    page_of_unnamed = served.get(f"/f/{b}").text
    assert "data-previous=" not in page_of_unnamed
    assert '<option value="">choose a flight</option>' in page_of_unnamed
    page = served.get("/vehicle?name=ardupilotmega-1").text
    assert "Over its flights" not in page and "Name their vehicle" in page
    refused = served.ask("PUT", "/api/baseline", {"flights": [a, b]})
    assert refused.refusal == (409, RefusalReason.NOT_FOR_BASELINE) and "a.ulg" in refused.text
    assert served.library.store.healthy == []

    for flight in (a, b):
        answer = served.ask("PATCH", f"/api/flights/{flight}", {"vehicle_name": " Red  quad"})
        assert answer.json["vehicle"] == "Red quad" and not answer.json["is_vehicle_unnamed"]
    rows = served.library.flight_rows([served.library.entry(a)])
    assert {(row.vehicle, row.vehicle_basis) for row in rows} == {("Red quad", "given")}
    page_of_named = served.get(f"/f/{b}").text
    assert f'data-previous="{a}"' in page_of_named and "choose a flight" not in page_of_named
    assert ">Red quad</a>" in served.get("/").text
    assert served.get("/vehicle?name=Red%20quad").status == 200
    served.ask("PUT", "/api/baseline", {"flights": [a, b]})
    assert len({row.key for row in served.library.store.healthy}) == 2

    served.ask("PATCH", f"/api/flights/{a}", {"vehicle_name": ""})
    assert served.get(f"/api/flights/{a}").json["flight"]["vehicle"] == "ardupilotmega-1"
    assert {row.vehicle for row in served.library.store.healthy} == {"Red quad"}
    named = served.add("c.ulg", "Of a board.")
    answer = served.ask("PATCH", f"/api/flights/{named}", {"vehicle_name": "Red quad"})
    assert answer.refusal == (409, RefusalReason.VEHICLE_IDENTIFIED)


@mark.slow
def test_the_name_of_a_vehicle_with_a_serial_number_assigns_that_vehicle(served):
    served.add("a.ulg", "Of a board.")
    served.ask("PUT", "/api/vehicle", {"vehicle": "quad 7", "name": "Red quad"})
    id = served.add("b.ulg", "Known by id alone.")
    answer = served.ask("PATCH", f"/api/flights/{id}", {"vehicle_name": "Red quad"})
    assert (answer.json["vehicle"], answer.json["vehicle_name"]) == ("quad 7", "Red quad")


@mark.slow
def test_damaged_results_are_said_to_be_and_odd_values_are_as_if_not_there(served):
    """Files of results, folders and columns of the index are damaged or missing."""
    a, b = served.add("a.ulg"), served.add("b.ulg")
    results = served.library.results_folder(served.library.entry(a))
    for path, name, content in (
        (f"/api/flights/{a}", "report.json", b"[1]"),
        (f"/compare?a={a}&b={b}", "report.json", b"[" * 100_000),
        (f"/f/{a}", "report.html", b"\xff"),
    ):
        (results / name).write_bytes(content)
        answer = served.get(path)
        assert answer.status == 500 and "damaged" in answer.text
    for folder in ("logs", "incoming", "results"):
        rmtree(served.library.folder / folder)
    served.library.change(a, sharing=None, tags=None, gains="no", motor="")
    assert total(served, "MC_ROLL_P>1") == 1
    for damaged_gains in ("no", "[1]", '{"MC_ROLL_P": "high"}'):
        served.library.change(a, gains=damaged_gains)
        assert served.get(f"/compare?a={a}&b={b}").status == 200
    served.add("c.ulg")
    assert len(served.get("/api/flights").json["flights"]) == 3


@mark.slow
def test_who_has_no_right_sees_what_is_shared_and_no_more(guarded):
    """One flight is private, one is shared by its link, one is public.

    A visitor without a token reads the latter two and changes nothing.
    """
    private = guarded.add("a.ulg", "Private.", token=TOKEN)
    link, public = (
        guarded.upload(
            (f"{name}.ulg", log(name)), token=TOKEN, path="/upload", fields={"public": name}
        ).headers["Location"][3:]
        for name in ("false", "true")
    )
    for id, status in ((private, 404), (link, 200), (public, 200)):
        assert guarded.get(f"/f/{id}").status == status
    (listed,) = guarded.get("/api/flights").json["flights"]
    assert listed["id"] == public
    assert "Private." not in guarded.get("/").text
    assert guarded.get("/api/flights", token=TOKEN).json["total"] == 3
    # The log itself only where its owner allows.
    assert guarded.get(f"/f/{link}/log").status == 401
    guarded.ask("PATCH", f"/api/flights/{link}", {"log_shared": True}, TOKEN)
    assert guarded.get(f"/f/{link}/log").status == 200
    for method, path in (
        ("DELETE", f"/api/flights/{link}"),
        ("PATCH", f"/api/flights/{link}"),
        ("PUT", "/api/baseline"),
        ("POST", "/api/logs"),
        ("POST", "/upload"),
        ("POST", f"/{TOKEN[::-1]}/upload"),
        ("GET", "/api/progress"),
    ):
        refused = guarded.ask(method, path, {})
        assert refused.refusal == (401, RefusalReason.NO_RIGHT), path
    assert [guarded.get(path).status for path in ("/vehicle?name=quad%207", "/compare")] == [
        401
    ] * 2
    # The verdict on a public flight is the same for all: a visitor sees the fault that only other flights show.
    weak_log = ("weak.ulg", log("A weak motor."))
    page = guarded.upload(weak_log, token=TOKEN, path="/upload", fields={"public": "true"})
    for path in ("/", page.headers["Location"]):
        assert "Motor 3 lost thrust." in guarded.get(path).text


@mark.slow
def test_a_cookie_reads_and_only_the_key_of_a_page_writes(guarded):
    """A user signs in with the token.

    The cookie alone does not delete, the key in the page does, and the upload key does nothing but upload.
    """
    id = guarded.add("a.ulg", "One.", token=TOKEN)
    wrong = guarded.ask("POST", "/enter", "token=guess")
    assert wrong.status == 401 and "Set-Cookie" not in wrong.headers
    entered = guarded.ask("POST", "/enter", f"token={TOKEN}")
    cookie = entered.headers["Set-Cookie"]
    assert entered.status == 303 and "Secure" not in cookie
    assert "HttpOnly" in cookie and "SameSite=lax" in cookie and TOKEN not in cookie
    cookie_header = {"Cookie": cookie.split(";")[0]}
    page = guarded.get(f"/f/{id}", **cookie_header).text
    assert guarded.ask("DELETE", f"/api/flights/{id}", **cookie_header).status == 401
    key = re.search(r'name="mavdem-key" content="(\w+)"', page)[1]
    address = re.search(r"/(\w+)/upload", guarded.get("/", **cookie_header).text)[1]
    assert TOKEN not in page and key != address
    # The key in the address given to QGroundControl uploads and does nothing else.
    assert guarded.upload(("b.ulg", log("Two.")), path=f"/{address}/upload").status == 302
    assert guarded.ask("DELETE", f"/api/flights/{id}", token=address).status == 401
    assert guarded.ask("DELETE", f"/api/flights/{id}", token=key).status == 204
    # Whoever has not signed in learns how to see a flight that may be private; nothing says whether there is one.
    assert 'If it is private, <a href="/enter">sign in</a>' in guarded.get(f"/f/{id}").text
    assert "If it is private" not in guarded.get("/f/unknown", **cookie_header).text
    sign_out = guarded.ask("POST", "/leave", **cookie_header)
    assert sign_out.status == 303 and 'mavdem=""' in sign_out.headers["Set-Cookie"]


@mark.slow
def test_pages_of_an_earlier_version_may_run_their_scripts_after_an_upgrade(tmp_path, monkeypatch):
    earlier, present = ("'sha256-earlier='",), ("'sha256-present='",)
    for scripts, expected in ((earlier, earlier), (present, (*earlier, *present))):
        monkeypatch.setattr("mavdem.serve.app.script_hashes", lambda scripts=scripts: scripts)
        with serving(tmp_path) as server:
            policy = server.get("/").headers["content-security-policy"]
        assert f"script-src 'self' {' '.join(expected)};" in policy


@mark.slow
def test_a_wrong_token_is_said_to_be_wrong_and_the_right_one_may_follow(guarded):
    wrong = guarded.ask("POST", "/enter", "token=another")
    assert wrong.status == 401 and "This is not the token of the server." in wrong.text
    assert 'type="password"' in wrong.text
    assert guarded.ask("POST", "/enter", f"token={TOKEN}").status == 303


@mark.slow
def test_another_site_is_refused(served):
    """Requests with the origin or host name of another site must not change anything."""
    id = served.add()
    for headers in (
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Host": "evil.example"},
    ):
        refused = served.ask("DELETE", f"/api/flights/{id}", **headers)
        assert refused.refusal == (403, RefusalReason.OTHER_SITE), headers
    for host in ("evil.example", "[::", "[x]", ""):
        assert served.get("/", Host=host).status == 403, host
    assert served.ask("DELETE", f"/api/flights/{id}", Origin="http://[").status == 403
    assert (
        served.ask(
            "DELETE", f"/api/flights/{id}", Origin=served.address, Sec_Fetch_Site="same-origin"
        ).status
        == 204
    )


@mark.slow
def test_half_a_character_in_a_name_or_a_text_is_a_question_mark(served):
    (flight,) = served.ask(
        "POST",
        "/api/logs",
        form([("\\ud800.ulg", log("One."))], {"description": "\\udfff"}),
        Content_Type=f"multipart/form-data; charset=unicode_escape; boundary={BOUNDARY}",
    ).json["flights"]
    assert (flight["name"], flight["note"]) == ("?.ulg", "?")


@mark.slow
def test_names_and_texts_of_logs_are_only_text(served):
    """Names and texts of a log contain HTML and paths: pages must show them as text, and no file may lie elsewhere."""
    name = f"../../{HOSTILE}/../x.ulg".replace('"', "%22")
    id = served.upload((name, log(HOSTILE))).json["flights"][0]["id"]
    served.ask("PATCH", f"/api/flights/{id}", {"note": HOSTILE, "tags": [HOSTILE[:30]]})
    (folder,) = (served.library.folder / "logs").iterdir()
    assert [path.parent for path in folder.iterdir()] == [folder]
    for path in (
        "/",
        f"/f/{id}",
        "/?q=%3Cscript%3Ealert(1)%3C/script%3E",
        "/vehicle?name=%3Cb%3E",
        "/vehicle?name=quad%207",
    ):
        text = served.get(path).text
        assert "<script>" not in text and "<b>" not in text.replace("<b>quad", ""), path
    policy = served.get(f"/f/{id}").headers["Content-Security-Policy"]
    scripts = re.search("script-src ([^;]*)", policy)[1]
    assert "unsafe" not in scripts and "default-src 'none'" in policy


@mark.slow
@mark.parametrize(
    "path",
    ["/f/../../etc/passwd", "/f/%2e%2e%2f/log", "/f/x/..%2ffleet.sqlite", "/static/../app.py"],
)
def test_paths_outside_the_library_are_not_found(served, path):
    id = served.add()
    assert served.get(path).status == 404
    assert served.get(f"/f/{id}/..%2f..%2ffleet.sqlite").status == 404


@mark.slow
def test_an_unknown_address_is_answered_in_a_sentence(served):
    unknown = served.get("/lives")
    assert unknown.status == 404 and "There is no such page" in unknown.text
    assert "default-src 'none'" in unknown.headers["Content-Security-Policy"]
    assert served.ask("POST", "/api/nothing").refusal == (404, "no_such_page")
    without_link = served.get("/live")
    assert without_link.status == 404 and "--link" in without_link.text
    posted = served.ask("POST", "/live")
    assert posted.status == 405 and "GET" in posted.headers["Allow"]


@mark.slow
def test_malformed_uploads_are_refused(served):
    """The form is incomplete, of another type, or has fields that are too large."""
    kind = f"multipart/form-data; boundary={BOUNDARY}"
    form_data = form([("a.ulg", log())])
    for body, content_type, code in (
        (b"{}", "application/json", RefusalReason.UPLOAD_WITHOUT_LOG),
        (form([("", b"")]), kind, RefusalReason.UPLOAD_WITHOUT_LOG),
        (form_data[:-10], kind, RefusalReason.UPLOAD_BROKEN),
        (b"nothing of a form", kind, RefusalReason.BAD_REQUEST),
        (form_data, "multipart/form-data; boundary=" + "x" * 400, RefusalReason.BAD_REQUEST),
        (form_data, kind + "; charset=punycode", RefusalReason.BAD_REQUEST),
        (form([], {"field": "x" * 65_536}), kind, RefusalReason.UPLOAD_WITHOUT_LOG),
        (form([], {"field": "x" * 65_537}), kind, RefusalReason.BAD_REQUEST),
    ):
        answer = served.ask("POST", "/api/logs", body, Content_Type=content_type)
        assert answer.refusal == (400, code)
    assert list((served.library.folder / "incoming").iterdir()) == []


def numbered(count):
    """So many different logs."""
    return [(f"{number}.ulg", log(str(number))) for number in range(count)]


@mark.slow
def test_size_number_queue_and_patience_have_limits(tmp_path, monkeypatch):
    """Each limit of uploads is lowered and exceeded in turn.

    Size, number of files, delay, waiting logs and simultaneous uploads.
    """
    monkeypatch.setattr(uploads, "MAX_LOG_BYTES", 1000)
    monkeypatch.setattr(uploads, "MAX_FILES", 2)
    monkeypatch.setattr(uploads, "SPACE_CHECK_BYTES", 200)
    looked = []
    monkeypatch.setattr(uploads, "MAX_CHUNK_DELAY", 0.2)
    monkeypatch.setattr(api, "MAX_WAITING_LOGS", 1)
    monkeypatch.setattr(api, "MAX_UPLOADS", 1)
    with serving(tmp_path, is_eager=False) as server:
        large = server.upload(("a.ulg", log(size=1001)))
        assert large.refusal == (413, RefusalReason.UPLOAD_TOO_LARGE)
        answer = server.upload(*numbered(3))
        assert answer.refusal == (400, RefusalReason.BAD_REQUEST)
        with socket.create_connection(("127.0.0.1", server.port)) as line:
            head = "POST /api/logs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 999\r\n"
            head += f"Content-Type: multipart/form-data; boundary={BOUNDARY}\r\n\r\n"
            line.sendall(head.encode() + form([("a.ulg", log())])[:100])
            assert b" 408 " in line.recv(100)
        monkeypatch.setattr(server.library, "check_space", looked.append)
        server.add(size=1000)
        assert looked[-1] == 0
        full = server.upload(("b.ulg", log("b")))
        assert full.code == RefusalReason.UPLOADS_TOO_MANY and full.headers["Retry-After"]
        monkeypatch.setattr(api, "MAX_WAITING_LOGS", 2)
        monkeypatch.setattr(api, "MAX_UPLOADS", 0)
        assert server.upload(("b.ulg", log("b"))).code == RefusalReason.UPLOADS_TOO_MANY
        assert list((tmp_path / "incoming").iterdir()) == []


@mark.slow
def test_idle_and_surplus_connections_are_closed(tmp_path, monkeypatch):
    """With two connections allowed, a third one and clients that send nothing are closed."""
    monkeypatch.setattr(listening, "MAX_CONNECTIONS", 2)
    monkeypatch.setattr(listening, "MAX_REQUEST_DELAY", 0.2)
    with serving(tmp_path) as server, ExitStack() as lines:
        address = ("127.0.0.1", server.port)
        idle, slow, late = (
            lines.enter_context(socket.create_connection(address, timeout=300)) for _ in range(3)
        )
        slow.sendall(b"GET / HT")
        assert [line.recv(1) for line in (late, idle, slow)] == [b""] * 3
        again = lines.enter_context(socket.create_connection(address, timeout=300))
        again.sendall(b"GET /api/flights HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        with HTTPResponse(again) as answer:
            answer.begin()
            assert answer.status == 200 and answer.read()
        again.sendall(b"GET / HT")
        assert again.recv(1) == b""
        assert server.get("/api/flights").status == 200


@mark.slow
def test_a_form_of_many_files_needs_few_descriptors(served):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + 20, hard))
    try:
        answer = served.upload(*numbered(30))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert answer.status == 201 and len(answer.json["flights"]) == 30


@mark.slow
def test_a_full_disk_and_a_full_quota_are_507_and_break_nothing(tmp_path, monkeypatch):
    """Uploads exceed the quota and the disk.

    Each is refused without leftovers, and the server works on afterwards.
    """
    with serving(tmp_path, quota=1000) as server:
        id = server.add("a.ulg", "One.")
        refused = server.upload(("b.ulg", log("Two.", 2000)))
        assert refused.refusal == (507, RefusalReason.QUOTA_REACHED)
        server.library.quota = None

        def full(handle):
            raise OSError(errno.ENOSPC, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr("mavdem.serve.library.os.fsync", full)
            refused = server.upload(("b.ulg", log("Two.")))
            usage = shutil.disk_usage(server.library.folder)._replace(free=64 << 20)
            patch.setattr("mavdem.serve.library.shutil.disk_usage", lambda folder: usage)
            server.library.check_space(0)
            with raises(Refusal):
                server.library.check_space(1)
        assert refused.refusal == (507, RefusalReason.DISK_FULL)
        with raises(PermissionError), refuse_full_disk():
            raise PermissionError(errno.EACCES, "another trouble")
        with raises(sqlite3.OperationalError), refuse_full_disk():
            server.library.store.db.execute("no SQL")
        assert server.get("/api/flights").json["total"] == 1
        assert list((tmp_path / "incoming").iterdir()) == []
        assert server.ask("DELETE", f"/api/flights/{id}").status == 204
        assert server.add("b.ulg", "Two.")


def test_only_loopback_needs_no_token():
    assert rights_for_host("127.0.0.1", "", is_behind_proxy=False).is_local
    assert not rights_for_host("0.0.0.0", "", is_behind_proxy=True).is_local
    for host, token, code in (
        ("0.0.0.0", "", StartFailure.TOKEN_NEEDED),
        ("127.0.0.1", "short", StartFailure.TOKEN_TOO_SHORT),
    ):
        assert unreadable(rights_for_host, host, token, is_behind_proxy=False).code is code


@mark.slow
def test_the_interface_describes_itself(served):
    described = served.get("/api/openapi.json").json
    assert described["openapi"].startswith("3.1")
    names = set(re.findall(r"#/components/schemas/(\w+)", json.dumps(described)))
    assert names <= set(described["components"]["schemas"])
    assert {"/api/flights/{id}/viewer", "/{key}/upload"} <= set(described["paths"])
    for path, methods in described["paths"].items():
        for method in methods:
            answer = served.ask(method.upper(), re.sub(r"{\w+}", "none", path), {})
            assert answer.status in (200, 204, 400, 404), path


@mark.slow
def test_the_first_visit_explains_itself_and_offers_a_sample(tmp_path):
    sample = tmp_path / "sample.ulg"
    sample.write_bytes(log("Sample."))
    with serving(tmp_path / "served", sample=sample) as server:
        assert 'id="sample"' in server.get("/").text
        assert server.get("/static/sample").text == log("Sample.").decode()
        server.add()
        assert 'id="sample"' not in server.get("/").text


@mark.slow
def test_a_recording_opens_in_a_viewer(tmp_path):
    """A flight without a model has no recording to open; one with a model opens in the viewer's page."""
    data = "rerun+http://127.0.0.1:9876/proxy"
    with serving(tmp_path, viewer=Mock(**{"open.return_value": data})) as server:
        id = server.add("a.ulg", "One.")
        assert server.ask("POST", f"/api/flights/{id}/viewer", {}).status == 404
        id = server.add("b.ulg", "With a model.")
        assert server.ask("POST", f"/api/flights/{id}/viewer", {}).json["stage"] == "done"
        assert server.ask("POST", f"/api/flights/{id}/viewer", {}).json == {
            "address": f"{server.address}/f/{id}/viewer",
            "data_address": data,
        }
        assert 'id="rerun"' in server.get(f"/f/{id}").text
        page = server.get(f"/f/{id}/viewer")
        assert 'id="viewer"' in page.text and "http://127.0.0.1:*" in page.headers[POLICY_HEADER]


@mark.slow
def test_a_viewer_that_cannot_be_started_is_refused(tmp_path, monkeypatch):
    def taken(*_):
        raise OSError("port 9876 is taken")

    monkeypatch.setattr("mavdem.view.WebServer", taken)
    with serving(tmp_path, viewer=RecordingViewer()) as server:
        id = server.add("a.ulg", "With a model.")
        server.get(f"/f/{id}/flight.rrd")
        refused = server.ask("POST", f"/api/flights/{id}/viewer", {})
        assert refused.refusal == (503, RefusalReason.NOT_STARTED)


@contextmanager
def running_viewer(monkeypatch, process_id=0):
    """A stand-in for the Rerun viewer that answers; yields it, the viewers of a server, and the number of starts."""
    monkeypatch.setattr("mavdem.serve.viewers.WATCH_SECONDS", 0.01)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        monkeypatch.setattr("mavdem.serve.viewers.free_port", lambda: port)
        viewer = Mock(url="rerun+http://viewer/proxy")
        viewer.process.poll.return_value = None
        viewer.process.pid = process_id
        monkeypatch.setattr("mavdem.view.WebServer", start := Mock(return_value=viewer))
        viewers = RecordingViewer()
        yield viewer, viewers, start
        viewers.close()


def test_a_viewer_that_answers_is_shown_until_another_recording_is_asked_for(monkeypatch):
    viewer_address = "rerun+http://viewer/proxy"
    with running_viewer(monkeypatch) as (_, viewers, start):
        for name, count in (("a.rrd", 1), ("a.rrd", 1), ("b.rrd", 2)):
            assert viewers.open(Path(name)) == viewer_address and start.call_count == count


def test_a_viewer_ends_when_its_tab_is_gone(monkeypatch):
    monkeypatch.setattr("mavdem.serve.viewers.MAX_SECONDS_WITHOUT_TAB", 0.05)
    with running_viewer(monkeypatch) as (viewer, viewers, start):
        viewers.open(Path("a.rrd"))
        until(lambda: viewer.close.called)
        viewers.open(Path("a.rrd"))
        assert start.call_count == 2


@mark.slow
def test_a_viewer_with_a_tab_ends_when_nobody_looked_at_it_for_ten_minutes(monkeypatch):
    """The clock of the test moves: each use of the viewer within 600 s keeps it."""
    now = [0.0]
    looks = []

    def sleep(seconds):
        looks.append(now[0])
        time.sleep(seconds)

    def look():
        """Waits until the viewer has been looked at anew: the first look after may have begun before."""
        count = len(looks) + 2
        until(lambda: len(looks) >= count)

    clock = SimpleNamespace(monotonic=lambda: now[0], sleep=sleep)
    monkeypatch.setattr("mavdem.serve.viewers.time", clock)
    with ExitStack() as stack:
        viewer, viewers, _ = stack.enter_context(running_viewer(monkeypatch, os.getpid()))
        # A connection of this process stands for that of a browser.
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        stack.enter_context(socket.create_connection(listener.getsockname()))
        for now[0] in (0.0, 599.0, 1198.0):
            viewers.open(Path("a.rrd"))
            look()
            assert not viewer.close.called
        now[0] = 1797.0
        look()
        assert not viewer.close.called
        now[0] = 1799.0
        until(lambda: viewer.close.called)


def test_the_command_serves_as_it_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("mavdem.serve.run.serve", served := Mock())
    monkeypatch.setattr("mavdem.cli.serve.has_screen", lambda: True)
    assert command_line.run("serve", tmp_path, "--quota", "1.5") == 0
    (options, *_), keywords = served.call_args
    assert options.quota == 1_500_000_000 and options.sample_log.is_file()
    assert options.limits.megabytes == 1000 and keywords == {"opens_browser": True}


@mark.slow
def test_a_wrong_secret_of_any_kind_is_answered_late(guarded, monkeypatch):
    monkeypatch.setattr("mavdem.serve.rights.WRONG_TOKEN_DELAY", 0.2)
    guesses = (
        {"path": "/api/flights", "token": "guess"},
        {"path": "/", "Cookie": "mavdem=guess"},
    )
    for guess in guesses:
        begin = time.monotonic()
        answer = guarded.get(**guess)
        assert time.monotonic() - begin >= 0.2
        # The browser forgets a wrong cookie, and waits only once.
        assert ("Set-Cookie" in answer.headers) == ("Cookie" in guess)
    begin = time.monotonic()
    refused = guarded.upload(("a.ulg", log("One.")), path="/guess/upload")
    assert refused.status == 401 and time.monotonic() - begin >= 0.2


def test_wrong_tokens_on_several_connections_wait_one_after_another(monkeypatch):
    monkeypatch.setattr("mavdem.serve.rights.WRONG_TOKEN_DELAY", 0.05)
    rights = Rights(TOKEN)

    async def guess_on_four_connections():
        await asyncio.gather(*(rights.delay_wrong_token() for _ in range(4)))

    begin = time.monotonic()
    asyncio.run(guess_on_four_connections())
    assert time.monotonic() - begin >= 0.2


@mark.slow
def test_only_a_wrong_cookie_is_removed(guarded, monkeypatch):
    monkeypatch.setattr("mavdem.serve.rights.WRONG_TOKEN_DELAY", 0.0)
    # The right token replaces the cookie of an earlier one.
    entered = guarded.ask("POST", "/enter", f"token={TOKEN}", Cookie="mavdem=former")
    (cookie,) = entered.headers.get_all("Set-Cookie")
    own_cookie = cookie.split(";")[0]
    assert own_cookie != 'mavdem=""'
    # An upload to an earlier address does not sign out.
    refused = guarded.upload(("a.ulg", log("One.")), path="/guess/upload", Cookie=own_cookie)
    assert refused.status == 401 and "Set-Cookie" not in refused.headers


@mark.slow
def test_a_page_with_scripts_of_a_forgotten_version_is_made_anew_once_from_its_log(served):
    id = served.add("old.ulg", "Good.")
    entry = served.library.entry(id)
    page = served.library.results_folder(entry) / PAGE_FILE
    former = page.read_text("utf-8").replace("</main>", "<script>draw('former');</script></main>")
    page.write_text(former, "utf-8")
    # The work is done at once.
    assert "The page opens by itself" in served.get(f"/f/{id}").text
    assert served.library.entry(id).stage == Stage.DONE
    assert "former" not in served.get(f"/f/{id}").text
    # A page that would have to be made again and again is left as it is.
    page.write_text(former, "utf-8")
    assert "draw('former')" in served.get(f"/f/{id}").text


@mark.slow
def test_a_flight_whose_page_cannot_be_made_anew_keeps_log_rows_and_page(served):
    """The page of a flight is requested again, but reading takes too long: the former page stays."""
    id = served.add("old.ulg", "Good.")
    entry = served.library.entry(id)
    assert served.library.request_new_page(entry)
    served.library.change(id, problem="The disk of the server is full.")
    job = Job(str(served.library.log_path(entry)))
    outcome = failed(job, "time", Fact(ReadingFact.NO_VEHICLE))
    served.library.finish_reading(served.library.claim(), outcome, LIMITS)
    done = served.library.entry(id)
    assert (done.stage, done.problem) == (Stage.DONE, "")
    assert "Good." in served.get(f"/f/{id}").text
    assert {row.headline for row in served.library.flight_rows([entry])} == {"Good."}
    assert served.get(f"/f/{id}/log").status == 200


@mark.slow
def test_few_pages_wait_to_be_made_anew(served, monkeypatch):
    ids = [served.add(f"{name}.ulg", name) for name in ("one", "two")]
    monkeypatch.setattr("mavdem.serve.library.MAX_WAITING_PAGES", 1)
    library = served.library
    assert [library.request_new_page(library.entry(id)) for id in ids] == [True, False]


@mark.slow
def test_a_page_names_the_flight_before_whose_parameters_it_is_compared_with(served):
    ids = [served.add(f"{name}.ulg", name) for name in ("first", "second", "undated")]
    for id, date in zip(ids, ("2026-11-20T10:00:00", "2026-11-21T10:00:00", ""), strict=True):
        served.library.change(id, date=date)
    first, second, undated = (served.get(f"/f/{id}").text for id in ids)
    assert f'data-previous="{ids[0]}" data-previous-name="first.ulg"' in second
    assert "data-previous=" not in first
    assert "data-previous=" not in undated
