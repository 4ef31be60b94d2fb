"""Charts of the hardware: what the log has within the time shown, and nothing that stands for "not known"."""

import numpy as np
from hover import Hover, changed, columns, evidence_of

from mavdem.dataset.signals import Signals
from mavdem.report.charts.hardware_charts import hardware_groups
from mavdem.report.charts.timeline import timeline_of_history

HOVER = Hover()
TIME = HOVER.stamps(5.0)


def charts_by_title(telemetry):
    """The charts of the hardware of a vehicle by their titles."""
    evidence = evidence_of(Signals(telemetry))
    timeline = timeline_of_history(evidence.time_history)
    charts = {}
    for group in hardware_groups(evidence, timeline):
        for column in group.columns:
            charts |= {chart.title: chart for chart in column}
    return charts, timeline


def test_speeds_compasses_and_reported_quantities_are_drawn_in_plain_units():
    telemetry = HOVER.telemetry(20.0, 20.0)
    controllers = columns(
        np.repeat(TIME, 2),
        Instance=np.tile([0, 1], len(TIME)),
        RPM=np.column_stack([5000 + TIME, 4000 + TIME]).ravel(),
    )
    telemetry = changed(telemetry, "ESC", **controllers)
    telemetry = changed(
        telemetry, "SCALED_IMU", **columns(TIME, xmag=300.0, ymag=0.0, zmag=400.0, temperature=0)
    )
    current = np.full(len(TIME), 1250)
    # The first values are not known.
    current[:20] = -1
    power = columns(TIME, current_battery=current, load=305)
    telemetry = changed(telemetry, "SYS_STATUS", **power)
    # At the freezing point: MAVLink has no value for a barometer temperature that is not known.
    pressure = columns(TIME, press_abs=1000.0, temperature=np.where(np.median(TIME) > TIME, 0, 100))
    telemetry = changed(telemetry, "SCALED_PRESSURE", **pressure)
    charts, timeline = charts_by_title(telemetry)
    assert [line.name for line in charts["Motor speeds"].lines] == ["ESC 1", "ESC 2"]
    compass, motors = charts["Magnetic field"].lines
    np.testing.assert_allclose(compass.y, 500)
    assert motors.is_on_right_axis
    np.testing.assert_allclose(charts["Battery current"].lines[0].y, 12.5)
    np.testing.assert_allclose(charts["Processor load"].lines[0].y, 30.5)
    assert set(charts["Barometer temperature"].lines[0].y) == {0, 1}
    assert charts["Motor speeds"].x.limits == timeline.span
    # 0 stands for an IMU temperature that is not known.
    assert "IMU temperature" not in charts


def test_a_log_without_such_messages_has_no_charts():
    telemetry = HOVER.telemetry(20.0, 20.0)
    kept = {"ATTITUDE", "HEARTBEAT", "SERVO_OUTPUT_RAW"}
    for message in set(telemetry.messages) - kept:
        telemetry = changed(telemetry, message, time=np.zeros(0), boot=np.zeros(0, int))
    charts, _ = charts_by_title(telemetry)
    assert not charts
