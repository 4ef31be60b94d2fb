"""The plant in its loop: from the messages of simulated flights at any rate, and why there is none."""

import pickle
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hover import Hover, asking, changed
from known_gains import ARDUPILOT, X_ROLL
from numpy.testing import assert_allclose
from pytest import approx, fixture, mark, param
from recorded_flights import shared
from refusals import refused

import mavdem
from mavdem.assessment.axis.loops import loop_of_axis
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.dem.record import Record
from mavdem.experiments.paper.flights import write_log
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.loops import LoopAction, LoopFact, ResponseFact
from mavdem.facts.margins import MarginsLight
from mavdem.ingest import read_log
from mavdem.loops import identification as in_flight
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.controllers import controller_from_parameters
from mavdem.loops.identification import _loop_messages, identify_plant_in_loop
from mavdem.loops.identified_plant import physical_plant
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.plant import physical
from mavdem.plant.closed_loop.parameters import PARAMETER_NAMES
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth

pytestmark = mark.slow
SCENARIO = scenario_from_table(
    {
        "seed": 12,
        "duration": 46,
        "vehicle": {
            "model": "iris",
            "rate_gain": 2.0,
            "lag_up": 0.02,
            "lag_down": 0.02,
            "parameters": {"IMU_GYRO_RATEMAX": 200},
        },
        "wind": [{"kind": "gaussian", "sd": 0.5, "s": 0.3}],
        "excitation": {"kind": "doublets", "amplitude": 8.0, "width": 0.13, "period": 2.7},
        "stream": {"rate": 200, "rates": {"ATTITUDE_TARGET": 200}},
    }
)


def logged(scenario):
    """What is true of a scenario that is flown, and its log."""
    flight = fly(scenario)
    with TemporaryDirectory() as folder:
        log = Path(folder, "flight.tlog")
        write_log(log, scenario, flight)
        return truth(scenario, flight), read_log(log)


@fixture(scope="module")
def flight(once_in_a_run):
    return once_in_a_run(logged)(SCENARIO)


@fixture(scope="module")
def log(flight):
    return flight[1]


def thinned(log, every):
    """The log with every so many messages of each kind."""
    (vehicle,) = log.vehicles
    fast = vehicle.messages.keys() - {"PARAM_VALUE", "HEARTBEAT"}
    rows = slice(None, None, every)
    messages = vehicle.messages | {name: rows_of(vehicle.messages[name], rows) for name in fast}
    return replace(log, vehicles=(replace(vehicle, messages=messages),))


def flown(log):
    signals = Signals(log.vehicles[0])
    segments, _ = usable_segments(signals, log.components, MIN_SLOW_MOTION_RATE)
    return signals, segments


def identified_loop(log):
    """The loop of roll, of a plant that is identified in it."""
    signals, flights = flown(log)
    return loop_from_plant(identify_plant_in_loop(signals, flights), Record.from_flights(flights))


@mark.parametrize("every, within", [param(1, (5.0, 1.5), marks=mark.in_full), (8, (12.0, np.inf))])
def test_a_loop_has_its_true_margins_at_200_and_at_25_hz(flight, every, within):
    """The intervals hold them; beyond half of the log's rate the gain margin is said to be extrapolated."""
    known, log = flight
    loop = identified_loop(thinned(log, every))
    _, *margins, _ = known["roll_rate_margins"]
    for name, true, error in zip(("phase_margin", "gain_margin"), margins, within, strict=True):
        assert abs(getattr(loop, name) - true) < error
        low, high = getattr(loop, f"{name}_interval")
        wider = (high - low) / 4  # One flight is too little to test 90 %: 99 %.
        assert low - wider <= true <= high + wider
    codes = [caution.code for caution in loop.cautions]
    if every == 8:
        assert LoopFact.GAIN_MARGIN_EXTRAPOLATED in codes
    else:
        assert LoopFact.GAIN_MARGIN_EXTRAPOLATED not in codes
    assert LoopFact.STEERING_SLOW not in codes
    plant = loop.plant._replace(steered_frequency=0.9 * loop.crossover)
    loop_above_setpoints = loop_from_plant(plant, loop.record, loop.controller)
    assert LoopFact.STEERING_SLOW in [caution.code for caution in loop_above_setpoints.cautions]


