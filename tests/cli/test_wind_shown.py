"""The wind in m/s of a flight is the same on screen, page, table and row, and in files."""

import csv
import json
import re
from math import degrees

import numpy as np
import pytest
from mcap.reader import make_reader

from mavdem import wind
from mavdem.cli.commands import main
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.report.fleet_page import fleet_page
from mavdem.report.numbers import from_point
from sitl_scenarios.files import in_toml, scenario_of

pytestmark = pytest.mark.slow
LEGS = [{"north": 15, "speed": 6}, {"east": 15, "speed": 6}, {"north": -15, "speed": 6, "turn": 90}]
FLIGHT = {
    "duration": 48,
    "wind": [{"kind": "dryden", "speed": 6, "direction": 240, "wind_at_20_feet": 5}],
    "excitation": {"kind": "course", "moves": [*LEGS, {"east": -15, "speed": 6}]},
    "stream": {"rates": {"WIND_COV": 2}, "drag_calibrated": True},
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wind")
    (folder / "legs.toml").write_text(in_toml(scenario_of(FLIGHT)))
    assert main(["fly", str(folder / "legs.toml"), "--out", str(folder / "legs.tlog")]) == 0
    words = ["learn", str(folder / "legs.tlog"), "--out", str(folder / "learnt"), "--train", "5s", "--test", "50"]
    assert main(words) == 0
    return folder


def test_report_page_and_screen_have_it_with_the_autopilots_own(flown, capsys):
    found, report = wind(flown / "legs.tlog"), json.loads((flown / "learnt" / "report.json").read_text())
    told = report["wind_velocity"]
    assert (told["speed"], told["direction"]) == (found.speed, found.direction)
    assert abs((told["direction"] - 240 + 180) % 360 - 180) < 15
    # The simulated autopilot says the true wind, which is within the interval.
    low, high = told["speed_interval"]
    assert main(["info", str(flown / "legs.tlog")]) == 0
    words = f"Wind: {found.speed:.1f} m/s ("
    said = capsys.readouterr().out
    assert words in said
    assert low < float(re.search(r"own estimate is ([0-9.]+) m/s from", said)[1]) < high
    page = (flown / "learnt" / "report.html").read_text()
    assert f"{found.speed:.1f} m/s (" in page and "autopilot's own" in page and "Wind in m/s" in page


def test_files_have_its_course_and_the_path(flown):
    found = wind(flown / "legs.tlog")
    with (flown / "learnt" / "flight.mcap").open("rb") as file:
        read = [json.loads(message.data) for _, _, message in make_reader(file).iter_messages(["wind/velocity"])]
    np.testing.assert_allclose([[row["north"], row["east"]] for row in read], found.velocity)
    assert main(["convert", str(flown / "legs.tlog"), str(flown / "legs.csv")]) == 0
    rows = list(csv.DictReader((flown / "legs.csv").read_text().splitlines()))
    time, north = (np.array([float(row[name]) for row in rows]) for name in ("time_s", "wind_north_m_s"))
    inside = (time >= found.time[0]) & (time <= found.time[-1])
    expected = np.interp(time[inside], found.time, found.velocity[:, 0])
    np.testing.assert_allclose(north[inside], expected, atol=1e-5)
    assert np.isnan(north[~inside]).all()


def test_a_fleet_has_its_columns_and_a_rose(flown):
    found, (rows, _) = wind(flown / "legs.tlog"), rows_of_log(flown / "legs.tlog")
    (row, *_) = rows
    assert (row.wind_speed, row.wind_speed_interval) == (found.speed, found.speed_interval)
    assert degrees(row.wind_direction) == pytest.approx(found.direction)
    assert row.drag == pytest.approx([*found.drag.linear, *found.drag.quadratic])
    assert from_point(found.direction) in fleet_page(rows)
