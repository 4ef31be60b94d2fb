"""Charts of the flights of two logs over each other."""

import numpy as np
from hover import Hover, only

from mavdem.dataset.signals import Signals
from mavdem.report.charts.comparison_charts import flight_history_charts, longest_flight

FLOWN = Hover(sway=0.2).telemetry(20.0, 20.0)


def test_a_flight_that_began_before_the_record_is_drawn_from_its_beginning_on():
    begun = only(FLOWN, lambda time: time > 20.0)
    start, _ = longest_flight(Signals(begun)).interval
    assert start == begun.messages["ATTITUDE"]["time"][0]
    charts = flight_history_charts({"before": begun}, {"before": "before"}, {"before": "blue"})
    for chart in charts:
        assert np.isfinite(chart.lines[0].x).all()
        assert chart.lines[0].x[0] < 1.0