def test_a_slow_log_has_the_loops_of_its_plant_in_the_loop(log):
    slow = thinned(log, 8)
    assert not loop_of_axis(Signals(slow.vehicles[0]), slow).plant.filtered


UNREACHED_TARGETS = {"default": MARGIN_TARGETS["default"]._replace(phase_margin=180.0)}
"""A goal that no phase margin reaches, so that none is known to meet it."""


def refusal(signals, flights):
    return refused(identify_plant_in_loop, Signals(signals.telemetry), flights).code


def test_what_a_plant_in_its_loop_takes_is_said(log, monkeypatch):
    """Each requirement of the identification is violated in turn by data that lack it or by a stricter limit."""
    signals, flights = flown(log)
    (flight,) = flights
    assert refusal(signals, [flight[:2000]]) is LoopFact.LOOP_TOO_SHORT
    without = {k: v for k, v in signals.telemetry.messages.items() if k != "ATTITUDE_TARGET"}
    blind = Signals(replace(signals.telemetry, messages=without))
    assert refusal(blind, flights) is LoopFact.NO_RATE_SETPOINT
    # The last reason first, so that each stands before those that are there already.
    monkeypatch.setattr(in_flight, "MAX_PHASE_MARGIN_HALF_WIDTH", 0.1)
    monkeypatch.setattr(in_flight, "MARGIN_TARGETS", UNREACHED_TARGETS)
    assert refusal(signals, flights) is LoopFact.MARGIN_UNCERTAIN
    monkeypatch.setattr(in_flight, "MIN_REFERENCE_SHARE", 2.0)
    assert refusal(signals, flights) is LoopFact.NOT_STEERED
    monkeypatch.undo()
    monkeypatch.setattr(in_flight, "MAX_ROUNDING_SHARE", 0.0)
    rounded = refused(identify_plant_in_loop, Signals(signals.telemetry), flights)
    assert rounded.code is NotLearnableReason.COMMAND_ROUNDED
    # A step's rounding has a twelfth of its square as variance.
    share = (rounded.figures["command_step"] / rounded.figures["command"]) ** 2 / 12
    monkeypatch.setattr(in_flight, "MAX_ROUNDING_SHARE", 0.9 * share)
    assert refusal(signals, flights) is NotLearnableReason.COMMAND_ROUNDED
    monkeypatch.setattr(in_flight, "MAX_ROUNDING_SHARE", 1.1 * share)
    assert identify_plant_in_loop(Signals(signals.telemetry), flights).effect.shape == (4,)


def with_setpoints(log, change):
    """The log whose ATTITUDE_TARGET is what ``change`` makes of its columns."""
    (vehicle,) = log.vehicles
    targets = change(vehicle.messages["ATTITUDE_TARGET"])
    return replace(log, vehicles=(changed(vehicle, "ATTITUDE_TARGET", **targets),))


def rows_of(columns, rows):
    return {name: values[rows] for name, values in columns.items()}


