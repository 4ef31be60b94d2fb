"""Feed-forward of its setpoint as the cause that an axis moves further than the setpoint."""

from unittest.mock import Mock

import numpy as np
from hover import Hover
from made_up_loop import made_up
from pytest import approx, mark

from mavdem.assessment.axis.feedforward import feedforward_finding
from mavdem.facts import Fact
from mavdem.facts.margins import TrackingLight
from mavdem.loops.attitude_response import predicted_attitude_response
from mavdem.loops.rate_setpoint import RATE_FEEDFORWARD_PARAMETER


def evidence_of(ratio, frequency, switch):
    """A vehicle whose roll moves this many times as far as its setpoint, with feed-forward switched on or off."""
    telemetry = Hover().telemetry(parameters={RATE_FEEDFORWARD_PARAMETER: switch})
    evidence = Mock(loops={"roll": made_up()})
    evidence.tracking = {
        "roll": Fact(TrackingLight.AMPLIFIES_SETPOINT, ratio=ratio, frequency=frequency)
    }
    evidence.signals.for_axis = Mock(return_value=Mock(telemetry=telemetry))
    return evidence


@mark.parametrize(
    "switch, is_far, is_cause", [(1, True, True), (1, False, False), (0, True, False)]
)
def test_feedforward_is_the_cause_where_the_gains_alone_would_move_the_angle_less(
    switch, is_far, is_cause, monkeypatch
):
    monkeypatch.setattr("mavdem.assessment.axis.feedforward.settled_flight", Mock())
    frequency = 3.0
    predicted = {}
    for has_feedforward in (False, True):
        response = predicted_attitude_response(made_up(), has_feedforward=has_feedforward)
        predicted[has_feedforward] = np.interp(
            frequency, made_up().attitude.frequency, abs(response)
        )
    ratio = float(predicted[is_far])
    finding = feedforward_finding(evidence_of(ratio, frequency, switch), "roll")
    assert (finding is not None) is is_cause
    if finding is not None:
        assert finding.figures["ratio_with_feedforward"] == approx(predicted[True])
        assert finding.figures["ratio_without_feedforward"] < finding.figures["ratio"]
        assert f"({RATE_FEEDFORWARD_PARAMETER})" in finding.remedy
    steady = evidence_of(ratio, frequency, switch)
    steady.tracking = {"roll": Fact(TrackingLight.FOLLOWS_SETPOINT)}
    assert feedforward_finding(steady, "roll") is None
