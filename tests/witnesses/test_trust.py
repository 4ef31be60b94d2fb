"""Which sensors can be trusted, each on a made-up hover of which one sensor is made to lie."""

from dataclasses import replace

import numpy as np
from hover import Hover, asking, changed, columns, with_pulses
from instrumented import stamps
from pytest import approx, mark

from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.trust import TrustCheck
from mavdem.facts.witnesses import SensorFact
from mavdem.report.trust import trust_table
from mavdem.witnesses import sensor_trust
from mavdem.witnesses.accelerometer import still_windows
from mavdem.witnesses.height import reliable_height
from mavdem.witnesses.sensors import barometer_altitude, throttle_stick

GROUND_PRESSURE = 1000.0
TAKE_OFF = 6.0


def height(telemetry):
    """The height of the hover, m, at the stamps of its position."""
    place = telemetry.messages["LOCAL_POSITION_NED"]
    return np.cumsum(-place["vz"]) * 0.1


def flight(noise=0.1, true_height=None):
    """A hover at 10 m with barometer, accelerometer and position fix, whose estimates are all true."""
    telemetry = Hover(sway=0.2).telemetry(20.0, 20.0)
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    random = np.random.default_rng(1)
    true_height = height(telemetry) if true_height is None else true_height
    altitude = 120.0 + true_height + noise * random.standard_normal(len(time))
    telemetry = changed(
        telemetry, "LOCAL_POSITION_NED", x=0.0, y=0.0, vx=0.0, vy=0.0, z=-height(telemetry)
    )
    telemetry = changed(telemetry, "SCALED_PRESSURE", **columns(time, altitude=altitude))
    fast = stamps(telemetry, "ATTITUDE")
    telemetry = changed(telemetry, "HIGHRES_IMU", **columns(fast, xacc=0.0, yacc=0.0, zacc=-9.8))
    # The vehicle sways in the air only.
    rolls = telemetry.messages["ATTITUDE"]
    in_air = fast > TAKE_OFF
    roll, rate = rolls["roll"] * in_air, rolls["rollspeed"] * in_air
    telemetry = changed(telemetry, "ATTITUDE", roll=roll, rollspeed=rate)
    return changed(telemetry, "GPS_RAW_INT", **columns(time, fix_type=3))


def with_gap(telemetry, time, seconds):
    """The same log with the clock so many seconds ahead from this time on."""
    for message, table in telemetry.messages.items():
        later = table["time"] + seconds * (table["time"] > time)
        telemetry = changed(telemetry, message, time=later)
    return telemetry


def trust(telemetry):
    return sensor_trust(Signals(telemetry, inputs="motors"), 0)


def bench(telemetry):
    """The same log of a vehicle that somebody bolted down: nothing rises, nothing rotates."""
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    random = np.random.default_rng(2)
    telemetry = changed(
        telemetry, "SCALED_PRESSURE", altitude=120 + 0.1 * random.standard_normal(len(time))
    )
    return changed(telemetry, "ATTITUDE", roll=0.0, rollspeed=0.0)


def test_all_sensors_of_a_sound_flight_are_trusted():
    sound = trust(flight())
    assert sound.is_barometer_usable
    assert sound.is_climb_estimate_sound
    assert sound.is_accelerometer_sound
    assert sound.has_position_fix
    assert sound.gyro_agrees
    assert sound.flew


def test_the_rise_of_a_light_vehicle_is_that_of_its_whole_flight():
    """It hovers at 12 % of its motors' range; only a short climb takes more than motors on the ground may need."""
    telemetry = flight()
    time = stamps(telemetry, "SERVO_OUTPUT_RAW")
    pulse = np.where(abs(time - 40.0) < 2.0, 1300.0, np.where(time > TAKE_OFF, 1120.0, 1000.0))
    telemetry = with_pulses(telemetry, np.tile(pulse, (4, 1)))
    seconds = np.arange(0.0, 70.0)
    reports = columns(seconds, landed_state=np.where(seconds < TAKE_OFF, 1, 2))
    checks = trust(changed(telemetry, "EXTENDED_SYS_STATE", **reports)).checks
    witnesses = [fact for check in checks for fact in check.figures.get("witnesses", ())]
    (rise,) = [fact for fact in witnesses if fact.code is SensorFact.ROSE]
    assert rise.figures["height"] == approx(10.0, abs=0.3)


