"""The end of ``mavdem live``: the files that were written, what opens them, and why there are no gains."""

from pathlib import Path

from mavdem.cli.live_files import (
    OutputPaths,
    gain_file_line,
    line_without_gains,
    written_file_lines,
)
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact
from mavdem.facts.session import TimeUse

NOTHING = dict.fromkeys(TimeUse, 0.0)


def test_each_written_file_has_a_line_with_what_opens_it():
    paths = OutputPaths(
        rrd=Path("f.rrd"),
        record=Path("my flight.tlog"),
        model=Path("f.model.json"),
        page=Path("f.html"),
    )
    lines = written_file_lines(paths, frame_count=12_345)
    assert lines == [
        "Recording: my flight.tlog, 12,345 messages. Judge it: `mavdem 'my flight.tlog'`",
        "Dashboard: f.rrd. Open it: `rerun f.rrd`",
        f"Page: f.html. Open it: {Path('f.html').absolute().as_uri()}",
        "Model: f.model.json. For the next flight: `--prior f.model.json`",
    ]
    # The model of a vehicle that must not fly before a repair is no prior of its next flight.
    *_, model_line = written_file_lines(paths, frame_count=12_345, is_flight_forbidden=True)
    assert model_line == "Model: f.model.json"
    page_alone = OutputPaths(None, None, None, page=Path("f.html"))
    [line_of_page] = written_file_lines(page_alone, frame_count=0, is_for_browser=True)
    assert line_of_page == "Page: f.html. It has what this page shows, and the model."
    assert written_file_lines(OutputPaths(None, None, None, None), frame_count=0) == []


def test_without_advice_on_gains_the_reason_is_printed():
    """The reasons that advice itself has were reported when it came."""
    flown = NOTHING | {TimeUse.UNSETTLED: 9.0}
    assert "--record FILE.tlog" in line_without_gains(None, NOTHING)
    assert line_without_gains(None, NOTHING, is_recording_cut=True).endswith(
        "lacks the end of the flight."
    )
    assert line_without_gains((), NOTHING) == "No gains: nothing flew."
    assert line_without_gains((), flown).startswith("No gains: too little settled flight")
    left = Fact(GainFact.GAINS_LEFT, reason=Fact(GainFact.LAG_UNRESOLVED, time_step=0.01))
    assert not line_without_gains((left,), flown)


def test_the_end_of_a_session_names_the_files_with_gains_or_what_is_to_confirm_them():
    reason = Fact(GainFact.LAG_UNRESOLVED, time_step=0.01)
    left = Fact(GainFact.GAINS_LEFT, axes=("roll", "pitch"), reason=reason)
    advised = Fact(GainFact.GAINS_ADVISED, subject="yaw")
    unconfirmed = line_without_gains((advised, left), NOTHING)
    assert unconfirmed.startswith("No gains for yaw yet: another flight")
    written = Fact(GainFact.GAINS_WRITTEN, path="f.params and .param", reason=reason)
    files = gain_file_line((advised, left, written))
    assert (
        files == "Gains for yaw: f.params and .param. Load one file in a ground station on trial."
    )
    grounded = gain_file_line((written,), is_flight_forbidden=True)
    assert grounded.endswith("once the vehicle may fly again, on trial.")
    assert not line_without_gains((advised, left, written), NOTHING)
