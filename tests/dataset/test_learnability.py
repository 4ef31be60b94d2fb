"""Learnability: what can be learned from is let through with its cautions, what cannot is refused with figures."""

import dataclasses
import json

import numpy as np
from hover import X_QUAD, Hover, changed, columns, disarmed, only, pulses, with_demand, with_pulses
from numpy.random import default_rng
from pytest import approx, mark

from mavdem.dataset.alignment import aligned_flight
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.motor_outputs import DEMAND_MESSAGE
from mavdem.dataset.rate_advice import rate_advice
from mavdem.dataset.segment_learnability import segment_cautions, slow_streams
from mavdem.dataset.segments import settled_segments
from mavdem.dataset.signals import Signals
from mavdem.documents.vehicle import Verdict
from mavdem.facts.learnability import Caution, NotLearnableReason, Remedy, UnusableOutputs
from mavdem.ingest import Component

HOVER = Hover()


def judged(telemetry, inputs=None):
    """What is said of a log, with its words."""
    learnability = learnability_of(Signals(telemetry, inputs=inputs))
    if learnability.learnable:
        assert learnability.remedy == ""
    else:
        assert learnability.remedy != ""
    assert str(learnability.reason)
    return learnability


def refused_for(telemetry):
    learnability = judged(telemetry)
    assert not learnability.learnable
    return learnability.reason


def codes(facts):
    return {fact.code for fact in facts}


@mark.slow
def test_messages_are_called_by_their_names_in_the_log():
    hover = Hover().telemetry(4.0, 4.0)
    names = {"ATTITUDE": "ATT", "SERVO_OUTPUT_RAW": "RCOU", "ACTUATOR_CONTROL_TARGET": "RATE"}
    logged = dataclasses.replace(hover, translated_from="DataFlash", source_names=names)
    silent = dataclasses.replace(logged, messages={"HEARTBEAT": hover.messages["HEARTBEAT"]})
    for telemetry, inputs in ((logged, None), (silent, None), (logged, "demand")):
        reason = judged(telemetry, inputs).reason
        assert not any(name in f"{reason} {reason.remedy}" for name in names), reason


LONG = Hover(hovering=150.0)


def slow_then_fast(change, fast_from):
    """Attitude and motors at 15 Hz before ``change``, at 100 Hz from ``fast_from``."""
    stamps = np.concatenate([np.arange(0, change, 1 / 15), np.arange(fast_from, LONG.end, 0.01)])
    return LONG.telemetry(stamps, stamps)


@mark.slow
@mark.parametrize("fast_from", [100.0, 100.5], ids=["at once", "after a gap"])
def test_the_fast_part_of_a_flight_is_learned_from_and_the_slow_part_is_not(fast_from):
    learnability = judged(slow_then_fast(100.0, fast_from))
    assert learnability.learnable
    assert learnability.segment.start == approx(fast_from, abs=0.1)
    assert learnability.figures.attitude_rate == approx(100, rel=1e-3)
    assert learnability.figures.attitude_gap == approx(0.01)


def test_a_fast_part_too_short_to_learn_from_is_refused_for_the_rate_of_the_rest():
    stamps = np.concatenate(
        [np.arange(0, 100, 1 / 15), np.arange(100, 103, 0.01), np.arange(103, LONG.end, 1 / 15)]
    )
    reason = refused_for(LONG.telemetry(stamps, stamps))
    assert reason.code is NotLearnableReason.STREAMS_TOO_SLOW
    assert reason.figures["rates"] == approx((15.0, 15.0), abs=5)


def test_all_messages_are_blamed_that_are_slow_and_none_that_is_not():
    for attitude, motors in ((9.76983, 9.76985), (9.76985, 9.76983)):
        slow = slow_streams({"ATTITUDE": attitude, "SERVO_OUTPUT_RAW": motors}, "roll")
        assert slow.figures["names"] == ("ATTITUDE", "SERVO_OUTPUT_RAW")
    slow = slow_streams({"ATTITUDE": 100.0, "SERVO_OUTPUT_RAW": 39.99}, "roll")
    assert slow.figures["names"] == ("SERVO_OUTPUT_RAW",) and slow.figures["rates"] == (39.99,)
    assert slow_streams({"ATTITUDE": 40.0, "SERVO_OUTPUT_RAW": 40.0}, "roll") is None