@mark.parametrize(
    "change, code, is_logged",
    [
        (lambda c: c | {"body_roll_rate": 0.3}, LoopFact.NO_RATE_SETPOINT, True),
        (lambda c: c | {"boot": c["boot"] + 7}, LoopFact.NO_RATE_SETPOINT, False),
        (lambda c: rows_of(c, slice(500, 501)), LoopFact.NO_RATE_SETPOINT, False),
        (lambda c: rows_of(c, slice(None, None, 13)), LoopFact.NO_RATE_SETPOINT, False),
        (lambda c: rows_of(c, c["time"] % 30 < 15), LoopFact.LOOP_TOO_SHORT, None),
    ],
    ids=["constant", "of another boot", "one message", "2 Hz", "gaps longer than windows"],
)
def test_setpoints_that_say_too_little_are_refused(log, change, code, is_logged):
    """The rate setpoint is constant, of another boot, a single message, slow, or has gaps.

    Only one that came often and is constant was logged and did not move: the others are to be logged first.
    """
    signals, flights = flown(with_setpoints(thinned(log, 8), change))
    fact = refused(identify_plant_in_loop, Signals(signals.telemetry), flights)
    assert (fact.code, fact.figures.get("is_logged")) == (code, is_logged)


def test_another_boot_at_the_same_stamps_does_not_count(log):
    """Flights of a boot without rate setpoints are given beside the flight: they must not change the result."""
    signals, (flight,) = flown(thinned(log, 8))
    segment = {**flight.provenance["segment"], "boot": 1}
    other = replace(flight[:-1], provenance={**flight.provenance, "segment": segment})
    plant_of_one_flight = identify_plant_in_loop(signals, [flight])
    plant_of_three_flights = identify_plant_in_loop(signals, [other, flight, other])
    assert np.array_equal(plant_of_three_flights.covariance, plant_of_one_flight.covariance)


def test_a_plant_without_draws_is_refused_and_unknown_margins_end_at_half_a_turn(log, monkeypatch):
    """The covariance of the plant is NaN or very large; phase margins end at 180°."""
    signals, flights = flown(thinned(log, 8))

    # The fit is that of the other tests of this log, done once.
    identify = in_flight.identify_axis

    def plant_with(share):
        def spread(axis):
            result = identify(axis)
            return result._replace(covariance=result.covariance * share)

        monkeypatch.setattr(in_flight, "identify_axis", spread)
        return identify_plant_in_loop(Signals(signals.telemetry), flights)

    assert refused(plant_with, np.nan).code is LoopFact.LOOP_NOT_FOUND
    assert plant_with(7.0).lag > 0, "all of the wide interval is above the goal"
    monkeypatch.setattr(in_flight, "MARGIN_TARGETS", UNREACHED_TARGETS)
    widths = []
    for share in (7.0, 1e5):
        uncertain = refused(plant_with, share)
        assert uncertain.code is LoopFact.MARGIN_UNCERTAIN
        widths.append(np.ptp(uncertain.figures["phase_margin_interval"]))
    assert uncertain.figures["phase_margin_interval"][1] == 180.0
    assert 20.0 < widths[0] < 30.0
    assert plant_with(3.0).lag > 0, "less than 10° to each side"


@mark.parametrize(
    "interval, is_stable, reason",
    [
        ((20.0, 60.0), True, "the phase margin is 20° to 60° (90 % interval)"),
        ((-30.0, -30.0), False, "the identified loop is unstable"),
        ((30.0, 30.0), False, "the identified loop is unstable"),
        ((180.0, 180.0), True, "this log does not identify the loop"),
    ],
)
def test_an_unknown_margin_is_called_uncertain_only_if_its_interval_is_wide(
    interval, is_stable, reason
):
    """The sentence depends on the interval of the phase margin, °: wide, unstable, or never a crossover."""
    fact = Fact(
        LoopFact.MARGIN_UNCERTAIN,
        phase_margin_interval=interval,
        is_stable=is_stable,
        is_steered=True,
    )
    assert reason in str(fact) and "doublets" not in fact.remedy
    assert "doublets" in fact.replace(is_steered=False).remedy
    # Where a message is slow, its rate is what the flight lacks, and not the time.
    slow = fact.replace(names=("ATTITUDE", "the rate setpoint"), rates=(98.0, 19.5))
    assert slow.remedy.startswith("Fly again, with rates and motors logged at 100 Hz")
    assert "the rate setpoint at 20 Hz" in slow.remedy
    peak = Fact(MarginsLight.RATE_STANDS_OUT, axis="roll", frequency=22.0, ratio=5.9, reason=fact)
    hover = Fact(LoopAction.HOVER_WITH_LOWER_GAINS, axis="roll", changes=(), reason=peak)
    assert "Fly" not in str(hover)


