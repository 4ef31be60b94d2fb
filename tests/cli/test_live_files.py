"""The end of ``mavdem live``: the files that were written, what opens them, and why there are no gains."""

from pathlib import Path

from mavdem.cli.live_files import (
    OutputPaths,
    gain_file_line,
    lines_without_gains,
    written_file_lines,
)
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact, LoopAction, LoopFact
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
        "Page: f.html. Open it in a browser.",
        "Model: f.model.json. For the next flight: `--prior f.model.json`",
    ]
    assert written_file_lines(OutputPaths(None, None, None, None), frame_count=0) == []


def test_without_advised_gains_the_reason_is_printed():
    flown = NOTHING | {TimeUse.UNSETTLED: 9.0}
    reason = Fact(GainFact.LAG_UNRESOLVED, time_step=0.01)
    left = Fact(GainFact.GAINS_LEFT, reason=Fact(GainFact.ADVICE_WAITS))
    failed = Fact(GainFact.ADVICE_FAILED, error="", duration=30.0, path="f.tlog")
    # Two sentences, of which the first says that there are no gains.
    refused = Fact(GainFact.NO_GAINS_ADVISED, reasons=(reason,))
    refused_left = Fact(GainFact.GAINS_LEFT, reason=refused)
    yaw = Fact(LoopFact.NO_LOOP, names=("yaw",), reasons=(reason,))
    no_loop_left = Fact(GainFact.GAINS_LEFT, reason=Fact(LoopFact.NO_LOOP, reasons=(yaw, failed)))
    written = Fact(GainFact.GAINS_WRITTEN, path="f.gains.stage1.params and .param", reason=reason)
    [unrecorded] = lines_without_gains(None, NOTHING)
    assert "--record FILE.tlog" in unrecorded
    assert gain_file_line((written,)).endswith("Load one file in a ground station on trial.")
    grounded = gain_file_line((written,), is_flight_forbidden=True)
    assert grounded.endswith("once the vehicle may fly again, on trial.")
    assert lines_without_gains((), NOTHING) == ["No gains: nothing flew."]
    [unsettled] = lines_without_gains((), flown)
    assert unsettled.startswith("No gains: too little settled flight")
    [waiting] = lines_without_gains((left,), flown)
    assert waiting.startswith("No gains: gains are advised when")
    assert lines_without_gains((refused_left,), flown) == lines_without_gains((reason,), flown)
    assert lines_without_gains((no_loop_left,), flown) == lines_without_gains((reason,), flown)
    assert lines_without_gains((failed,), flown) == [failed.sentence]
    decision = Fact(LoopAction.LOOPS_JUDGED, axis="pitch", reason=yaw)
    [of_pitch] = lines_without_gains((decision,), flown)
    assert of_pitch.startswith("No gains for pitch: ")
    # A reason with a subject of its own holds for all axes.
    of_motor = Fact(
        GainFact.GAINS_LEFT,
        axes=("roll",),
        reason=Fact(GainFact.LAG_UNRESOLVED, subject="motor 3", time_step=0.01),
    )
    [of_all_axes] = lines_without_gains((of_motor,), flown)
    assert of_all_axes.startswith("No gains: ")
    assert "f.gains.stage1.params and .param" in gain_file_line((reason, written))


def test_the_end_of_a_session_says_of_every_axis_what_becomes_of_its_gains():
    """Axes with the same reason share a line."""
    reason = Fact(GainFact.LAG_UNRESOLVED, time_step=0.01)
    left = Fact(GainFact.GAINS_LEFT, axes=("roll", "pitch"), reason=reason)
    advised = Fact(GainFact.GAINS_ADVISED, subject="yaw")
    [tried, together] = lines_without_gains((advised, left), NOTHING)
    assert tried.startswith("No gains for yaw yet: another flight")
    assert together.startswith("No gains for roll and pitch: ")
    written = Fact(GainFact.GAINS_WRITTEN, path="f.params", reason=reason)
    assert gain_file_line((advised, left, written)).startswith("Gains for yaw: f.params.")
    assert lines_without_gains((advised, left, written), NOTHING) == [together]
