"""Recordings of flights that the server makes when somebody asks for them."""

import json
import threading

from mcap.reader import make_reader
from patience import until
from pytest import approx, mark, raises
from recorded_flights import short_flight
from serving import LIMITS, log, record_made_up, serving

from mavdem.errors import Refusal
from mavdem.facts.serve import RefusalReason, Sharing, Stage
from mavdem.fleet.workers import Job, JobOutcome, outcome_of
from mavdem.serve.library import Library
from mavdem.serve.reading import read_for_library
from mavdem.serve.reading_threads import ReadingThreads
from mavdem.serve.recordings import RecordingRequests, make_recordings
from mavdem.serve.recovery import recover
from mavdem.serve.stored_files import PARAMETERS_FILE, SERIES_FILE

MODEL = "A model."
"""Content of a made-up log of which recordings can be made."""


def outcome_of_recording(library, entry):
    return outcome_of(Job(str(library.log_path(entry))), record_made_up)


def recorded_flight(library, content=MODEL):
    """Adds a made-up log to a library, and returns the entry of its flight, whose recordings are not made."""
    incoming = library.new_incoming_path()
    incoming.write_bytes(log(content))
    entry = library.add(incoming, "a.ulg")
    names = "flight.mcap,flight.rrd,report.html"
    library.results_folder(entry).mkdir()
    return library.change(entry.id, stage=Stage.DONE, files=names)


@mark.slow
def test_a_recording_is_made_when_it_is_first_downloaded(tmp_path):
    with serving(tmp_path) as server:
        id = server.add("a.ulg", MODEL)
        state = f"/api/flights/{id}/recordings"
        assert server.get(state).json["stage"] == ""
        assert "flight.rrd" in server.get(f"/api/flights/{id}").json["flight"]["files"]
        assert server.get(f"/f/{id}").text.count("data-missing") == 2
        assert server.get(f"/f/{id}/flight.mcap").text == "flight.mcap of a.ulg"
        assert server.get(state).json == {"id": id, "stage": "done", "words": "Done", "problem": ""}
        assert server.get(f"/f/{id}/flight.rrd").text == "flight.rrd of a.ulg"
        assert server.ask("POST", state).status == 200
        assert "data-missing" not in server.get(f"/f/{id}").text


@mark.slow
def test_while_it_is_made_the_answer_is_202_and_says_how_far_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr("mavdem.serve.pages.MAX_RECORDING_WAIT", 0.0)
    with serving(tmp_path, is_eager=False) as server:
        id = server.add("a.ulg", MODEL)
        server.work.run()
        for _ in range(2):
            answer = server.get(f"/f/{id}/flight.rrd")
            assert (answer.status, answer.headers["Retry-After"]) == (202, "2")
            assert answer.json["stage"] == Stage.WAITING
        assert server.ask("POST", f"/api/flights/{id}/recordings").status == 202
        assert server.work.recordings.claim().id == id
        # Two requests are one.
        assert server.work.recordings.claim() is None
        assert server.get(f"/f/{id}/flight.rrd").json["stage"] == Stage.READING


@mark.slow
def test_a_download_waits_for_the_recording(tmp_path, monkeypatch):
    """Two clients request a recording that is not yet written. Both wait, and both receive it."""
    monkeypatch.setattr("mavdem.serve.pages.POLL_SECONDS", 0.02)
    with serving(tmp_path, is_eager=False) as server:
        id = server.add("a.ulg", MODEL)
        server.work.run()
        answers = []

        def download():
            answers.append(server.get(f"/f/{id}/flight.mcap").text)

        threads = [threading.Thread(target=download) for _ in range(2)]
        for thread in threads:
            thread.start()
        until(lambda: server.library.find("recording_stage <> ''", (), 1)[1])
        server.work.run()
        for thread in threads:
            thread.join()
        assert answers == ["flight.mcap of a.ulg"] * 2


@mark.slow
def test_a_failure_is_one_sentence_and_the_next_request_tries_again(tmp_path):
    with serving(tmp_path) as server:
        id = server.add("a.ulg", f"{MODEL} no room")
        for _ in range(2):
            answer = server.get(f"/f/{id}/flight.mcap")
            assert answer.status == 409 and answer.json["stage"] == Stage.FAILED
            assert answer.json["problem"] == "The recordings cannot be written (full)."
        assert server.get(f"/api/flights/{id}").json["flight"]["stage"] == Stage.DONE


@mark.slow
def test_a_flight_without_a_model_says_that_it_has_no_recording(tmp_path):
    with serving(tmp_path) as server:
        id = server.add("a.ulg", "Nothing to learn.")
        answer = server.get(f"/f/{id}/flight.mcap")
        assert answer.status == 404
        assert "no flight.mcap: no model was learned" in answer.text
        assert "no file other.txt" in server.get(f"/f/{id}/other.txt").text
        assert "There is no such flight" in server.get("/f/unknown/flight.mcap").text


@mark.slow
def test_whoever_sees_a_flight_may_have_its_recordings_made_and_nobody_else(tmp_path):
    with serving(tmp_path, token="0123456789abcdef") as server:
        id = server.add("a.ulg", MODEL, token="0123456789abcdef")
        other_flight = server.add("b.ulg", "No such thing.", token="0123456789abcdef")
        assert server.get(f"/f/{id}/flight.mcap").status == 404
        assert server.ask("POST", f"/api/flights/{id}/recordings").status == 404
        server.library.change(id, sharing=Sharing.LINK)
        server.library.change(other_flight, sharing=Sharing.LINK)
        assert server.get(f"/f/{id}/flight.mcap").status == 200
        assert server.get(f"/f/{other_flight}/flight.mcap").status == 404
        assert server.ask("POST", f"/api/flights/{other_flight}/recordings").status == 404


