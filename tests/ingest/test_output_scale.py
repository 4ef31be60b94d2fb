"""What the numbers of motor outputs mean, by outputs and parameters of real vehicles."""

import numpy as np
from numpy.testing import assert_allclose
from pytest import approx, mark

from mavdem.dataset.quality import samples_at_limits
from mavdem.ingest.motors import OutputDriver
from mavdem.ingest.output_scale import UNKNOWN_SCALE, output_scale

OF_MAIN = [OutputDriver("PWM_MAIN", n) for n in range(1, 5)]


@mark.parametrize(
    "outputs, drivers, parameters, name, low, high",
    [
        # PX4 1.16: each channel has its range; actuator_motors of the same log has 0.736 and 0.562 for these outputs.
        (
            (1000.0, 1100.0, 1689.0, 1550.0),
            OF_MAIN,
            {
                f"PWM_MAIN_{end}{n}": value
                for n in range(1, 5)
                for end, value in (("MIN", 1100.0), ("MAX", 1900.0))
            },
            "PWM",
            1100,
            1900,
        ),
        # PX4 1.9 to 1.11: one range of all; 1.12: one of each driver.
        (
            (900.0, 1200.0, 1680.0),
            OF_MAIN,
            {"PWM_MAIN_MIN1": -1.0, "PWM_MIN": 1200.0, "PWM_MAX": 1950.0},
            "PWM",
            1200,
            1950,
        ),
        (
            (1100.0, 1300.0),
            [OutputDriver("PWM_AUX", 1)],
            {"PWM_AUX_MIN": 1050.0, "PWM_AUX_MAX": 1900.0, "PWM_MIN": 1.0},
            "PWM",
            1050,
            1900,
        ),
        # The parameters are not of the driver that sent these.
        (
            tuple(np.arange(1000.0, 1404.0, 2)),
            OF_MAIN,
            {"PWM_MAIN_MIN": 1230.0, "PWM_MAIN_MAX": 1950.0},
            "PWM",
            1000,
            2000,
        ),
        # PX4 1.16 with DShot on the main outputs: actuator_motors 0.194 of a thrust curve of 0.3 is 25 % of the range.
        ((100.0, 2047.0), [], {}, "DShot", 0, 2000),
        ((100.0, 2048.0), [], {}, "unknown", 0, 2048),
        ((100.0, 1100.0), [], {}, "DShot", 0, 2000),
        ((0.0, 1.2), [], {}, "DShot", 0, 2000),
        ((0.0, 11.0), [], {}, "0-1000", 0, 1000),
        ((900.0, 1100.0), [], {}, "PWM", 1000, 2000),
        ((1000.0, 2400.0), [], {}, "unknown", 0, 2400),
        ((1050.0, 1300.0), [], {"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 1350.0}, "PWM", 1000, 1350),
        (
            (0.0, 110.0, 582.0, 826.0),
            OF_MAIN,
            {"DSHOT_MIN": 0.055, "PWM_MAIN_MIN1": 1000.0},
            "DShot",
            110,
            1999,
        ),
        # PX4 1.9 with UAVCAN, and 1.16, which has its range among the parameters.
        ((0.0, 2457.3, 4712.6, 6158.4), OF_MAIN, {"PWM_MIN": 1000.0}, "UAVCAN", 0, 8191),
        (
            (1000.0, 1500.0),
            [OutputDriver("UAVCAN_EC", 1)],
            {"UAVCAN_EC_MIN1": 1.0, "UAVCAN_EC_MAX1": 8191.0},
            "UAVCAN",
            1,
            8191,
        ),
        (
            (0.0, 0.194, 0.278),
            [OutputDriver("UAVCAN_EC", 1)],
            {"UAVCAN_EC_MIN1": 1.0, "UAVCAN_EC_MAX1": 8191.0},
            "normalised",
            0,
            1,
        ),
    ],
)
def test_the_range_of_px4s_outputs_is_that_of_their_driver(
    outputs, drivers, parameters, name, low, high
):
    scale = output_scale(np.array([outputs]), parameters, drivers)
    assert (scale.name, scale.low, scale.high, scale.upper_limit) == (name, low, high, 1.0)
    assert scale.unit == ("µs" if name == "PWM" else "")
    assert scale.step == np.diff(np.unique(outputs)).min()


@mark.parametrize(
    "parameters, highest",
    [
        ({"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0, "MOT_SPIN_MAX": 0.95}, 1950.0),
        ({"RCMAP_THROTTLE": 3.0, "RC3_MIN": 1073.0, "RC3_MAX": 1920.0, "THR_MIN": 130.0, "MOT_THST_MAX": 0.95}, 1883.0),
        ({"RCMAP_THROTTLE": 3.0, "RC3_MIN": 991.0, "RC3_MAX": 2016.0, "THR_MIN": 130.0}
         | {"MOT_TCRV_ENABLE": 1.0, "MOT_TCRV_MAXPCT": 93.0}, 1944.0),
        ({"RCMAP_THROTTLE": 1.0, "RC1_MIN": 1100.0, "RC1_MAX": 1922.0, "RC3_MIN": 1113.0, "RC3_MAX": 1906.0}
         | {"MOT_TCRV_ENABLE": 1.0, "MOT_TCRV_MAXPCT": 93.0}, 1850.5),
        ({"MOT_PWM_MIN": 1100.0, "MOT_PWM_MAX": 1900.0, "MOT_TCRV_ENABLE": 0.0, "MOT_TCRV_MAXPCT": 93.0}, 1900.0),
        ({"MOT_SPIN_MAX": 0.0}, 2000.0),
        ({"MOT_SPIN_MAX": 0.6}, 1600.0),
    ],
)  # fmt: skip
def test_ardupilots_motors_stop_where_its_version_lets_them(parameters, highest):
    """The highest outputs in logs of 4.2, 3.3 and 3.2, in which a motor was at its limit for long."""
    scale = output_scale(np.array([[1061.0, 1800.0]]), parameters)
    assert scale.low + scale.upper_limit * (scale.high - scale.low) == approx(highest, abs=0.5)


@mark.parametrize(
    "outputs, parameters, drivers, lowest",
    [
        ([1061.0, 1800.0], {"MOT_SPIN_MIN": 0.1}, (), 1100.0),
        ([1061.0, 1800.0], {"THR_MIN": 130.0}, (), 1130.0),
        ([1061.0, 1800.0], {}, (), 1150.0),
        ([109.0, 836.0], {"DSHOT_MIN": 0.055}, [OutputDriver("PWM_MAIN", 1)], 110.0),
        ([1061.0, 1800.0], {"PWM_MAIN_MIN": 1100.0, "PWM_MAIN_MAX": 1900.0},
         [OutputDriver("PWM_MAIN", 1)], 1100.0),
    ],
)  # fmt: skip
def test_a_motor_is_at_its_lower_limit_where_its_autopilot_idles_it_in_flight(
    outputs, parameters, drivers, lowest
):
    """Parameters of ArduPilot and PX4 set the lowest output in flight, above the output of a disarmed motor."""
    scale = output_scale(np.array([outputs]), parameters, drivers)
    step = 0.02 * (scale.high - scale.low)
    _, at_lower = samples_at_limits(scale.fraction(lowest + np.array([-step, 0.0, step])), scale)
    assert at_lower.tolist() == [True, True, False]


def test_without_pulses_a_motor_is_off():
    scale = output_scale(np.array([[0.0, 1000.0, 2000.0]]), {})
    assert_allclose(scale.fraction(np.array([0.0, 900.0, 1500.0])), [0.0, -0.1, 0.5])


def test_pulses_of_px4_beyond_its_default_range_have_no_known_limit():
    pulses = np.linspace(1000.0, 2150.0, 200)
    drivers = [OutputDriver("PWM_MAIN", channel) for channel in range(1, 5)]
    scale = output_scale(pulses, {}, drivers)
    at_upper, _ = samples_at_limits(scale.fraction(pulses), scale)
    assert not at_upper.any()
    # Within the default range its end is the limit.
    usual = np.minimum(pulses, 2000.0)
    scale = output_scale(usual, {}, drivers)
    at_upper, _ = samples_at_limits(scale.fraction(usual), scale)
    assert at_upper.any()


def test_outputs_whose_range_nothing_says_have_no_limit():
    outputs = np.linspace(0.0, 20_000.0, 200)
    scale = output_scale(outputs, {})
    assert scale.name == UNKNOWN_SCALE
    at_upper, at_lower = samples_at_limits(scale.fraction(outputs), scale)
    assert not at_upper.any() and not at_lower.any()