@mark.parametrize(
    "more, change, status",
    [
        (2.0, {}, Status.REPORTED),  # The phase margin is 33°.
        (2.6, {}, Status.BIASED),  # The phase margin is 19°.
        # The phase margin is 19°, because of the delay.
        (0.9, {"lag": 0.002, "delay": 0.05}, Status.REPORTED),
    ],
)
def test_of_a_loop_that_rings_beyond_its_motors_effect_and_lag_are_biased(
    log, more, change, status
):
    signals, flights = flown(thinned(log, 8))
    plant = identify_plant_in_loop(signals, flights)
    _, controller, directions = in_flight._identified_loop(signals, tuple(flights))
    sure = plant._replace(effect=more * plant.effect, covariance=1e-4 * plant.covariance)
    checked = in_flight._checked_plant(sure._replace(**change), directions, controller)
    assert set(checked.status.values()) == {status}


@mark.parametrize("gain", [0.0, 0.5])
def test_a_controller_of_other_gains_than_flew_finds_no_plant(log, gain):
    signals, (flight,) = flown(thinned(log, 8))
    parameters = {**flight.provenance["parameters"], "MC_ROLLRATE_K": gain}
    other = replace(flight, provenance={**flight.provenance, "parameters": parameters})
    assert refusal(signals, [other]) is LoopFact.LOOP_NOT_FOUND


@mark.in_full
def test_with_motors_at_their_limits_the_margins_are_true():
    """Limits cut off most of what the controller asks for in quick doublets: it acts as one of less gain."""
    hard = SCENARIO.model_dump(mode="json")
    hard["vehicle"]["rate_gain"] = 4.0
    hard["vehicle"]["parameters"] = {"IMU_GYRO_RATEMAX": 200}
    hard["stream"] = {"rate": 100, "rates": {"ATTITUDE_TARGET": 100}}
    hard["excitation"] |= {"amplitude": 25.0, "width": 0.1}
    known, log = logged(scenario_from_table(hard))
    signals, flights = flown(log)
    loop = loop_from_plant(identify_plant_in_loop(signals, flights), Record.from_flights(flights))
    fit, *_ = (result.fit for result in signals.cache.values() if hasattr(result, "fit"))
    assert 0.5 < fit.saturation_loss < fit.posterior.saturated_share
    _, phase, gain, _ = known["roll_rate_margins"]
    assert abs(loop.phase_margin - phase) < 5 and abs(loop.gain_margin - gain) < 1.5


def test_output_that_the_controller_does_not_explain_widens_the_effect_alone(log):
    """Much of the output is unexplained by the controller.

    Effect has wider intervals, damping, lag and delay do not.
    """
    signals, flights = flown(log)
    identify_plant_in_loop(signals, flights)
    fit, gains = next(
        (result.fit, result.inputs_per_demand)
        for result in signals.cache.values()
        if hasattr(result, "fit")
    )

    def relative_deviations(unexplained):
        theta = fit.theta.copy()
        theta[PARAMETER_NAMES.index("actuation")] = np.log(unexplained)
        plant = physical_plant(fit._replace(theta=theta), gains)
        sizes = [*plant.effect, plant.damping, plant.lag, plant.delay]
        return np.sqrt(np.diag(plant.covariance)) / np.abs(sizes)

    explained, unexplained = relative_deviations(1e-3), relative_deviations(0.4)
    assert np.all(unexplained[:4] > 0.08) and np.all(explained[:4] < 0.06)
    assert_allclose(unexplained[4:], explained[4:])


