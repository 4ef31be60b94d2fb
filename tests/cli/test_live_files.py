"""The end of ``mavdem live``: the files that were written, what opens them, and why there are no gains."""

from pathlib import Path

from mavdem.cli.live_files import OutputPaths, gains_line, written_file_lines
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
    assert "--record FILE.tlog" in gains_line(None, NOTHING)
    assert gains_line((written,), flown).endswith("Load one file in a ground station on trial.")
    grounded = gains_line((written,), flown, is_flight_forbidden=True)
    assert grounded.endswith("once the vehicle may fly again, on trial.")
    assert gains_line((), NOTHING) == "No gains: nothing flew."
    assert gains_line((), flown).startswith("No gains: too little settled flight")
    assert gains_line((left,), flown).startswith("No gains: gains are advised when")
    assert gains_line((refused_left,), flown) == gains_line((reason,), flown)
    assert gains_line((no_loop_left,), flown) == gains_line((reason,), flown)
    assert gains_line((failed,), flown) == failed.sentence
    decision = Fact(LoopAction.LOOPS_JUDGED, axis="pitch", reason=yaw)
    assert gains_line((decision,), flown).startswith("No gains for pitch: ")
    # A reason with a subject of its own holds for all axes.
    of_motor = Fact(
        GainFact.GAINS_LEFT,
        subject="roll",
        reason=Fact(GainFact.LAG_UNRESOLVED, subject="motor 3", time_step=0.01),
    )
    assert gains_line((of_motor,), flown).startswith("No gains: ")
    assert "f.gains.stage1.params and .param" in gains_line((reason, written), flown)