@mark.slow
def test_a_request_outlives_the_server(tmp_path):
    library = Library(tmp_path)
    recordings = RecordingRequests(library)
    entry = recordings.request(recorded_flight(library))
    assert recordings.claim().id == entry.id
    library.close()
    again = Library(tmp_path)
    recover(again)
    assert again.entry(entry.id).stage == Stage.DONE
    claimed = RecordingRequests(again).claim()
    assert (claimed.id, claimed.recording_stage) == (entry.id, Stage.READING)


@mark.slow
def test_recordings_of_a_deleted_flight_are_removed(tmp_path):
    library = Library(tmp_path)
    recordings = RecordingRequests(library)
    recordings.request(recorded_flight(library))
    claimed = recordings.claim()
    outcome = outcome_of_recording(library, claimed)
    library.delete(claimed.id)
    library.results_folder(claimed).mkdir()
    recordings.finish(claimed, outcome)
    assert list((tmp_path / "results").iterdir()) == []


@mark.slow
def test_a_log_that_is_uploaded_again_is_read_while_the_recordings_of_the_deleted_flight_end(
    tmp_path,
):
    library = Library(tmp_path)
    recordings = RecordingRequests(library)
    recordings.request(recorded_flight(library))
    claimed = recordings.claim()
    library.delete(claimed.id)
    incoming = library.new_incoming_path()
    incoming.write_bytes(log(MODEL))
    library.add(incoming, "a.ulg")
    unread_folder = tmp_path / "results" / f".{library.claim().digest}"
    unread_folder.mkdir()
    recordings.finish(claimed, JobOutcome("a.ulg", "error"))
    assert unread_folder.is_dir()


def test_what_a_killed_server_left_of_recordings_is_removed(tmp_path):
    library = Library(tmp_path)
    leftover = tmp_path / "results" / f".{recorded_flight(library).digest}.recordings"
    leftover.mkdir()
    recover(library)
    assert not leftover.exists()


def test_a_full_library_refuses_to_make_recordings(tmp_path):
    library = Library(tmp_path)
    entry = recorded_flight(library)
    library.quota = 1
    with raises(Refusal) as refused:
        RecordingRequests(library).request(entry)
    assert refused.value.fact.code is RefusalReason.QUOTA_REACHED


def test_what_cannot_be_stored_now_is_stored_later(tmp_path, monkeypatch):
    """A full disk for two attempts at storing the outcome."""
    monkeypatch.setattr("mavdem.serve.reading_threads.RETRY_SECONDS", 0.01)
    library = Library(tmp_path)
    threads = ReadingThreads(library, 1, LIMITS)
    attempts = []

    def change():
        attempts.append(1)
        if len(attempts) < 3:
            raise Refusal(RefusalReason.DISK_FULL)

    threads.store_persistently(change)
    assert len(attempts) == 3


@mark.in_full
def test_both_recordings_of_a_real_log_show_what_its_page_shows(tmp_path, monkeypatch):
    """The recordings of a flight are requested, made and stored; their free energy is that of the report."""
    monkeypatch.setattr("mavdem.serve.recordings.lower_priority", lambda _: None)
    monkeypatch.setattr("mavdem.serve.reading.lower_priority", lambda _: None)
    library = Library(tmp_path / "library")
    incoming = library.new_incoming_path()
    incoming.write_bytes(short_flight(tmp_path).read_bytes())
    entry = library.add(incoming, "flight.tlog")
    job = Job(str(library.log_path(entry)))
    library.finish_reading(library.claim(), outcome_of(job, read_for_library), LIMITS)
    entry = library.entry(entry.id)
    recordings = RecordingRequests(library)
    assert recordings.missing_names(entry) == ["flight.mcap", "flight.rrd"]
    recordings.request(entry)
    recordings.finish(recordings.claim(), outcome_of(job, make_recordings))
    results = library.results_folder(entry)
    # What comparisons need, time series and all parameters, is stored beside the files that are offered.
    stored_names = {path.name for path in results.iterdir()}
    assert stored_names == {*entry.file_names, SERIES_FILE, PARAMETERS_FILE}
    assert recordings.stage(library.entry(entry.id)) == Stage.DONE
    with (results / "flight.mcap").open("rb") as file:
        last = [
            json.loads(message.data)["free_energy_action"]
            for _, _, message in make_reader(file).iter_messages("learned/free_energy_action")
        ][-1]
    model = json.loads((results / "report.json").read_text())["model"]
    assert last == approx(model["free_energy"]["end"])


@mark.slow
def test_the_browser_waits_and_then_downloads(tmp_path, browser):
    """A browser requests a recording that is written later, and one that cannot be written.

    It shows the reason of the latter.
    """
    with serving(tmp_path / "served", is_eager=False) as server, browser.tab() as page:
        id = server.add("a.ulg", MODEL)
        server.work.run()
        page.open(f"{server.address}/f/{id}")
        page.run("document.querySelector('a[href$=\"flight.mcap\"]').click()")
        page.until("document.getElementById('making').textContent.startsWith('Received')")
        server.work.run()
        page.until("document.getElementById('making').textContent === ''")
        assert not page.run("!!document.querySelector('[data-missing]')")
        failing = server.add("b.ulg", f"{MODEL} no room")
        server.work.run()
        page.open(f"{server.address}/f/{failing}")
        page.run("document.querySelector('a[href$=\"flight.mcap\"]').click()")
        page.until("document.getElementById('making').textContent.startsWith('Received')")
        server.work.run()
        page.until("document.getElementById('making').textContent.includes('cannot be written')")
        assert page.said == []
