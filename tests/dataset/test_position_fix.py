"""A receiver that falls silent has no fix beside one that goes on."""

import numpy as np
from pytest import mark

from mavdem.dataset.position_fix import has_position_fix
from mavdem.ingest.telemetry import Telemetry


def receiver(end, fix_type, step=0.2):
    """Messages of a satellite receiver from 0 s on."""
    time = np.arange(0.0, end, step)
    return {
        "time": time,
        "boot": np.zeros(len(time), np.int64),
        "fix_type": np.full(len(time), fix_type),
        "satellites_visible": np.full(len(time), 12),
    }


def fix_at(time, **receivers):
    vehicle = Telemetry(
        1, 1, vehicle="QUADROTOR", autopilot="PX4", messages=receivers, parameters={}, source=""
    )
    return bool(has_position_fix(vehicle, 0, np.array([time]))[0])


@mark.parametrize("time, has_fix", [(9.0, True), (13.0, True), (40.0, False)])
def test_the_fix_of_a_silent_second_receiver_does_not_last(time, has_fix):
    first = receiver(60.0, fix_type=1)
    second = receiver(10.0, fix_type=3)
    assert fix_at(time, GPS_RAW_INT=first, GPS2_RAW=second) is has_fix


def test_the_fix_of_the_only_receiver_lasts_where_it_is_not_recorded_further():
    assert fix_at(60.0, GPS_RAW_INT=receiver(10.0, fix_type=3))


def test_a_fix_lasts_from_message_to_message_of_a_slow_stream():
    slow = receiver(60.0, fix_type=3, step=4.0)
    assert fix_at(55.0, GPS_RAW_INT=receiver(60.0, fix_type=1), GPS2_RAW=slow)