STATION = Component(255, 190, "GCS", "INVALID", {"HEARTBEAT": 60, "REQUEST_DATA_STREAM": 4}, 0)


def test_a_demand_that_never_moves_is_no_input():
    signals = Signals(with_demand(HOVER.telemetry()), "pitch", "demand")
    assert learnability_of(signals).reason.code is NotLearnableReason.DEMAND_CONSTANT


@mark.slow
def test_what_was_assumed_and_left_out_is_said():
    telemetry = dataclasses.replace(HOVER.telemetry(), vehicle="UNKNOWN")
    roll = telemetry.messages["ATTITUDE"]["roll"].copy()
    roll[::18] = np.nan
    learnability = judged(changed(telemetry, "ATTITUDE", roll=roll))
    expected = {Caution.MESSAGES_LEFT_OUT, Caution.VEHICLE_ASSUMED, Caution.MIXER_ASSUMED}
    assert codes(learnability.cautions) == expected
    assert all(map(str, learnability.cautions))


def test_who_asks_for_rates_is_named_only_where_somebody_does():
    telemetry = LONG.telemetry()
    own = Component(1, 1, "QUADROTOR", "ARDUPILOTMEGA", {"REQUEST_DATA_STREAM": 1}, 0)
    assert rate_advice(telemetry, components=(own,)).code is Remedy.ARDUPILOT_STREAMS
    answered = changed(telemetry, "COMMAND_ACK", **columns([14.0], command=[511]))
    asked = rate_advice(answered)
    assert asked.code is Remedy.STOP_ASKING_FOR_RATES and not asked.figures["names"]


def with_contradiction(telemetry, start, end):
    """Returns telemetry whose body rate does not fit its angle from start to end, after which 0.5 s are missing."""
    telemetry = only(
        telemetry, lambda time: (time <= end) | (time > end + 0.5), "ATTITUDE", "SERVO_OUTPUT_RAW"
    )
    time, rate = (telemetry.messages["ATTITUDE"][name] for name in ("time", "rollspeed"))
    wrong = np.where((time >= start) & (time <= end), np.sin(2 * np.pi * 0.7 * time), rate)
    return changed(telemetry, "ATTITUDE", rollspeed=wrong)


@mark.slow
def test_the_longest_learnable_segment_is_taken_or_the_longest_explains():
    telemetry = with_contradiction(LONG.telemetry(), 0.0, 100.0)
    longest, second = settled_segments(Signals(telemetry))
    learnability = judged(telemetry)
    assert learnability.learnable and learnability.segment == second
    assert learnability.figures.duration == approx(second.duration, abs=0.1)
    refused = judged(with_contradiction(telemetry, 0.0, LONG.end))
    assert not refused.learnable and refused.segment == longest
    assert refused.reason.code is NotLearnableReason.RATE_CONTRADICTS_ANGLE


def test_where_nothing_shows_flight_nothing_is_claimed_about_it():
    time = HOVER.stamps(100.0)
    controls = np.full((len(time), 8), np.nan)
    controls[:, :3] = np.sin(time)[:, None]
    telemetry = HOVER.telemetry(without=("SERVO_OUTPUT_RAW", "EXTENDED_SYS_STATE"))
    reason = refused_for(
        changed(
            telemetry,
            "ACTUATOR_CONTROL_TARGET",
            time=time,
            boot=np.zeros(len(time), dtype=np.int64),
            controls=controls,
        )
    )
    assert reason.code is NotLearnableReason.NO_EVIDENCE_OF_FLIGHT