def test_a_setpoint_with_the_correction_of_the_angle_in_it_is_taken_as_it_is():
    """ArduPilot's log message RATE has the complete setpoint: measured and predicted response agree."""
    flight = mavdem.read_flight(shared("sitl_events/ap_quiet10.BIN"))
    learned = mavdem.learn(flight)
    loop = learned.loop()
    assert loop.measured is not None and loop.measured.agreement > 90
    # Results are read-only, also after another process has received them.
    unpickled = pickle.loads(pickle.dumps(learned))
    torque = learned.wind_torque.band
    for array in (
        unpickled.model.A,
        learned.physical.effect,
        torque,
        loop.effectiveness,
        loop.rate.stable,
    ):
        assert not array.flags.writeable


def test_what_the_angles_error_asks_for_is_added_to_ardupilots_setpoint_of_the_rate():
    """ATTITUDE_TARGET lacks the correction by the angle's error, which is angle gain × error."""
    time = np.arange(10.0, 40.0, 0.01)
    attitude_setpoint, ahead = 0.1 * np.sin(time), 0.1 * np.cos(time)
    controller = controller_from_parameters(ARDUPILOT, "roll", X_ROLL)
    signals = Signals(asking(Hover().telemetry(), time, 0, ahead, attitude_setpoint))
    streams = _loop_messages(signals, 0, controller, np.ones(4)).streams
    assert_allclose(streams[5].values, ahead + controller.angle_gain * attitude_setpoint, atol=1e-6)


def test_a_simulated_flight_has_the_margins_of_its_linearised_loop():
    """Of ArduPilot, by the plant without its loop."""
    steered = {"kind": "multisine", "sd": 3.0, "lowest": 0.2, "highest": 4.0, "period": 10.0}
    parameters = {"SCHED_LOOP_RATE": 200}
    vehicle = {"model": "iris", "rate_gain": 1.4, "parameters": parameters}
    stream = {"autopilot": "ardupilot", "rates": {"ATTITUDE_TARGET": 100}}
    scenario = {"excitation": steered, "stream": stream, "seed": 5, "duration": 45}
    known, log = logged(scenario_from_table(scenario | {"vehicle": vehicle}))
    record = Record.from_flights(flown(log)[1])
    plant = physical(record)
    loop = loop_from_plant(plant, record)
    crossover, phase, *_ = margins = known["roll_rate_margins"]
    assert loop.crossover == approx(crossover, rel=0.1)
    assert loop.phase_margin == approx(phase, abs=6)
    names = ("crossover", "phase_margin", "gain_margin", "ms")
    for name, true in zip(names, margins, strict=True):
        low, high = getattr(loop, f"{name}_interval")
        assert low <= true <= high
    assert loop.attitude.crossover == approx(known["roll_attitude_margins"][0], rel=0.1)
    assert loop.agrees and loop.measured.fit > 80 and loop.rate.stable.all()
    assert loop.measured.controller_gain == approx(1, abs=0.2)
    name = loop.controller.parameter_names["p"]
    doubled = loop.with_parameters({name: 2 * record.parameters[name]})
    assert doubled.crossover > 1.5 * loop.crossover and doubled.agrees is None
    assert (
        loop_from_plant(plant, replace(record, setpoints=np.zeros_like(record.setpoints))).agrees
        is None
    )
    retuned = loop_from_plant(plant, replace(record, earlier={name: 0.1}))
    (caution,) = retuned.cautions
    assert retuned.agrees is None and caution.code is LoopFact.PARAMETERS_CHANGED
    assert caution.figures["changes"] == ((name, 0.1, record.parameters[name]),)
    # Gains that were not those in flight.
    other = loop_from_plant(
        plant, record, loop.controller.with_parameters({name: 0.5 * record.parameters[name]})
    )
    assert other.agrees is False
    assert other.measured.reason.code is ResponseFact.CONTROLLER_GAIN_DIFFERS
    assert other.advice.refusals == (other.measured.reason,)
