"""``mavdem diff``: two fleets, two reports, or two logs in words or as one document, and refusals with their reason."""

from pathlib import Path

from command_line import document_of, refused, run
from fleet_rows import WEAK, flight_row
from pytest import fixture, mark
from standin_logs import fleet_of

from mavdem.fleet.difference import vehicle_difference
from mavdem.fleet.row import FlightRow
from mavdem.report.pages.difference_page import comparison_page


def flown(vehicle, numbers, **changed):
    return [
        flight_row(vehicle, number, axis, **changed)
        for number in numbers
        for axis in ("roll", "pitch")
    ]


pytestmark = mark.usefixtures("here")


@fixture
def fleets(tmp_path):
    fleet_of(tmp_path / "old", [*flown("alpha", range(4)), *flown("beta", range(2))])
    fleet_of(tmp_path / "new", [*flown("alpha", range(4, 8), **WEAK), *flown("gamma", range(2))])
    return str(tmp_path / "old"), str(tmp_path / "new")


@mark.slow
def test_the_vehicle_that_both_fleets_have_is_compared(fleets, capsys):
    assert run("diff", *fleets) == 0
    said = capsys.readouterr().out
    assert "Changed: motor 3's share +12" in said and "4 flights of A and 4 flights of B" in said
    assert said.endswith("Next: Inspect motor 3 and its propeller before the next flight.\n\n")
    assert "Motor 3&#39;s " in Path("old_and_new/diff.html").read_text()
    changes = document_of(capsys, "diff", *fleets, "--vehicle", "alpha")["changes"]
    changed = [one["quantity"] for one in changes if one["outcome"] == "changed"]
    assert [(one["kind"], one["motor"]) for one in changed] == [("share", 3), ("effect", 3)]


def test_a_page_that_something_is_in_the_way_of_is_refused(fleets, capsys):
    Path("out/diff.html").mkdir(parents=True)
    said = refused(capsys, 2, "diff", *fleets, "--out", "out")
    assert "out/diff.html cannot be written (it is a folder)" in said


@mark.slow
@mark.parametrize(
    "line, reason",
    {
        "old new --vehicle delta": "A has no vehicle delta. Choose one of: alpha and beta.",
        "old new --vehicle beta": "B has no vehicle beta.",
        "old old": "Choose with --vehicle: alpha and beta.",
        "nobody nobody": "do not say of which vehicle",
    }.items(),
)
def test_a_vehicle_that_cannot_be_chosen_is_refused_with_those_that_can(
    line, reason, fleets, monkeypatch, capsys
):
    monkeypatch.chdir(Path(fleets[0]).parent)
    fleet_of(Path("nobody"), flown("unknown", range(3)))
    assert reason in refused(capsys, 1, "diff", *line.split())


def test_logs_are_read_and_a_log_without_a_flight_says_why(monkeypatch, tmp_path, capsys):
    rows = {
        "a.bin": flown("alpha", [0], system=4, collective=0.4),
        "b.bin": [FlightRow(file="b.bin", status="It is empty.")],
        "c.bin": flown("alpha", [1], trim_share_interval=(0.2,) * 4),
    }
    monkeypatch.setattr("mavdem.fleet.state.rows_of_log", lambda path, *_: (rows[path.name], {}))
    assert run("diff", "a.bin", "a.bin", "--vehicle", "4:1") == 0
    assert "A and B are the same flight: name another" in capsys.readouterr().out
    assert run("diff", "a.bin", "c.bin", "--vehicle", "alpha") == 0
    assert "No single change is certain." in capsys.readouterr().out
    for _ in range(2):
        assert run("diff", "a.bin", "other/c.bin", "--vehicle", "alpha") == 0
        assert "a_and_c-2/diff.html" in capsys.readouterr().err
    assert {path.name for path in Path().iterdir()} == {"a_and_a", "a_and_c", "a_and_c-2"}
    said = refused(capsys, 1, "diff", "a.bin", "b.bin")
    assert "B has no flight with figures. It is empty." in said


def test_a_margin_without_an_upper_end_is_not_called_apart():
    def review(**ends):
        rates = {
            axis: {"phase_margin": low, "phase_margin_interval": (low, high)}
            for axis, (low, high) in ends.items()
        }
        return {"axes": {axis: {"loop": {"rate": rate}} for axis, rate in rates.items()}}

    flight = flown("alpha", [0])
    reviews = review(roll=(70, 80), yaw=(80, None)), review(roll=(40, 60), yaw=(30, 50))
    page = comparison_page(("a", "b"), reviews, vehicle_difference(flight, flight))
    assert "The phase margin of roll fell from 70 to 40°." in page