def test_a_barometer_that_jumps_is_not_usable():
    assert trust(flight(noise=10.0)).is_barometer_usable is False


def test_without_a_barometer_nothing_is_known_of_it():
    telemetry = flight()
    telemetry = changed(telemetry, "SCALED_PRESSURE", altitude=0.0)
    unknown = trust(telemetry)
    assert unknown.is_barometer_usable is None
    assert unknown.is_climb_estimate_sound is None


@mark.parametrize("speed, contradicts", [(2.0, False), (3.0, True)])
def test_an_estimate_that_falls_beside_the_barometer_contradicts_it(speed, contradicts):
    telemetry = flight()
    place = telemetry.messages["LOCAL_POSITION_NED"]
    runs_away = (place["time"] > 30.0) & (place["time"] < 34.0)
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vz=place["vz"] + speed * runs_away)
    found = trust(telemetry).height.contradictions
    assert len(found) == contradicts
    if contradicts:
        assert found[0] == approx((30.4, 33.6), abs=0.8)


def test_a_contradiction_is_dated_to_its_beginning_under_power():
    telemetry = flight()
    place = telemetry.messages["LOCAL_POSITION_NED"]
    before_take_off = place["time"] < 4.0
    in_flight = (place["time"] > 30.0) & (place["time"] < 38.0)
    runs_away = before_take_off | in_flight
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vz=place["vz"] + 4.0 * runs_away)
    sensors = trust(telemetry)
    assert sensors.height.contradictions[0][0] < 4.0
    (check,) = [check for check in sensors.checks if check.code is TrustCheck.BAROMETER]
    assert check.level == "watch"
    assert check.time == approx(30.4, abs=0.8)


def test_a_height_that_ran_away_gives_way_to_the_barometer():
    telemetry = flight()
    z = np.where(stamps(telemetry, "LOCAL_POSITION_NED") > 30.0, 3000.0, -height(telemetry))
    signals = Signals(changed(telemetry, "LOCAL_POSITION_NED", z=z), inputs="motors")
    trusted = reliable_height(signals, 0, TAKE_OFF)
    assert trusted.source == "barometer"
    assert trusted.series.values.max() == approx(10.0, abs=0.5)
    sound = reliable_height(Signals(telemetry, inputs="motors"), 0, TAKE_OFF)
    assert sound.source == "estimate"


def test_heights_above_each_of_many_take_offs_take_no_memory():
    signals = Signals(flight(), inputs="motors")
    for take_off in np.arange(TAKE_OFF, TAKE_OFF + 5.0):
        assert reliable_height(signals, 0, float(take_off)).source == "estimate"
    kept = [value for key, value in signals.cache.items() if key[-1] in np.arange(5) + TAKE_OFF]
    assert kept == ["estimate"] * 5


@mark.parametrize("gravity, is_sound", [(9.4, True), (8.2, False)])
def test_an_accelerometer_must_measure_gravity_at_rest(gravity, is_sound):
    telemetry = changed(flight(), "HIGHRES_IMU", zacc=-gravity)
    assert trust(telemetry).accelerometer.gravity_at_rest == approx(gravity)
    assert trust(telemetry).is_accelerometer_sound is is_sound


def test_a_receiver_without_satellites_gives_no_position():
    telemetry = changed(flight(), "GPS_RAW_INT", fix_type=1)
    assert trust(telemetry).has_position_fix is False
    assert trust(telemetry).position.fix_fraction == 0


