"""Filters of the gyro: as the autopilots' programs run them, and as their parameters are read."""

from math import inf, sqrt

import numpy as np
from known_gains import ARDUPILOT, PX4, X_ROLL
from numpy.testing import assert_allclose
from pytest import approx, mark
from recorded_flights import recorded

from mavdem.assessment.noise_spectra import MeasuredNoise
from mavdem.dataset.segments import settled_segments
from mavdem.dataset.signals import Signals
from mavdem.facts.noise import NoiseFact
from mavdem.loops.autopilot_parameters import Notch
from mavdem.loops.controllers import controller_from_parameters
from mavdem.loops.filters import gyro_delay, gyro_filters, gyro_response
from mavdem.vibration.spectra import vibration_spectra
from mavdem.vibration.spectral_lines import find_spectral_lines

FREQUENCY = np.array([1.0, 20.0, 80.0, 130.0, 180.0])
NOTCH = {"ENABLE": 1.0, "FREQ": 80.0, "BW": 40.0, "ATT": 30.0, "HMNCS": 1.0}


def ardupilot(notch=None, prefix="INS_HNTCH_", **others):
    named = {prefix + name: value for name, value in (notch or {}).items()}
    return controller_from_parameters(ARDUPILOT | named | others, "roll", X_ROLL)


def test_px4s_notches_lose_half_of_the_power_at_the_ends_of_their_bandwidth():
    names = {"IMU_GYRO_NF0_FRQ": 100.0, "IMU_GYRO_NF0_BW": 20.0}
    none = {"IMU_GYRO_NF1_FRQ": 0.0, "IMU_GYRO_NF1_BW": 20.0}
    controller = controller_from_parameters(PX4 | names | none)
    assert controller.notches == (Notch(100.0, 20.0, inf),)
    edges = 100 * (sqrt(1 + 0.1**2) + np.array([-0.1, 0.1]))
    spectra = abs(gyro_response(controller, np.array([*edges, 100.0])))
    assert spectra == approx([sqrt(0.5), sqrt(0.5), 0.0], abs=1e-3)
    old = {"IMU_GYRO_NF_FREQ": 100.0, "IMU_GYRO_NF_BW": 20.0}
    assert controller_from_parameters(PX4 | old).notches == controller.notches


def test_px4s_derivative_filter_is_read_by_its_older_name():
    older = {name: value for name, value in PX4.items() if name != "IMU_DGYRO_CUTOFF"}
    controller = controller_from_parameters(older | {"MC_DTERM_CUTOFF": 25.0})
    assert controller.derivative_filter == 25.0
    assert controller.parameter_names["derivative_filter"] == "MC_DTERM_CUTOFF"


@mark.parametrize(
    "given, expected",
    [
        ({}, [80]),
        ({"HMNCS": 5.0}, [80, 240]),
        ({"OPTS": 16.0}, [80]),
        ({"BW": 200.0}, [104]),
        ({"MODE": 1.0}, [80]),
        ({"MODE": 1.0, "REF": 0.2}, [80 * sqrt(2)]),
        ({"MODE": 1.0, "REF": 0.8}, [80]),
        ({"MODE": 1.0, "REF": 0.8, "FM_RAT": 0.5}, [80 * sqrt(0.5)]),
        ({"MODE": 3.0, "REF": 1.0, "OPTS": 2.0}, [80] * 4),
        ({"MODE": 4.0, "REF": 1.0, "OPTS": 2.0}, [80] * 3),
        ({"ENABLE": 0.0}, []),
        ({"FREQ": 0.0, "BW": 0.0}, []),
        ({"ATT": -1e38}, []),
    ],
)
@mark.parametrize("prefix", ["INS_HNTCH_", "INS_HNTC2_"])
def test_harmonic_notches_are_where_the_parameters_have_them(given, expected, prefix):
    """The frequencies of ArduPilot's notch filters, Hz, by its parameters.

    In hover the throttle is 0.4; modes above 1 follow sensors, which is a caution.
    """
    controller = ardupilot(NOTCH | given, prefix, MOT_THST_HOVER=0.4, INS_GYRO_RATE=1e38)
    assert controller.gyro_rate == 8000
    assert [notch.frequency for notch in controller.notches] == approx(expected)
    moving = [notch.figures["name"] for notch in controller.cautions]
    assert moving == ([f"{prefix}MODE"] if given.get("MODE", 0) > 1 else [])


def test_a_notch_beyond_half_the_rate_is_off():
    off = gyro_response(ardupilot(NOTCH | {"FREQ": 480.0}), FREQUENCY)
    assert_allclose(off, 1)
    assert gyro_response(ardupilot(NOTCH | {"FREQ": 479.0}), FREQUENCY)[-1] != 1


def test_the_filters_are_shown_with_their_lag_and_as_late_as_one_low_pass():
    low_pass = ardupilot(INS_GYRO_FILTER=20.0)
    assert gyro_filters(low_pass, 20.0) == (20.0, (), approx(90))
    assert gyro_delay(low_pass) == approx(0.5**0.5 / (np.pi * 20), rel=2e-3)
    assert gyro_delay(ardupilot()) == 0
    both = ardupilot(NOTCH, INS_GYRO_FILTER=20.0)
    assert gyro_filters(both, 20.0).phase_lag == approx(98.4, abs=0.1)
    assert gyro_delay(low_pass) < gyro_delay(both) < 1.4 * gyro_delay(low_pass)


@mark.slow
def test_the_raw_gyro_through_the_filters_is_the_filtered_one():
    """A log of ArduPilot's simulator has both gyros.

    The filtered density is the raw one times the response of the filters, in the band of the loop and at the motors'
    line.
    """
    signals = Signals(recorded("sitl_raw/ap_raw_on.BIN.xz"))
    spectra = vibration_spectra(signals, settled_segments(signals))
    raw_spectrum, filtered_spectrum = spectra["gyro_before"], spectra["gyro"]
    raw, filtered = (
        np.median(notch.density[:, 0], axis=0) for notch in (raw_spectrum, filtered_spectrum)
    )
    frequency = filtered_spectrum.frequency
    controller = controller_from_parameters(signals.telemetry.parameters, "roll", X_ROLL)
    assert_allclose(frequency, raw_spectrum.frequency, rtol=1e-3)
    predicted = raw * abs(gyro_response(controller, frequency)) ** 2
    for low, high, decibels in ((4, 15, 1.5), (15, 40, 1.5), (125, 145, 4.0)):
        band = (frequency > low) & (frequency < high)
        assert abs(10 * np.log10(filtered[band].sum() / predicted[band].sum())) < decibels
    measured_noise = MeasuredNoise(
        spectra, {name: find_spectral_lines(spectrum) for name, spectrum in spectra.items()}
    )
    (removed,) = (fact for fact in measured_noise.facts if fact.code is NoiseFact.FILTERS_REMOVE)
    remaining_share = filtered_spectrum.mean_power(104, 188) / raw_spectrum.mean_power(104, 188)
    assert removed.figures["frequency"] == approx(139.0, rel=0.02)
    assert removed.figures["share"] == approx(1 - remaining_share, abs=0.1 * remaining_share)
