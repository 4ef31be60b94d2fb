"""The parameters as they were in a flight, in a log of several boots."""

from dataclasses import replace

import numpy as np
from hover import Hover, columns

from mavdem.dataset.parameter_history import BootTime, parameter_history_of
from mavdem.dataset.segments import Segment

REPORTS = [
    (0, 1.0, "ATC_RAT_RLL_P", 0.1),
    (0, 1.0, "ATC_ANG_RLL_P", 4.5),
    (0, 50.0, "ATC_RAT_RLL_P", 0.2),
    (0, 51.0, "ATC_RAT_RLL_P", np.nan),
    # The second boot reports nothing, and the third one the value of the first.
    (2, 20.0, "ATC_RAT_RLL_P", 0.1),
    (2, 20.0, "ATC_ANG_RLL_P", 4.5),
]
"""Boot, time, name and value of each report."""


def history():
    boots, times, names, values = zip(*REPORTS, strict=True)
    reports = columns(
        np.array(times),
        param_id=np.array([name.encode() for name in names]),
        param_type=9,
        param_value=np.array(values),
    )
    reports["boot"] = np.array(boots)
    last_values = {"ATC_RAT_RLL_P": 0.1, "ATC_ANG_RLL_P": 4.5, "FRAME_CLASS": 1.0}
    telemetry = Hover().telemetry()
    messages = {**telemetry.messages, "PARAM_VALUE": reports}
    return parameter_history_of(replace(telemetry, messages=messages, parameters=last_values))


def test_a_value_holds_until_another_one_is_reported_also_in_later_boots():
    values = [
        history().at(BootTime(boot, time))["ATC_RAT_RLL_P"]
        for boot, time in [(0, 0.0), (0, 49.0), (0, 50.0), (1, 0.0), (2, 19.0), (2, 20.0)]
    ]
    assert values == [0.1, 0.1, 0.2, 0.2, 0.2, 0.1]
    # A parameter that never changed needs no report.
    assert history().at(BootTime(0, 0.0))["FRAME_CLASS"] == 1.0


def test_only_what_had_one_value_in_all_segments_has_a_value():
    first, second, third = Segment(0, 10.0, 40.0), Segment(1, 10.0, 40.0), Segment(2, 30.0, 60.0)
    for segments, value in [([first], 0.1), ([second], 0.2), ([first, third], 0.1)]:
        parameters = history().during(segments)
        assert (parameters.values["ATC_RAT_RLL_P"], parameters.changed_names) == (value, ())
    for segments in ([first, second], [Segment(0, 40.0, 60.0)]):
        parameters = history().during(segments)
        assert parameters.changed_names == ("ATC_RAT_RLL_P",)
        assert "ATC_RAT_RLL_P" not in parameters.values
        assert parameters.any_values["ATC_RAT_RLL_P"] == 0.1