@mark.slow
@mark.parametrize("gain, answers", [(0.9, True), (0.0, False)])
def test_roll_answers_its_setpoint_or_not(gain, answers):
    telemetry = flight()
    time = stamps(telemetry, "ATTITUDE")
    wanted = 0.3 * np.sin(0.7 * time)
    telemetry = asking(telemetry, time, 7, None, wanted)
    telemetry = changed(telemetry, "ATTITUDE", roll=gain * 0.3 * np.sin(0.7 * (time - 0.2)))
    assert trust(telemetry).attitude_follows_setpoint is answers
    # What is held through a gap counts no more than any other sample, however long the gap is.
    assert trust(with_gap(telemetry, 30.0, 1e5)).attitude_follows_setpoint is answers


def test_the_length_of_a_gap_costs_nothing():
    """A clock that jumps by 49 days in flight leaves gyro and accelerometer as they are."""
    damaged = with_gap(flight(), 30.0, 4.3e6)
    assert len(still_windows(Signals(damaged, inputs="motors"), 0).start) < 500
    sensors = trust(damaged)
    assert sensors.is_accelerometer_sound and sensors.gyro_agrees and sensors.flew


def test_two_witnesses_against_a_flight_make_a_bench_run():
    never_flew = trust(bench(flight()))
    assert never_flew.flew is False
    codes = [fact.code for fact in never_flew.flight_check.sensor_facts]
    assert codes == [SensorFact.STAYED_LEVEL, SensorFact.DID_NOT_ROTATE]
    assert {fact.figures["side"] for fact in never_flew.flight_check.sensor_facts} == {"against"}


def test_one_witness_against_a_flight_leaves_it_undecided():
    telemetry = flight()
    telemetry = changed(
        telemetry, "SCALED_PRESSURE", **bench(telemetry).messages["SCALED_PRESSURE"]
    )
    undecided = trust(telemetry)
    assert undecided.flew is None
    # The flight is judged as one, so that the table calls it assumed.
    name, answer, reason = trust_table([undecided]).rows[0]
    assert (name, answer) == ("that it flew", "assumed")
    assert "thrust of a flight, but" in reason


def test_an_estimate_that_rises_on_a_bench_is_outvoted():
    telemetry = bench(flight())
    time = stamps(telemetry, "ATTITUDE")
    telemetry = asking(telemetry, time, 7, None, 0.3 * np.sin(0.7 * time))
    telemetry = changed(telemetry, "SCALED_PRESSURE", altitude=0.0)
    assert trust(telemetry).flew is False


def test_a_still_hover_that_rose_was_flown():
    telemetry = flight()
    telemetry = changed(telemetry, "ATTITUDE", roll=0.0, rollspeed=0.0)
    assert trust(telemetry).flew


def test_motors_that_never_ran_decide_nothing():
    telemetry = flight()
    idle = np.full((4, len(stamps(telemetry, "SERVO_OUTPUT_RAW"))), 1000.0)
    never_ran = trust(with_pulses(telemetry, idle))
    assert never_ran.flew is None
    assert trust_table([never_ran]).rows[0][1] == "not known"


def test_pressure_becomes_altitude_by_the_standard_atmosphere():
    telemetry = flight()
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    pressure = np.linspace(GROUND_PRESSURE, 0.99 * GROUND_PRESSURE, len(time))
    messages = {**telemetry.messages, "SCALED_PRESSURE": columns(time, press_abs=pressure)}
    altitude = barometer_altitude(Signals(type(telemetry)(1, 1, "QUADROTOR", "PX4", messages)))
    assert np.ptp(altitude.values) == approx(84.0, abs=1.0)


@mark.parametrize(
    "parameters, stick",
    [
        ({}, 0.6),
        ({"RC3_MIN": 1100.0, "RC3_MAX": 2100.0}, 0.5),
        ({"RC3_REVERSED": 1.0}, 0.4),
        ({"RCMAP_THROTTLE": 1.0}, 0.2),
    ],
)
def test_the_stick_is_the_travel_of_its_channel(parameters, stick):
    """The throttle stick is a fraction of its channel's range, which parameters set.

    They may reverse it, or map another channel.
    """
    telemetry = Hover().telemetry(20.0, 20.0, parameters=parameters)
    time = stamps(telemetry, "ATTITUDE")
    telemetry = changed(telemetry, "RC_CHANNELS", **columns(time, chan1_raw=1200, chan3_raw=1600))
    assert throttle_stick(Signals(telemetry)).values == approx(stick)


