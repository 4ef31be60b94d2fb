"""The wind in m/s of a flight is the same on screen, page, row and in files, beside the autopilot's own."""

import json
from dataclasses import replace
from math import degrees

import numpy as np
from command_line import run, unwrapped
from pytest import approx, mark
from recorded_flights import SLOW

from mavdem import wind
from mavdem.facts.identifiability import Status
from mavdem.fleet.priors import earlier_drag
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.ingest.parameter_file import read_parameters
from mavdem.report.pages.fleet_page import fleet_page
from mavdem.report.vehicle_summary import vehicle_summaries
from mavdem.wind_velocity.compass import compass_text, compass_words
from mavdem.wind_velocity.vehicle_drag import Drag
from sitl_scenarios.files import load, scenario_toml

pytestmark = mark.slow


def test_the_page_of_a_log_without_wind_says_why_and_what_to_do(tmp_path, capsys):
    assert run("wind", SLOW, "--out", tmp_path) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["wind.html"]
    page = (tmp_path / "wind.html").read_text()
    *_, refusal = capsys.readouterr().err.splitlines()
    sentence, remedy = refusal.removeprefix("mavdem: ").split(". ", 1)
    assert sentence in page and remedy in page


@mark.usefixtures("coarse_physics", "without_pages", "logs_read_once")
def test_the_wind_is_shown_as_it_is_estimated(tmp_path, capsys):
    log = tmp_path / "legs.tlog"
    legs = load("wind_legs")
    course = legs.excitation.model_copy(update={"moves": legs.excitation.moves[:4]})
    legs = legs.model_copy(update={"height": 6.0, "excitation": course})
    (tmp_path / "legs.toml").write_text(scenario_toml(legs).replace("\nrate = 20.0", "\nrate = 50"))
    assert run("fly", tmp_path / "legs.toml", "--duration", "62", "--out", log) == 0
    learnt = tmp_path / "learnt"
    estimate = wind(log)
    assert (
        run("learn", log, "--out", learnt, "--mcap", "--verbose", "--train", "5s", "--test", "25")
        == 0
    )
    output = unwrapped(capsys.readouterr().out)
    (low, high) = estimate.mean_speed_interval
    origin = compass_words(estimate.direction, estimate.direction_interval).replace("\xa0", " ")
    assert (
        f"mean speed {estimate.mean_speed:.1f} m/s ({low:.1f} to {high:.1f}) from {origin}, gusts"
        in output
    )
    assert (
        json.loads((learnt / "report.json").read_text())["wind_velocity"]["speed"] == estimate.speed
    )
    assert b"wind/velocity" in (learnt / "flight.mcap").read_bytes()
    assert run("convert", log, tmp_path / "legs.csv") == 0
    table = np.genfromtxt(tmp_path / "legs.csv", delimiter=",", names=True)
    off = (
        np.interp(estimate.time, table["time_s"], table["wind_north_m_s"]) - estimate.velocity[:, 0]
    )
    assert np.nanmax(abs(off)) < 0.02 and np.isnan(table["wind_east_band_m_s"][0])
    (row, *_), _ = rows_of_log(log)
    earlier = earlier_drag(learnt / "model.json").drag
    assert earlier.linear == approx(row.drag[:2]) and earlier.relative_sd(5) < 0.2
    assert (row.wind_speed, degrees(row.wind_direction)) == approx(
        (estimate.mean_speed, estimate.direction)
    )
    # A list shows the interval of the speed.
    vague = replace(row, wind_speed_interval=(1.9, 8.0))
    direction = compass_text(estimate.direction)
    assert f"1.9 to 8.0 {direction}" in fleet_page(vehicle_summaries([vague]))
    assert run("wind", log, "--out", tmp_path / "wind") == 0
    page = (tmp_path / "wind" / "wind.html").read_text()
    # The edge of the result is green only of a speed that no bias may have shifted.
    is_reported = estimate.status["speed"] is Status.REPORTED
    assert ('class="blocks assessment"' in page) is is_reported
    for title in (
        "Wind over time",
        "Speed through the air",
        "Flown path",
        "Wind rose",
        "Drag, from",
    ):
        assert title in page
    # What the estimate rests on is folded below the charts.
    assert page.index("How certain:") < page.index("Wind over time")
    assert page.index("Wind over time") < page.index("Checked against:")
    assert json.loads((tmp_path / "wind" / "wind.json").read_text())["speed"] == estimate.speed
    document = json.loads((tmp_path / "wind" / "wind.json").read_text())
    drag_parameters = read_parameters(tmp_path / "wind" / "drag.params")
    values = {name: setting[0] for name, setting in document["parameters"].items()}
    assert drag_parameters == approx(values) and values
    assert 'download="legs.drag.params"' in page
    heading = (tmp_path / "wind" / "drag.params").read_text().splitlines()[0]
    assert "EKF2_DRAG_CTRL 1 switches on" in heading
    # A flight's log is a prior for another one, as its documents are.
    for earlier_flight in (log, tmp_path / "wind"):
        drag = earlier_drag(earlier_flight).drag
        assert drag.mean == approx(estimate.drag.for_next_flight().mean)
    for this_flight in (learnt, tmp_path / "wind", log):
        assert run("wind", log, "--prior", this_flight) == 2
        assert "of this very flight" in capsys.readouterr().err
    # An earlier flight that shows no drag changes nothing, and is said to do so.
    (tmp_path / "earlier.json").write_text(json.dumps({"drag": Drag.from_parameters().as_dict()}))
    capsys.readouterr()
    assert run("wind", log, "--prior", tmp_path / "earlier.json") == 0
    output = unwrapped(capsys.readouterr().out)
    assert "does not show its drag: it adds nothing" in output
    assert f"mean speed {estimate.mean_speed:.1f} m/s ({low:.1f} to {high:.1f})" in output
