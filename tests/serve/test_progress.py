"""What those see who wait for a log: who comes before them, the step of the work, and the plots that need no model."""

import json
import time

from pytest import approx, mark
from recorded_flights import short_flight
from serving import log, serving

from mavdem.assessment.time_history import time_history
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.serve import Stage
from mavdem.ingest import read_log
from mavdem.report.pages.library_page import first_plots
from mavdem.serve.api import Api
from mavdem.serve.field_store import FieldStore
from mavdem.serve.index import LibraryEntry, insert_entry, new_id
from mavdem.serve.library import Library
from mavdem.serve.reading import ProgressFile
from mavdem.serve.reading_queue import ReadLogSize, estimated_seconds, recent_slowness
from mavdem.serve.rights import Rights
from mavdem.serve.stored_files import FIRST_PLOTS, PROGRESS
from mavdem.serve.visible_library import VisibleLibrary
from mavdem.wind_velocity.from_log import UNKNOWN_WIND


@mark.slow
def test_a_waiting_log_says_how_many_come_before_it(tmp_path):
    with serving(tmp_path, is_eager=False) as server:
        ids = [server.add(f"{number}.ulg", str(number)) for number in range(3)]
        assert [server.progress(id)["ahead"] for id in ids] == [0, 1, 2]


def test_the_end_of_the_queue_is_estimated_from_sizes_and_durations_before():
    history = [ReadLogSize(size, size / 10) for size in (10, 20, 30, 40, 50, 60, 70)]
    history[3] = ReadLogSize(40, 1000.0)
    assert estimated_seconds(45, history) == approx(4.5), "one slow log has no effect"
    assert estimated_seconds(700, history) == approx(70)
    assert estimated_seconds(1, history) == approx(0.1)
    assert estimated_seconds(20, history[:1]) == approx(2)


def test_estimated_ends_follow_the_speed_of_the_last_logs():
    under_load = [ReadLogSize(size, 10.0 * size) for size in range(20, 60)]
    assert recent_slowness(under_load) == approx(1)
    since_then = [ReadLogSize(size, size) for size in (5, 70, 80)]
    latest_first = since_then + under_load
    by_size = sorted(latest_first)
    assert recent_slowness(latest_first) * estimated_seconds(40, by_size) < 0.2 * 400


@mark.slow
def test_a_waiting_log_has_an_end_once_others_were_read(tmp_path):
    """Each of three waiting logs is expected to take 100 s, as the logs before took."""
    with serving(tmp_path, is_eager=False) as server:
        first_ids = [server.add(f"{number}.ulg", f"Read {number}") for number in range(3)]
        assert server.progress(first_ids[0])["estimated_end"] is None
        server.work.run()
        with server.library.transaction() as db:
            db.execute("update logs set seconds = 100")
        begin = time.time()
        ids = [server.add(f"{number}.ulg", f"Waits {number}") for number in range(3)]
        ends = [server.progress(id)["estimated_end"] for id in ids]
        for count, end in enumerate(ends, start=1):
            assert 100 * count <= end - begin <= 100 * count + 25
        server.library.claim()
        assert server.progress(ids[0])["estimated_end"] == approx(ends[0], abs=10)
        assert server.progress(ids[2])["ahead"] == 1


@mark.slow
def test_the_progress_of_many_waiting_logs_takes_little_time(tmp_path):
    """A thousand logs, whose progress all watchers ask for five times a second."""
    library = Library(tmp_path)
    with library.transaction() as db:
        for number in range(1000):
            name = f"{number}.tlog"
            waiting = LibraryEntry(new_id(), name, f"{number:064x}", name, received=float(number))
            insert_entry(db, waiting)
    queries = []
    library.db.set_trace_callback(queries.append)
    api = Api(VisibleLibrary(library, Rights()), lambda: None, None, FieldStore())
    entries, _ = library.find("1", [], 1000)
    progress = api._progress_of_all(entries).progress_by_id
    assert [each.ahead for each in progress.values()] == list(reversed(range(1000)))
    assert len(queries) < 10


@mark.slow
def test_a_log_that_is_read_says_step_share_and_time(tmp_path):
    """The progress file has a step of known duration, and one of unknown duration."""
    with serving(tmp_path, is_eager=False) as server:
        id = server.add("a.ulg", "One.")
        entry = server.library.claim()
        folder = server.library.results_folder(entry).with_name(f".{entry.digest}")
        folder.mkdir()
        progress = ProgressFile(folder / PROGRESS)
        progress.report(Stage.JUDGING, has_plots=False)
        with progress.show_step("Judging by held-out windows") as show_share:
            show_share(0.5)
        document = server.progress(id)
        assert (document["stage"], document["step"]) == ("judging", "Judging by held-out windows")
        assert (document["share"], document["has_plots"]) == (0.5, False)
        assert document["seconds"] >= 0
        with progress.show_step("Learning", measured=False):
            pass
        assert server.progress(id)["share"] is None


@mark.slow
def test_the_page_of_a_log_that_is_read_has_its_first_plots(tmp_path):
    with serving(tmp_path, is_eager=False) as server:
        id = server.add("a.ulg", "One.")
        assert 'id="flight"' not in server.get(f"/f/{id}").text
        entry = server.library.entry(id)
        folder = server.library.results_folder(entry).with_name(f".{entry.digest}")
        folder.mkdir()
        (folder / FIRST_PLOTS).write_text("<figure>Height</figure>")
        assert "<figure>Height</figure>" in server.get(f"/f/{id}").text


@mark.slow
def test_first_plots_show_what_was_recorded(tmp_path):
    (vehicle,) = read_log(short_flight(tmp_path)).vehicles
    history = time_history(Signals(vehicle), (), UNKNOWN_WIND, ())
    page = first_plots(history)
    for title in ("Motors, %", "Motors minus their mean, %", "Roll, °", "Yaw rate, °/s"):
        assert f"<h3>{title}</h3>" in page
    assert len(page) < 1_500_000


@mark.slow
def test_an_event_of_the_first_plots_leads_to_its_time(tmp_path):
    (vehicle,) = read_log(short_flight(tmp_path)).vehicles
    event = Fact(ReadingFact.NO_VEHICLE).replace(time=12.5)
    page = first_plots(time_history(Signals(vehicle), (), UNKNOWN_WIND, (event,)))
    assert '<tr data-at="12.5"><td><a href="#t=12.50">12.5 s</a></td>' in page
    assert f'<span class="sentence">{event}</span>' in page


def test_the_progress_file_is_json_at_any_time(tmp_path):
    progress = ProgressFile(tmp_path / PROGRESS)
    for stage in (Stage.READING, Stage.LEARNING):
        progress.report(stage, headline=log().decode())
        assert json.loads((tmp_path / PROGRESS).read_text())["stage"] == stage
