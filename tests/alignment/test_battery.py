"""The battery's voltage: which message has it, and how a flight carries it."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hover import Hover, changed, columns

from mavdem import Flight
from mavdem.alignment.align import VOLTAGE_SECONDS, align, settled_segments
from mavdem.alignment.signals import Signals, voltage
from mavdem.export.tables import columns as table
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover()


def with_battery(message: str, time: np.ndarray, **fields: np.ndarray) -> Telemetry:
    return changed(HOVER.telemetry(), message, **columns(time, **fields))


def sagging(end: float = np.inf) -> Telemetry:
    """A volt in ten seconds, from 16.8 V."""
    time = HOVER.stamps(0.5)
    time = time[time < end]
    return with_battery("SYS_STATUS", time, voltage_battery=np.round(16800 - 100 * time).astype(np.uint16))


def flight_of(telemetry: Telemetry) -> Flight:
    signals = Signals(telemetry)
    return align(signals, settled_segments(signals)[0])


def test_a_flight_has_the_voltage_between_the_messages():
    flight = flight_of(sagging())
    np.testing.assert_allclose(flight.voltage, 16.8 - flight.time / 10, atol=1e-9)
    np.testing.assert_array_equal(flight[5:9].voltage, flight.voltage[5:9])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(flight)).voltage, flight.voltage)
    np.testing.assert_array_equal(table(flight)["battery_v"], flight.voltage)
    assert not flight.voltage.flags.writeable


def test_far_from_any_message_it_is_not_known():
    flight = flight_of(sagging(end=21.0))
    known = flight.time <= 20 + VOLTAGE_SECONDS
    assert np.isfinite(flight.voltage[known]).all() and np.isnan(flight.voltage[~known]).all() and (~known).any()
    assert flight_of(sagging(end=0.1)).voltage is None


def test_without_a_battery_monitor_there_is_none():
    time = HOVER.stamps(1.0)
    for nothing in (0, 65535):
        silent = with_battery("SYS_STATUS", time, voltage_battery=np.full(len(time), nothing, dtype=np.uint16))
        assert voltage(silent) is None and flight_of(silent).voltage is None
    assert flight_of(HOVER.telemetry()).voltage is None


@pytest.mark.parametrize("split", [True, False])
def test_cells_add_up_and_the_whole_may_be_in_the_place_of_the_first(split):
    time = HOVER.stamps(1.0)
    cells = np.full((len(time), 10), 65535, dtype=np.uint16)
    cells[:, : 4 if split else 1] = 4000 if split else 16000
    ids = np.arange(len(time)) % 2
    cells[ids == 1, 0] = 5000  # another battery
    telemetry = with_battery("BATTERY_STATUS", time, voltages=cells, id=ids, voltages_ext=np.zeros((len(time), 4)))
    found = voltage(telemetry)
    np.testing.assert_array_equal(found.values, np.full(np.count_nonzero(ids == 0), 16.0))
    unmeasured = changed(
        telemetry, "SYS_STATUS", **columns(time, voltage_battery=np.full(len(time), 65535, dtype=np.uint16))
    )
    np.testing.assert_array_equal(voltage(unmeasured).values, found.values)
