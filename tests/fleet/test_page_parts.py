"""What the pages of a fleet keep of each vehicle: it is made again where the vehicle was judged, and only there."""

from fleet_rows import fleet_rows, flight_row
from pytest import mark
from standin_logs import fleet_of

from mavdem.facts.lights import Light
from mavdem.fleet.judgement import mark_pages_updated, outdated_vehicles
from mavdem.fleet.page_parts import cached_charts, cached_summaries
from mavdem.fleet.store import open_store
from mavdem.fleet_pages import write_fleet_pages
from mavdem.report.fleet import light_level
from mavdem.report.vehicle_summary import summary_adapter, vehicle_summaries


def index_of(folder, *steps):
    """Returns the index page of a fleet that grew in steps, each of which is a list of rows."""
    for rows in steps:
        fleet_of(folder, rows)
        with open_store(folder) as store:
            index = write_fleet_pages(store, {}).index
    return index.read_text()


@mark.slow
def test_the_page_of_a_fleet_that_grew_is_that_of_all_its_flights(tmp_path):
    few_rows, many_rows = fleet_rows(7), fleet_rows(20)
    assert index_of(tmp_path / "grown", few_rows, many_rows) == index_of(
        tmp_path / "at once", many_rows
    )


def test_the_light_of_the_motors_is_as_bad_as_their_health_in_a_fleet():
    for health, light, level in (
        ("fault", "watch", "bad"),
        ("drift", "good", "watch"),
        ("ok", "watch", "watch"),
        ("unknown", "bad", "bad"),
    ):
        flight = [flight_row("x", 1, health=health, light_motors=light, light_wind="good")]
        assert light_level(flight, Light.MOTORS) == level
        assert light_level(flight, Light.WIND) == "good"


@mark.slow
def test_a_summary_is_the_same_after_it_was_kept():
    for summary in vehicle_summaries(fleet_rows(20)):
        adapter = summary_adapter()
        assert adapter.validate_json(adapter.dump_json(summary)) == summary


@mark.slow
def test_only_vehicles_that_were_judged_anew_are_summed_up_again(tmp_path):
    """Each summary carries the number of the call that made it, so that a cached one is recognised."""
    summarised_names = []

    def make(vehicle):
        summarised_names.append(vehicle)
        return f"{vehicle} {len(summarised_names)}"

    def summaries(store, version="1"):
        outdated = outdated_vehicles(store)
        cached = cached_summaries(store, version, outdated, make)
        mark_pages_updated(store, outdated)
        return cached

    rows = [flight_row(name, 0, key=f"{name}-1") for name in "abc"]
    fleet_of(tmp_path, rows)
    with open_store(tmp_path) as store:
        assert summaries(store) == ["a 1", "b 2", "c 3"]
        assert cached_charts(store, "b", make) == cached_charts(store, "b", make) == "b 4"
    fleet_of(tmp_path, [flight_row("b", 1, key="new-1")])
    with open_store(tmp_path) as store:
        assert summaries(store) == ["a 1", "b 5", "c 3"]
        assert cached_charts(store, "b", make) == "b 6"
        # What was made by another version is made again.
        assert summaries(store, "2") == ["a 7", "b 8", "c 9"]


@mark.slow
def test_a_damaged_summary_is_made_again(tmp_path):
    whole_index = index_of(tmp_path, fleet_rows(7))
    with open_store(tmp_path) as store:
        store.db.execute("update vehicle_parts set summary = '{'")
        assert write_fleet_pages(store, {}).index.read_text() == whole_index
