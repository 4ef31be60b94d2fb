"""Figures by which motors of flights are compared, and which flights may be healthy ones to compare with."""

from fleet_rows import flight_row
from pytest import mark

from mavdem.fleet.health_figures import health_figures


def test_a_flight_without_faults_is_sound():
    figures = health_figures(flight_row("001a", 1, headline_level="watch", headline_rank=2))
    assert figures.sound


@mark.parametrize(
    "fault",
    [
        {"headline_level": "bad", "headline_rank": 0},
        {"light_motors": "bad"},
        {"oscillation": 0.2},
        {"saturated": (0.0, 0.02, 0.0, 0.0)},
    ],
    ids=["lost", "bad motors", "oscillates", "at the limit"],
)
def test_no_flight_is_compared_with_one_that_shows_a_fault_by_itself(fault):
    assert not health_figures(flight_row("001a", 1, **fault)).sound


@mark.parametrize(("end", "effort"), [(12.6, None), (12.5, 0.5 * 12.6)])
def test_the_effort_is_unknown_where_the_voltage_is_a_constant_that_no_sensor_measured(end, effort):
    row = flight_row(
        "001a", 1, voltage_start=12.6, voltage_end=end, voltage_mean=12.6, collective=0.5
    )
    assert health_figures(row).effort == effort