def test_a_receiver_without_signal_has_no_stick():
    telemetry = Hover().telemetry(20.0, 20.0)
    time = stamps(telemetry, "ATTITUDE")
    assert (
        throttle_stick(Signals(changed(telemetry, "RC_CHANNELS", **columns(time, chan3_raw=0))))
        is None
    )


def test_the_stick_of_manual_control_counts_in_thousandths():
    telemetry = Hover().telemetry(20.0, 20.0)
    telemetry = changed(
        telemetry, "MANUAL_CONTROL", **columns(stamps(telemetry, "ATTITUDE"), z=250)
    )
    assert throttle_stick(Signals(telemetry)).values == approx(0.25)


def test_the_checks_of_a_sound_flight_answer_yes_or_that_too_little_was_asked():
    sound = trust(flight())
    levels = {check.code: check.level for check in sound.checks}
    assert set(levels.values()) <= {"good", "unknown"}
    assert (
        levels[TrustCheck.BAROMETER]
        == levels[TrustCheck.ACCELEROMETER]
        == levels[TrustCheck.FLIGHT]
        == "good"
    )
    assert all(check.sentence for check in sound.checks)
    assert [row[1] for row in trust_table([sound]).rows][:3] == ["yes", "yes", "yes"]


@mark.parametrize(
    "correlation, says",
    [(None, "ask for too little"), (0.25, "only in part (correlation 0.25, median error 3.0°)")],
)
def test_setpoints_that_vary_are_not_said_to_ask_for_too_little(correlation, says):
    figures = {"correlation": correlation, "angle": np.radians(3.0)}
    assert says in Fact(TrustCheck.ATTITUDE_RESPONSE, Level.UNKNOWN, **figures).sentence


def test_an_accelerometer_that_may_be_in_use_is_not_called_spare():
    figures = {"name": "IMU 1", "acceleration": 9.8, "names": ("IMU 2",)}
    check = Fact(TrustCheck.ACCELEROMETER, Level.GOOD, **figures)
    assert check.sentence == ("IMU 1 measures 9.80 m/s² at rest. IMU 2 does not measure gravity.")


def test_a_bench_run_has_no_flight_and_each_boot_rows_of_its_own():
    held = trust(bench(flight()))
    answers = {row[0]: row[1] for row in trust_table([held, replace(held, boot=1)]).rows}
    assert answers["that it flew, boot 1"] == answers["that it flew, boot 2"] == "no"
    assert held.checks[0].sentence.startswith("It did not fly: the barometer stayed within")


def test_nothing_recorded_is_not_known():
    telemetry = Hover().telemetry(20.0, 20.0, without=("LOCAL_POSITION_NED", "SERVO_OUTPUT_RAW"))
    levels = [check.level for check in trust(telemetry).checks]
    assert levels == 7 * ["unknown"]
    assert all(check.sentence for check in trust(telemetry).checks)


def test_rates_that_are_sampled_too_slowly_confirm_and_contradict_nothing():
    telemetry = flight()
    time = stamps(telemetry, "ATTITUDE")
    fast_turns = 0.3 * np.sin(2 * np.pi * 9.3 * time)
    rates = 0.3 * 2 * np.pi * 9.3 * np.cos(2 * np.pi * 9.3 * time)
    telemetry = changed(telemetry, "ATTITUDE", roll=fast_turns, rollspeed=rates)
    assert trust(telemetry).gyro_agrees is None


def test_a_gyro_that_turns_the_other_way_disagrees():
    telemetry = flight()
    rate = telemetry.messages["ATTITUDE"]["rollspeed"]
    assert trust(changed(telemetry, "ATTITUDE", rollspeed=-rate)).gyro_agrees is False