@mark.slow
def test_a_hover_on_little_of_the_range_is_a_flight_where_the_autopilot_idles_lower():
    telemetry = HOVER.telemetry()
    strong = with_pulses(telemetry, 1000 + (pulses(telemetry) - 1000) // 3)
    assert refused_for(strong).figures["least_collective"] == approx(0.2)
    strong = dataclasses.replace(strong, parameters={**strong.parameters, "MOT_SPIN_MIN": 0.06})
    assert judged(strong).learnable


@mark.slow
@mark.parametrize(
    "figure, limit, caution",
    [
        ("output_snr", 20.0, Caution.NEAR_RESOLUTION),
        ("consistency", 0.8, Caution.RATE_EXPLAINS_LITTLE),
    ],
)
def test_a_figure_is_doubted_below_its_limit_only(figure, limit, caution):
    """A caution is given for a value just below the limit of a figure, and none for a value just above it."""
    signals = Signals(HOVER.telemetry())
    figures = learnability_of(signals).figures
    for value, doubted in ((limit - 1e-3, {caution}), (limit + 1e-3, set())):
        cautions = segment_cautions(signals, dataclasses.replace(figures, **{figure: value}))
        assert codes(cautions) - {Caution.MIXER_ASSUMED} == doubted
        # 1/(1 + 20): rounding can shrink what is learned by 5 %.
        assert all(fact.figures.get("share", 0.05) == approx(0.05, 0.1) for fact in cautions)


def with_outputs(outputs=None, **parameters):
    """A hover whose outputs stand still, if they are given, with these parameters."""
    telemetry = HOVER.telemetry(parameters=parameters)
    return (
        telemetry
        if outputs is None
        else with_pulses(telemetry, np.full((8, len(HOVER.stamps(100.0))), outputs))
    )


def idling():
    running = pulses(HOVER.telemetry()) > 1000
    return with_pulses(HOVER.telemetry(), np.where(running, 1100 + np.arange(1, 5)[:, None], 1000))


def shaking(size=1.0, share=1.0):
    """97 Hz sampled at 100 Hz looks like a slow oscillation of the rate that the angle does not follow."""
    time, rate = (HOVER.telemetry().messages["ATTITUDE"][name] for name in ("time", "rollspeed"))
    return changed(
        HOVER.telemetry(), "ATTITUDE", rollspeed=share * rate + size * np.sin(2 * np.pi * 97 * time)
    )


def with_steps(step, telemetry):
    table = telemetry.messages["ATTITUDE"]
    rounded = {name: np.round(table[name] / step) * step for name in ("roll", "rollspeed")}
    return changed(telemetry, "ATTITUDE", **rounded)


GAPS = HOVER.stamps(100.0)[HOVER.stamps(100.0) % 3.0 < 2.5]
FOUR, SIX = (
    {f"SERVO{step * n + first}_FUNCTION": 32.0 + n for n in range(1, last)}
    for step, first, last in ((1, 4, 5), (2, 0, 7))
)
REFUSED = {
    "slow": (
        HOVER.telemetry(100.0, 10.0),
        NotLearnableReason.STREAMS_TOO_SLOW,
        Remedy.ARDUPILOT_STREAMS,
        {"names": ("SERVO_OUTPUT_RAW",), "rates": approx((10.0,), 0.01)},
    ),
    "slow PX4": (
        HOVER.telemetry(4.0, 4.0, autopilot="PX4"),
        NotLearnableReason.STREAMS_TOO_SLOW,
        Remedy.PX4_STREAMS,
        {},
    ),
    "slow other": (
        HOVER.telemetry(4.0, 4.0, autopilot="INVALID"),
        NotLearnableReason.STREAMS_TOO_SLOW,
        Remedy.MESSAGE_INTERVALS,
        {},
    ),
    "gaps": (
        HOVER.telemetry(GAPS, GAPS),
        NotLearnableReason.TOO_SHORT,
        None,
        {"duration": approx(2.5, 0.02)},
    ),
    "no attitude": (
        HOVER.telemetry(without=("ATTITUDE",)),
        NotLearnableReason.NO_ATTITUDE,
        Remedy.ARDUPILOT_STREAMS,
        {},
    ),
    "no motors": (
        HOVER.telemetry(without=("SERVO_OUTPUT_RAW",)),
        UnusableOutputs.NO_MOTOR_MESSAGE,
        Remedy.ARDUPILOT_STREAMS,
        {},
    ),
    "disarmed": (
        disarmed(HOVER.telemetry()),
        NotLearnableReason.NEVER_ARMED,
        Remedy.RECORD_A_FLIGHT,
        {},
    ),
    "still": (with_outputs(1000.0), UnusableOutputs.MOTORS_CONSTANT, Remedy.RECORD_A_FLIGHT, {}),
    "other channels": (
        with_outputs(**FOUR),
        UnusableOutputs.CHANNELS_CONSTANT,
        Remedy.RECORD_A_FLIGHT,
        {"channels": (5, 6, 7, 8)},
    ),
    "too few": (
        with_outputs(**SIX),
        UnusableOutputs.CHANNELS_MISSING,
        Remedy.RECORD_A_FLIGHT,
        {"missing": (10, 12)},
    ),
    "never changes": (
        with_steps(1e9, HOVER.telemetry()),
        NotLearnableReason.OUTPUT_CONSTANT,
        None,
        {},
    ),
    "idling": (
        idling(),
        NotLearnableReason.NEVER_AIRBORNE,
        Remedy.RECORD_A_FLIGHT,
        {"collective": approx(0.105, abs=0.005), "least_collective": approx(0.2)},
    ),
    "shaking": (
        shaking(0.027, 0.0),
        NotLearnableReason.RATE_CONTRADICTS_ANGLE,
        Remedy.ARDUPILOT_STREAMS,
        {"still": False, "rate": 200},
    ),
    "shaking while it stands": (
        shaking(0.01, 0.0),
        NotLearnableReason.RATE_CONTRADICTS_ANGLE,
        Remedy.ARDUPILOT_STREAMS,
        {"still": True},
    ),
    "submarine": (HOVER.telemetry(vehicle="SUBMARINE"), NotLearnableReason.NO_MULTIROTOR, None, {}),
}


@mark.slow
@mark.parametrize("name", REFUSED)
def test_an_unlearnable_flight_is_refused_with_the_deciding_figures_and_a_remedy(name):
    telemetry, code, remedy, figures = REFUSED[name]
    reason = refused_for(telemetry)
    assert reason.code is code
    advice = reason.figures.get("remedy")
    assert (advice and advice.code) is remedy
    decided = {**(advice.figures if advice else {}), **reason.figures}
    assert {figure: decided[figure] for figure in figures} == figures


def test_another_vehicle_is_named_only_where_there_is_one():
    signals = Signals(HOVER.telemetry(vehicle="SUBMARINE"))
    other = Component(4, 1, "QUADROTOR", "PX4", {}, 0)
    for components, named in (([STATION], None), ([STATION, other], "4:1")):
        reason = learnability_of(signals, components).reason
        assert reason.figures["other"] == named
        if named:
            assert "--vehicle" in reason.remedy
        else:
            assert "--vehicle" not in reason.remedy


@mark.slow
def test_a_rate_that_explains_more_than_half_of_the_angle_is_let_through():
    assert judged(shaking(0.26)).cautions[-1].code is Caution.RATE_EXPLAINS_LITTLE


def rounded(hover):
    telemetry = hover.telemetry()
    motors = pulses(telemetry)
    return with_pulses(telemetry, np.round(motors + default_rng(2).normal(0, 3, motors.shape[1])))


@mark.slow
def test_a_command_at_the_floor_of_the_stream_is_refused():
    near = learnability_of(Signals(rounded(Hover(command=0.5))))
    assert near.learnable
    truth = (0.5**2 / 2) / (1 / 12 * np.sum(X_QUAD**2) / 16)
    assert near.figures.input_snr == approx(truth, rel=0.3)
    assert judged(rounded(Hover(command=0.13))).learnable
    refused = refused_for(rounded(Hover(command=0.1)))
    assert (
        refused.code is NotLearnableReason.COMMAND_ROUNDED and refused.figures["command_step"] == 1
    )


def random_stamps(random_generator, end):
    """Returns random time stamps, s, of a stream that changes its rate a few times."""
    paces = random_generator.choice(
        [0.001, 0.0025, 0.01, 0.02, 0.066, 0.25, 1.0, 3.0], size=random_generator.integers(1, 5)
    )
    steps = [
        random_generator.exponential(pace, random_generator.integers(1, 300)) for pace in paces
    ]
    stamps = np.round(np.cumsum(np.concatenate(steps)), random_generator.choice([3, 6]))
    return stamps[stamps < end]


@mark.slow
@mark.parametrize("seed", range(40))
def test_mutilated_telemetry_is_judged_and_its_segments_align(seed):
    """Whatever is missing, shuffled, repeated or not a number, it is judged, and every segment makes a Flight."""
    random_generator = default_rng(seed)
    hover = Hover(hovering=random_generator.uniform(0, 20))
    streams = [random_stamps(random_generator, hover.end) for _ in range(2)]
    telemetry = hover.telemetry(
        *(streams if seed % 2 else random_generator.choice([1.0, 4.0, 50.0, 100.0], 2))
    )
    for message, table in telemetry.messages.items():
        rows = len(table["time"])
        kept = random_generator.permutation(rows)[
            : random_generator.choice([0, 1, 2, rows // 3, rows, rows, rows])
        ]
        columns = {name: column[kept].copy() for name, column in table.items()}
        if message != "HEARTBEAT" and len(kept):
            hit = random_generator.choice(
                [name for name in columns if name not in ("boot", "port")]
            )
            columns[hit][: rows // 20] = random_generator.choice([np.nan, np.inf, 0.0, -1e6])
            columns["boot"] = np.int64(
                np.nan_to_num(columns["time"]) > random_generator.uniform(0, 60)
            )
        telemetry = changed(telemetry, message, **columns)
    document = Verdict.model_validate(judged(telemetry)).as_dict()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    for segment in settled_segments(Signals(telemetry)):
        assert len(aligned_flight(Signals(telemetry), segment)) >= 1


def in_whole_pulses(telemetry):
    """The motors in whole µs."""
    return with_pulses(telemetry, np.round(pulses(telemetry)))


def held(telemetry, message, rows, only=("",)):
    """Returns telemetry in which each value of a message is repeated for a number of rows.

    The time stamps stay. Only fields whose names begin with ``only`` are changed.
    """
    table = telemetry.messages[message]
    source = np.arange(len(table["time"])) // rows * rows
    fields = {
        name: column[source] for name, column in table.items() if name not in ("time", "boot")
    }
    return changed(
        telemetry,
        message,
        **{name: values for name, values in fields.items() if name.startswith(only)},
    )


@mark.slow
@mark.parametrize("rows, told", [(10, 10.0), (5, 20.0), (25, 4.0)])
@mark.parametrize(
    "message, only", [("ATTITUDE", ""), ("ATTITUDE", "roll"), ("SERVO_OUTPUT_RAW", "servo")]
)
def test_values_sent_again_and_again_are_refused_for_the_rate_of_new_ones(
    message, only, rows, told
):
    """Messages come at 100 Hz, but their values are new only in every 5th, 10th or 25th."""
    # A motor that never moves says nothing.
    telemetry = changed(in_whole_pulses(HOVER.telemetry()), "SERVO_OUTPUT_RAW", servo4_raw=1000.0)
    reason = refused_for(held(telemetry, message, rows, (only,)))
    assert reason.code is NotLearnableReason.VALUES_REPEATED and reason.figures["name"] == message
    assert reason.figures["rate"] == approx(100)
    # At its turning points a rounded command may be the same twice running.
    assert 0.9 * told <= reason.figures["fresh_rate"] <= 1.01 * told


@mark.slow
def test_motors_that_stand_still_because_they_are_rounded_are_not_held():
    """A command that moves by less than a step from message to message repeats whole rows, and then goes on by one."""
    whole = in_whole_pulses(Hover(command=2.0).telemetry())
    assert np.mean((np.diff(pulses(whole)) == 0).all(axis=0)) > 0.8
    # For most of a flight it moves faster.
    faster = np.where(
        HOVER.stamps(100.0) > 30.0, pulses(Hover(command=80.0).telemetry()), pulses(whole)
    )
    for telemetry in (whole, in_whole_pulses(with_pulses(whole, faster))):
        learnability = judged(telemetry)
        assert learnability.learnable and learnability.figures.motor_fresh == approx(100)


@mark.slow
def test_an_attitude_near_its_resolution_is_doubted_and_at_it_refused():
    """Angles and rates are rounded to 0.05 rad: a caution for a usual hover, a refusal for one that hardly moves."""
    doubted = learnability_of(Signals(with_steps(0.05, HOVER.telemetry())))
    assert doubted.learnable
    (caution,) = (fact for fact in doubted.cautions if fact.code is Caution.NEAR_RESOLUTION)
    # The share is what noise takes of a regression's slope.
    assert caution.figures["share"] == approx(1 / (1 + doubted.figures.output_snr))
    assert doubted.figures.angle_step == approx(0.05) and doubted.figures.rate_step == approx(0.05)
    time = np.arange(0, 40, 0.01)
    change = HOVER.roll(time + 0.2) - HOVER.roll(time)
    fine = learnability_of(Signals(with_steps(0.01, HOVER.telemetry()))).figures
    assert fine.output_snr == approx(change.var() / (0.01**2 / 6), rel=0.1)
    time = HOVER.stamps(100.0)
    slow = changed(
        HOVER.telemetry(),
        "ATTITUDE",
        roll=0.3 * np.sin(0.3 * time),
        rollspeed=0.09 * np.cos(0.3 * time),
    )
    assert judged(slow).learnable
    refused = refused_for(with_steps(0.05, slow))
    assert refused.code is NotLearnableReason.OUTPUT_ROUNDED
    assert refused.figures["angle_step"] == approx(0.05)


@mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@mark.parametrize(
    "fields", [("yawspeed",), ("roll", "pitch", "rollspeed", "pitchspeed", "yawspeed")]
)
def test_an_attitude_that_is_no_number_is_refused_as_that(wrong, fields):
    telemetry = HOVER.telemetry()
    nowhere = np.full(len(telemetry.messages["ATTITUDE"]["time"]), wrong)
    reason = refused_for(changed(telemetry, "ATTITUDE", **dict.fromkeys(fields, nowhere)))
    assert reason.code is NotLearnableReason.ATTITUDE_NOT_FINITE


@mark.slow
@mark.parametrize("field, wrong", [("rollspeed", 70.0), ("roll", 1e30), ("pitch", -6.3)])
def test_a_message_that_cannot_be_is_left_out_and_reported(field, wrong):
    telemetry = HOVER.telemetry()
    values = telemetry.messages["ATTITUDE"][field].copy()
    values[3000] = wrong
    learnability = judged(changed(telemetry, "ATTITUDE", **{field: values}))
    caution = learnability.cautions[0]
    assert caution.code is Caution.IMPOSSIBLE_ATTITUDE
    assert (caution.figures["count"], caution.figures["sent"]) == (1, len(values))
    flight = aligned_flight(
        Signals(changed(telemetry, "ATTITUDE", **{field: values})), learnability.segment
    )
    assert abs(flight.outputs).max() < 1


@mark.slow
def test_one_wild_rate_does_not_decide_and_degrees_are_reported_as_such():
    telemetry = Hover(sway=0.01).telemetry()
    rate = telemetry.messages["ATTITUDE"]["rollspeed"].copy()
    rate[3000] = 30.0
    assert judged(changed(telemetry, "ATTITUDE", rollspeed=rate)).figures.consistency > 0.99
    telemetry = Hover(sway=0.0743).telemetry()  # 1.1 % of it beyond a turn
    degrees = {
        name: np.degrees(telemetry.messages["ATTITUDE"][name]) for name in ("roll", "rollspeed")
    }
    assert (
        refused_for(changed(telemetry, "ATTITUDE", **degrees)).code
        is NotLearnableReason.ATTITUDE_UNIT
    )


def remedy_for(recorder, has_demand=True, **fields):
    """What to do about a log at 4 Hz whose autopilot had these parameters, firmware and lost messages."""
    telemetry = Hover().telemetry(4.0, 4.0)
    if has_demand:
        stamps = Hover().stamps(4.0)
        telemetry = changed(
            telemetry, DEMAND_MESSAGE, **columns(stamps, controls=np.zeros((len(stamps), 8)))
        )
    remedy = rate_advice(dataclasses.replace(telemetry, translated_from=recorder, **fields))
    assert str(remedy)
    return remedy


LIMITS = {"LOG_FILE_RATEMAX": 10.0, "LOG_BLK_RATEMAX": 20.0, "LOG_MAV_RATEMAX": 30.0}
BACKEND = {"LOG_BACKEND_TYPE": 1.0}
SERIAL_1 = {"SR1_EXTRA1": 100.0, "SR1_RC_CHAN": 50.0, "SR2_EXTRA1": 100.0}
SERIAL_0 = {"SR0_EXTRA1": 4.0, "SR0_RC_CHAN": 4.0}


@mark.parametrize(
    "recorder, code, parameters, figures",
    [
        ("DataFlash", Remedy.LOG_FAST_ATTITUDE, {}, {"bitmask": None, "names": ()}),
        ("DataFlash", Remedy.LOG_FAST_ATTITUDE, {"LOG_BITMASK": 176126.0}, {"bitmask": 176126}),
        ("DataFlash", Remedy.LOG_FAST_ATTITUDE, {"LOG_BITMASK": -6146.0}, {"bitmask": -6146}),
        (
            "DataFlash",
            Remedy.LOG_FAST_ATTITUDE,
            {"LOG_BITMASK": 32767.0, **LIMITS},
            {
                "bitmask": 32767,
                "names": ("LOG_FILE_RATEMAX", "LOG_MAV_RATEMAX", "LOG_BLK_RATEMAX"),
                "rates": (10.0, 30.0, 20.0),
            },
        ),
        (
            "DataFlash",
            Remedy.LOG_FAST_ATTITUDE,
            LIMITS | BACKEND,
            {"bitmask": None, "names": ("LOG_FILE_RATEMAX",), "rates": (10.0,)},
        ),
        ("ULog", Remedy.LOG_HIGH_RATE, {}, {"profile": None, "has_parameters": False}),
        (
            "ULog",
            Remedy.LOG_HIGH_RATE,
            {"SDLOG_MODE": 0.0},
            {"profile": None, "has_parameters": True},
        ),
        ("ULog", Remedy.LOG_HIGH_RATE, {"SDLOG_PROFILE": 131.0}, {"profile": 131}),
        ("", Remedy.ARDUPILOT_STREAMS, {}, {"prefix": "", "names": ()}),
        ("", Remedy.ARDUPILOT_STREAMS, SERIAL_0, {"prefix": "SR", "names": ()}),
        ("", Remedy.ARDUPILOT_STREAMS, {"MAV1_EXTRA1": 4.0}, {"prefix": "MAV", "names": ()}),
        ("", Remedy.ARDUPILOT_STREAMS, SERIAL_1, {"prefix": "SR", "names": ("SR1",)}),
        ("uXRCE-DDS", Remedy.DDS_TOPICS, {}, {}),
        ("MAVROS", Remedy.MAVROS_INTERVALS, {}, {}),
    ],
)
@mark.parametrize("dropouts", [0, 12])
def test_rates_are_set_by_what_recorded_the_log_and_its_parameters(
    recorder, code, parameters, figures, dropouts
):
    remedy = remedy_for(recorder, parameters=parameters, dropouts=dropouts)
    assert remedy.code is code
    assert figures.items() <= remedy.figures.items()
    assert remedy.figures.get("dropouts", dropouts) == dropouts


@mark.parametrize(
    "firmware, bitmask, can_log, is_fast",
    [
        ("ArduCopter V3.3-dev (a5a72a84)", 32767.0, False, True),
        ("", 32767.0, False, True),
        ("ArduCopter V3.3.3 (acf3e3d)", 32767.0, True, True),
        ("ArduCopter V3.2.1", 830.0, False, False),
    ],
)
def test_a_demand_that_is_not_logged_takes_another_firmware_or_the_whole_log(
    firmware, bitmask, can_log, is_fast
):
    """Versions and bitmasks of ArduCopter differ.

    The remedy depends on whether this version can log the demand at all and whether it already logs fast.
    """
    parameters = {"LOG_BITMASK": bitmask}
    remedy = remedy_for("DataFlash", has_demand=False, parameters=parameters, firmware=firmware)
    assert remedy.code is Remedy.DEMAND_NOT_LOGGED
    assert (remedy.figures["can_log"], remedy.figures["is_fast"]) == (can_log, is_fast)
    if firmware:
        assert remedy.figures["version"]
    else:
        assert not remedy.figures["version"]


def test_the_missing_part_of_a_dataflash_attitude_is_named():
    bare = HOVER.telemetry(without=("ATTITUDE",))
    target = {"time": np.arange(3.0), "boot": np.zeros(3, int)}
    messages = {**bare.messages, "ATTITUDE_TARGET": target}
    for source, sentence in (
        ("ATT", "There is no RATE or IMU message with the body rates."),
        ("RATE", "There is no ATT or ANG message with the angles."),
    ):
        logged = dataclasses.replace(
            bare,
            messages=messages,
            translated_from="DataFlash",
            source_names={"ATTITUDE_TARGET": source},
        )
        reason = learnability_of(Signals(logged)).reason
        assert (reason.code, reason.sentence) == (NotLearnableReason.NO_ATTITUDE, sentence)
