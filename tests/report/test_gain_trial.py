"""Charts of advised gains over those that flew: steps of both loops, and motions of the twin."""

import numpy as np
from made_up_loop import made_up
from partial_records import partial_record
from pytest import approx, mark

from mavdem.assessment.axis.twin import GainTrial, TwinMotion, samples_of_most_movement
from mavdem.assessment.evidence import Evidence
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact, LoopFact
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.twin_flight import ReplaySegment
from mavdem.report.charts import gain_trial
from mavdem.report.charts.chart import Axis, Chart, Line, LineStyle
from mavdem.report.charts.gain_trial import gain_trial_groups
from mavdem.report.pages.tune_page import _step_caption
from mavdem.report.palette import PHYSICAL, PREDICTED

WITHOUT_TWIN = partial_record(Evidence, loops={"roll": Fact(LoopFact.LOOP_TOO_SHORT)})


@mark.slow
def test_steps_of_both_gains_are_drawn_over_each_other():
    """Step responses of the present and of the advised gains; pitch has no loop."""
    advice = {"roll": advise(made_up(4.5)), "pitch": Fact(LoopFact.LOOP_TOO_SHORT)}
    groups = gain_trial_groups(WITHOUT_TWIN, advice)
    assert groups.keys() == {"roll"}
    charts = [chart for column in groups["roll"].columns for chart in column]
    assert [chart.title for chart in charts] == [
        "Roll rate: identified step",
        "Roll attitude: identified step",
    ]
    for chart in charts:
        advised, now = chart.lines
        assert (now.style, advised.style) == (LineStyle.DASHES, LineStyle.LINE)
        assert (now.name, advised.name) == ("now", "new")
        for line in (now, advised):
            assert abs(line.y[0]) < 0.05 and line.y[-1] == approx(1, abs=0.15)
    rate_advised, rate_now = charts[0].lines
    assert rate_now.y.max() > rate_advised.y.max() > 1, "the advised gains overshoot less"


def test_the_caption_of_steps_explains_only_what_is_drawn():
    axis = Axis("time (s)")
    now, advised = (
        Chart("", axis, axis, (Line("", colour, np.arange(2.0), np.arange(2.0)),))
        for colour in (PREDICTED, PHYSICAL)
    )
    assert "setpoint. “Predicted”" in _step_caption({"roll": {"rate": [now]}})
    caption = _step_caption({"roll": {"rate": [now, advised]}})
    assert "“New”" in caption and "“Measured”" not in caption


def test_kept_gains_say_how_many_models_have_the_margins_with_and_without_other_thrust():
    figures = {"share": 0.17, "share_as_flown": 0.68, "has_room": False, "can_go_on": False}
    fact = Fact(GainFact.KEEP_GAINS, **figures, **MARGIN_TARGETS["default"]._asdict())
    assert "68 % have them with its thrust, and 17 % with 20 % more or less, too." in fact.sentence


@mark.slow
def test_kept_gains_are_not_compared():
    assert not gain_trial_groups(WITHOUT_TWIN, {"roll": advise(made_up(1.0))})


@mark.slow
def test_motions_of_the_twin_stand_below_the_steps_with_their_errors(monkeypatch):
    """The simulated twin follows a setpoint with both gains, and hovers in wind."""
    time = np.arange(0, 12, 0.1)
    setpoint = np.where((time > 5) & (time < 8), 0.1, 0.0)
    motion = TwinMotion(time, setpoint, setpoint + 0.02 * np.sin(time), 0.5 * setpoint)
    hover = motion._replace(setpoint=np.zeros_like(time))
    trial = GainTrial({"roll": motion}, {"roll": hover})
    monkeypatch.setattr(gain_trial, "try_gains", lambda *_, **__: trial)
    groups = gain_trial_groups(WITHOUT_TWIN, {"roll": advise(made_up(4.5))})
    (_, tracking), (_, wind) = groups["roll"].columns
    assert [line.name for line in tracking.lines] == ["setpoint", "new", "now"]
    assert [line.name for line in wind.lines] == ["new", "now"]
    assert tracking.lines[0].y.max() == approx(np.degrees(0.1))
    assert f"{motion.present_error:.2g}° now, {motion.expected_error:.2g}° new" in tracking.title


def test_the_twin_repeats_the_part_in_which_the_setpoint_moves_most():
    time = np.arange(0, 60, 0.1)
    angle_setpoint = np.where((time > 40) & (time < 43), 0.1, 0.0)
    setpoints = np.column_stack([angle_setpoint, np.zeros_like(time)])
    segment = ReplaySegment(np.zeros_like(setpoints), setpoints)
    repeated = time[samples_of_most_movement({"roll": segment}, 0.1)]
    assert repeated[0] < 37 and repeated[-1] > 42.8, "the movement, after three seconds to settle"
    assert len(repeated) == 150
    short = ReplaySegment(setpoints[:50], setpoints[:50])
    assert len(time[:50][samples_of_most_movement({"roll": short}, 0.1)]) == 50
