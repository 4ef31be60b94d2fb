"""Physical parameters: what commands may tell is what they do, and flights that steer give their truth back.

And what commanded motors would do: the plant alone, beside a plant that is commanded.
"""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark, param, raises, warns
from scipy.linalg import expm, solve_continuous_lyapunov
from simulated import DAMPING, DT, LAG, MOTORS, in_closed_loop

import mavdem
from mavdem import Flight, Settings, read_flight
from mavdem.confidence import STRONG_EVIDENCE_NATS
from mavdem.dem.record import Record
from mavdem.experiments.paper.flights import write_log
from mavdem.facts import Level
from mavdem.facts.identifiability import Status
from mavdem.facts.model import NoPhysical, ParameterDoubt, Refinement
from mavdem.plant import identifiability as limits
from mavdem.plant import physical
from mavdem.plant.estimation import with_omission_errors
from mavdem.plant.fitting import LogPosterior, fit_gray_box, initial_model
from mavdem.plant.identifiability import PARAMETERS, NotIdentifiable, identifiability
from mavdem.plant.likelihood import DELAY_PRIOR, minimum_phase
from mavdem.plant.parameters import Physical
from mavdem.plant.sampled_plant import (
    FIRST_ORDER,
    GAUSSIAN_KERNEL,
    WindComponent,
    delayed_inputs,
    gaussian_kernel_noise,
    with_advanced_jumps,
)
from mavdem.plant.simulation import simulate_response
from mavdem.plant.windows import (
    MAX_JUMP_ADVANCE,
    FlightWindows,
    cut_windows,
    responses_to_innovations,
)
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.simulation import fly


@mark.parametrize(
    "noise, autocorrelation, error",
    [
        (FIRST_ORDER, lambda tau: np.exp(-tau), 1e-6),
        (gaussian_kernel_noise(8), lambda tau: np.exp(-(tau**2) / 4), 2e-3),
        (GAUSSIAN_KERNEL, lambda tau: np.exp(-(tau**2) / 4), 0.04),
    ],
    ids=["first order", "smooth", "gusts"],
)
def test_noise_has_the_autocorrelation_it_is_named_for(noise, autocorrelation, error):
    """The state-space noise models have exponential or Gaussian autocorrelations, in time and by their densities."""
    P = solve_continuous_lyapunov(noise.A, -noise.Q)
    turn = np.linspace(0.0, 400.0, 200_001)
    density = noise.density(turn, 1.0, 1.0)
    for tau in (0.0, 0.5, 1.0, 2.0, 4.0):
        assert noise.C @ expm(noise.A * tau) @ P @ noise.C == approx(
            autocorrelation(tau), abs=error
        )
        of_density = np.trapezoid(density * np.cos(turn * tau), turn) / np.pi
        assert of_density == approx(autocorrelation(tau), abs=error + 2e-3)


@mark.parametrize("samples", [200, 201])
def test_a_density_has_a_factor_that_is_causal_as_its_inverse_is(samples):
    late = np.exp(-2j * np.pi * np.arange(samples // 2 + 1) / samples)
    expected = (1 - 0.3 * late) / (1 - 0.8 * late)
    factor, variance = minimum_phase(np.array([2.5 * abs(expected) ** 2]), samples)
    assert_allclose(factor[0], expected, rtol=1e-9)
    assert variance == approx(2.5)


@mark.parametrize("steps", [-0.4, 0.0, 0.3, 1.0, 1.7, 3.2])
def test_commands_act_as_late_as_they_are(steps):
    before, after = delayed_inputs(np.arange(20.0)[:, None], steps)
    now = np.arange(5, 19)
    assert_allclose(before[5:, 0], now - max(0.0, steps))
    assert_allclose(after[5:, 0], now + 1 - max(0.0, steps))


@mark.parametrize("gain", [0.0, 3.0])
def test_what_answers_a_sample_is_found(gain):
    rng = default_rng(6)
    rate = np.cumsum(rng.standard_normal((3, 600)), axis=1)
    new = np.diff(rate, axis=1, prepend=0.0)
    slow = np.cumsum(0.2 * rng.standard_normal((3, 600)), axis=1)
    inputs = (slow - gain * new)[:, :, None]
    estimate = responses_to_innovations(inputs, rate)[:, 10:, 0]
    assert_allclose(estimate, -gain * new[:, 10:], atol=0.25 * max(gain, 1))


def steered_windows():
    """Three windows of a flight that is steered in a closed loop."""
    flight = in_closed_loop(2, steering=1.0, samples=900)
    inputs = (flight.inputs - flight.inputs.mean(axis=0)).reshape(3, 300, -1)
    rate = flight.outputs[:, 1].reshape(3, -1)
    return FlightWindows.from_samples(inputs, rate, responses_to_innovations(inputs, rate), DT)


@mark.slow
def test_the_slope_of_the_log_joint_is_that_of_its_value():
    """The gradient of the log posterior equals its central differences."""
    windows = steered_windows()
    plain, start = initial_model(windows, np.sign(MOTORS))
    objective = LogPosterior(plain, windows)
    expansion = objective.expand(start)
    for index, slope in enumerate(expansion.gradient):
        step = 1e-5 * np.eye(len(start))[index]
        ends = [objective.value(start + side * step) for side in (-1, 1)]
        assert slope == approx(np.diff(ends)[0] / 2e-5, abs=1e-2 * abs(expansion.gradient).max())


def refined_model():
    """A gray-box model with all kinds of parameters, and three windows of a steered flight."""
    windows = steered_windows()
    plain, _ = initial_model(windows, np.sign(MOTORS))
    model = plain._replace(
        wind=(FIRST_ORDER, GAUSSIAN_KERNEL), refinements=(Refinement.THRUST_CURVE, Refinement.JUMPS)
    )
    return model, windows


@mark.slow
def test_errors_after_steps_are_those_at_the_changed_parameters():
    model, windows = refined_model()
    mean, sd = model.prior
    theta = mean + 0.1 * sd * default_rng(3).standard_normal(len(mean))
    errors, _ = model.innovations(np.vstack([theta, theta + np.diag(sd / 5)]), windows)
    assert_allclose(model.innovations_after_steps(theta, sd / 5, windows), errors, atol=1e-12)


@mark.slow
def test_a_fit_without_delay_has_the_curvature_of_delays():
    """The likelihood is flat below, and rounding must not choose on which side of the kink it is differentiated."""
    model, windows = refined_model()
    below, _ = model.prior
    below[model.delay_index] = -1e-9
    at_start = fit_gray_box(model, windows, below, min_gain=np.inf)
    assert at_start.theta[model.delay_index] == 0.0
    expected = LogPosterior(model, windows).full_expansion(at_start.theta)
    assert_array_equal(at_start.curvature, expected.curvature)
    # The likelihood speaks on the delay, more than its prior does.
    assert at_start.curvature[model.delay_index, model.delay_index] > 2 / DELAY_PRIOR.sd**2


@mark.slow
def test_a_fit_to_commands_logged_late_converges_at_no_delay():
    """Commands that act before they are logged pull the delay below 0; the other parameters reach their maximum."""
    flight = in_closed_loop(2, steering=1.0, samples=900)
    deviations = np.roll(flight.inputs - flight.inputs.mean(axis=0), 2, axis=0)
    inputs = deviations.reshape(3, 300, -1)
    rate = flight.outputs[:, 1].reshape(3, -1)
    windows = FlightWindows.from_samples(inputs, rate, np.zeros_like(inputs), DT)
    model, start = initial_model(windows, np.sign(MOTORS))
    fit = fit_gray_box(model, windows, start)
    assert fit.theta[model.delay_index] == 0.0
    objective = LogPosterior(model, windows)
    assert objective.full_expansion(fit.theta).gradient[model.delay_index] < 0
    # The last step of a converged fit gains next to nothing, and so would one more: far less than evidence of a model.
    assert objective.expand(fit.theta).predicted_gain < STRONG_EVIDENCE_NATS / 30


@mark.slow
@mark.parametrize(
    "directions",
    [np.sign(MOTORS), -np.sign(MOTORS), None],
    ids=["known geometry", "turns counted the other way round", "inferred geometry"],
)
def test_a_steered_flight_gives_the_truth_back(directions):
    """A simulated flight with steering: effect, damping and lag are within their 99 % intervals of the truth."""
    flight = in_closed_loop(0, steering=1.0)
    estimate = physical(replace(flight, effect_directions=directions))
    assert estimate.status == dict.fromkeys(PARAMETERS, "reported")
    assert estimate.caution is None
    half = estimate.interval(0.99)
    assert np.all(abs(estimate.effect - MOTORS) < half.effect)
    mean, of_mean = estimate.mean_effect(0.99)
    assert abs(mean - abs(MOTORS).mean()) < of_mean < half.effect.mean()
    assert abs(estimate.damping - DAMPING) < half.damping
    assert abs(estimate.lag - LAG) < half.lag
    assert repr(estimate).startswith("<Physical: mean effect ")


@mark.slow
def test_an_effect_that_the_wind_biases_comes_out_low():
    """The motors answer the wind: what they do counts for less."""
    flight = in_closed_loop(0, steering=0.4)
    estimate = physical(replace(flight, effect_directions=np.sign(MOTORS)))
    assert estimate.status["effect"] == Status.BIASED and estimate.bias < 0


@mark.slow
def test_a_motor_that_does_not_do_what_it_is_commanded_is_no_right_effect():
    """The mixer has four motors, of which one was stuck: its commands moved nothing."""
    flight = in_closed_loop(0, steering=1.0)
    inputs = flight.inputs.copy()
    inputs[:, 1] = default_rng(1).permutation(inputs[:, 1])
    estimate = physical(replace(flight, inputs=inputs, effect_directions=np.sign(MOTORS)))
    assert estimate.status["effect"] == Status.BIASED
    assert estimate.reasons["effect"].code is ParameterDoubt.MOTORS_DIFFER
    assert "does not answer its command" in estimate.reasons["effect"].sentence


SDS = dict.fromkeys(PARAMETERS, 0.05)
SPREADS = dict.fromkeys(PARAMETERS, 0.02)
SOUND = limits.IdentifiabilityMeasures(0.1, 0.01, SDS, SPREADS, lag=0.03, dt=0.01)


def test_an_effect_that_a_filter_biases_says_nothing_about_the_motors():
    contradicting = SOUND._replace(motor_deviation=0.9, motor_deviation_sd=0.01)
    assert [
        {
            check.doubt.code
            for check in limits._checks_of_parameter("effect", measures)
            if check.status != Status.REPORTED
        }
        for measures in (contradicting, contradicting._replace(lag=0.001))
    ] == [{ParameterDoubt.MOTORS_DIFFER}, {ParameterDoubt.FILTER_TAKEN_FOR_LAG}]


DOUBTS = {
    "sd": {ParameterDoubt.ESTIMATE_UNCERTAIN},
    "spectrum_range": {ParameterDoubt.DEPENDS_ON_WIND_SPECTRUM},
    "wind_share": {ParameterDoubt.WIND_SHARE_HIGH},
    "alias_share": {ParameterDoubt.COMMANDS_TOO_FAST},
    "motor_deviation": {ParameterDoubt.MOTORS_DIFFER},
    "lag": {
        ParameterDoubt.LAG_TOO_SHORT,
        ParameterDoubt.FILTER_TAKEN_FOR_LAG,
        ParameterDoubt.FOLLOWS_FROM_EFFECT,
    },
}
"""Why a parameter is doubted, by the figure beyond its limit."""


def edges():
    """Each limit with the figure, the parameter it belongs to, and its status on either side."""
    for figure, table in (("sd", limits.RELATIVE_SD), ("spectrum_range", limits.SPECTRUM_RANGE)):
        for name, (reported, biased) in table.items():
            if reported < biased:
                yield figure, name, reported, "reported", "biased"
            yield (
                figure,
                name,
                biased,
                "biased" if reported < biased else "reported",
                "not identifiable",
            )
    for name in PARAMETERS:
        yield "wind_share", name, limits.WIND_SHARE.reported, "reported", "biased"
        yield "wind_share", name, limits.WIND_SHARE.biased, "biased", "not identifiable"
        yield "alias_share", name, limits.MAX_ALIAS_SHARE, "reported", "not identifiable"
    yield "lag", "lag", limits.RESOLVED_LAG * SOUND.dt, "not identifiable", "biased"
    yield "lag", "effect", SOUND.dt, "biased", "reported"
    yield "motor_deviation", "effect", 3 * SOUND.motor_deviation_sd, "reported", "biased"


@mark.parametrize("figure, name, limit, below, above", list(edges()))
def test_a_status_changes_at_its_limit_and_says_why(figure, name, limit, below, above):
    """A figure of identifiability just below and just above its limit gives another status of the parameter."""
    for value, expected in ((limit * (1 - 1e-9), below), (limit * (1 + 1e-9), above)):
        changed = (
            {**getattr(SOUND, figure), name: value}
            if isinstance(getattr(SOUND, figure), dict)
            else value
        )
        statuses, reasons = identifiability(SOUND._replace(**{figure: changed}))
        assert statuses[name] == expected
        if expected == "reported":
            assert reasons[name] is None
        else:
            assert reasons[name] is not None
        if reasons[name] is not None:
            doubts = reasons[name].figures.get("reason", [reasons[name]])
            if expected == "biased":
                assert reasons[name].level is Level.WATCH
            else:
                assert reasons[name].level is not Level.WATCH
            assert DOUBTS[figure] & {doubt.code for doubt in doubts}


@mark.parametrize(
    "rate, steps, status", [(50, 2.4, "biased"), (50, 2.6, "reported"), (80, 2.4, "reported")]
)
def test_at_a_slow_rate_a_short_lag_is_mixed_up_with_delay_and_damping(rate, steps, status):
    statuses, _ = identifiability(SOUND._replace(dt=1 / rate, lag=steps / rate))
    assert statuses == {"effect": "reported", "damping": status, "lag": status}


@mark.parametrize(
    "quick_share, slow_wind_share, status",
    [
        (0.05, 0.8, Status.NOT_IDENTIFIABLE),
        (0.05, 0.2, Status.REPORTED),
        (0.3, 0.8, Status.REPORTED),
    ],
)
def test_slow_inputs_determine_the_effect_only_with_little_wind(
    quick_share, slow_wind_share, status
):
    measures = SOUND._replace(quick_share=quick_share, slow_wind_share=slow_wind_share)
    statuses, reasons = identifiability(measures)
    assert set(statuses.values()) == {status}
    if status is Status.NOT_IDENTIFIABLE:
        assert reasons["effect"].code is ParameterDoubt.INPUTS_TOO_SLOW
        assert "5 % of the motors' torque is quicker than 2 Hz" in reasons["effect"].sentence


@mark.slow
@mark.parametrize(
    "excitation, status",
    [
        (None, Status.NOT_IDENTIFIABLE),
        param({"kind": "doublets"}, Status.REPORTED, marks=mark.in_full),
    ],
)
def test_smooth_gusts_are_not_taken_for_motors_where_nobody_steers(tmp_path, excitation, status):
    wind = [
        {"kind": "steady", "speed": 5.0, "direction": 90.0},
        {"kind": "gaussian", "sd": 1.0, "s": 0.25},
    ]
    scenario = scenario_from_table(
        {"duration": 30.0, "seed": 11, "wind": wind, "excitation": excitation}
    )
    write_log(tmp_path / "flight.tlog", scenario, fly(scenario))
    plant = physical(read_flight(tmp_path / "flight.tlog", axis="roll"))
    assert plant.status["effect"] is status


def test_several_doubts_are_one_reason():
    measures = SOUND._replace(wind_share=0.5, alias_share=0.9)
    statuses, reasons = identifiability(measures)
    assert set(statuses.values()) == {Status.NOT_IDENTIFIABLE}
    assert reasons["effect"].code is ParameterDoubt.SEVERAL_DOUBTS
    wind, commands = reasons["effect"].figures["reason"]
    assert (wind.code, wind.figures["share"]) == (ParameterDoubt.WIND_SHARE_HIGH, 0.5)
    assert commands.code is ParameterDoubt.COMMANDS_TOO_FAST


@mark.slow
def test_gaps_are_not_filtered_across():
    flight = in_closed_loop(1, steering=1.0)
    whole = physical(flight)
    apart = physical([flight[:350], flight[350:]])
    assert_allclose(apart.effect @ MOTORS, whole.effect @ MOTORS, rtol=0.05)
    assert apart.windows == 2


@mark.slow
def test_inputs_that_curve_are_seen_on_unseen_windows_and_straight_ones_are_not():
    flight = in_closed_loop(5, steering=2.0, samples=2800)
    off = flight.inputs - 1500
    # The inverse of u + 0.1 u²/2 per unit of the inputs' standard deviation.
    unit = np.sqrt(off.var(axis=0).mean())
    curved = replace(flight, inputs=1500 + unit * (np.sqrt(1 + 0.2 * off / unit) - 1) / 0.1)
    assert Refinement.THRUST_CURVE in physical(curved).refinements
    assert physical(flight).refinements.get(Refinement.THRUST_CURVE, 0.0) == approx(0.0, abs=0.05)


@mark.parametrize(
    "change, reason",
    [
        (lambda f: replace(f, outputs=f.outputs[:, [1, 1]]), NoPhysical.NO_RATE),
        (lambda f: replace(f, inputs=0 * f.inputs), NoPhysical.MOTORS_STILL),
        (lambda f: f[:150], NoPhysical.TOO_FEW_SAMPLES_WITHOUT_GAPS),
        (lambda f: Flight(4 * f.time, f.inputs, f.outputs), NoPhysical.SAMPLED_TOO_SLOWLY),
        (lambda f: Flight(f.time, f.inputs, 0 * f.time), NoPhysical.NO_LIKELIHOOD),
    ],
)
def test_what_cannot_be_fitted_is_said(change, reason):
    """The flight lacks the rate or motion of the motors, is short or slow, or has outputs that are all 0."""
    estimate = physical(change(in_closed_loop(0, steering=1.0)))
    assert isinstance(estimate, NotIdentifiable) and estimate.reason.code is reason
    assert estimate.reason.figures.get("rate", 25.0) == approx(25.0)


STEPS = 100
DOUBLET = np.repeat([1.0, -1.0, 0.0, 0.5], STEPS // 4)[:, None] * np.sign(MOTORS) * 20
REPORTED = dict.fromkeys(PARAMETERS, Status.REPORTED), dict.fromkeys(PARAMETERS)
TURBULENCE = (WindComponent(FIRST_ORDER, 1.0, 0.5),)
# The delay is half a step, and half of one for which a command is held.
VEHICLE = MOTORS, DAMPING, LAG, DT, np.zeros((7, 7)), *REPORTED, 0.0
TRUE = Physical(*VEHICLE, 0.05, TURBULENCE, 0.005, {}, 1)


@mark.slow
def test_the_true_plant_does_what_the_vehicle_does_in_calm_air():
    flight = in_closed_loop(0, steering=0.5, samples=400 + STEPS, wind=0.0, commanded=DOUBLET)
    train = flight[:400]
    test = flight[400:]
    estimate = simulate_response(TRUE, Record.from_flights(train), test.inputs).mean
    # The last measured rate has noise of 0.005 rad/s, and so has each of the test.
    assert_allclose(estimate, test.outputs, atol=0.04)
    assert np.ptp(test.outputs, axis=0).min() > 0.4


def test_what_turns_steadily_at_its_trim_goes_on_turning():
    time = DT * np.arange(400)
    outputs = np.stack([0.5 * time - 1e-3 * np.cos(time), 0.5 + 1e-3 * np.sin(time)], axis=1)
    turning = Flight(time, np.full((400, 4), 1500.0), outputs)
    estimate = simulate_response(TRUE, Record.from_flights(turning), turning.inputs[:STEPS]).mean
    assert_allclose(estimate[:, 1], 0.5, atol=2e-3)


@mark.slow
def test_the_variance_is_that_of_wind_which_nothing_counteracts():
    """Over many winds, from the same beginning: four standard errors of a variance of so many flights."""
    record = Record.from_flights(in_closed_loop(0, steering=0.5))
    flights = 400
    variance = simulate_response(TRUE, record, record.inputs[:STEPS]).variance
    rng = default_rng(0)
    fine = 10
    step = DT / fine
    keeps = np.exp(-step / 0.5)
    drift = rng.standard_normal(flights)
    rate = np.zeros(flights)
    angle = np.zeros(flights)
    for k in range(STEPS):
        for _ in range(fine):
            rate, angle = rate + step * (drift - DAMPING * rate), angle + step * rate
            drift = keeps * drift + np.sqrt(1 - keeps**2) * rng.standard_normal(flights)
        if k in (9, 49, 99):
            estimate = np.array([angle.var(), rate.var()])
            assert_allclose(estimate, variance[k], rtol=4 * np.sqrt(2 / flights))


ESTIMATES = np.array([40.0, -20.0, 1.5, 0.05, 0.01])
"""Two effects, damping, lag and delay."""


def covariance_by_omissions(spectrum_range=(0.0, 0.0, 0.0), **measures):
    """The covariance of the ``ESTIMATES`` by what the model leaves out alone, with these measures of the fit."""
    return with_omission_errors(
        np.zeros((5, 5)),
        ESTIMATES,
        np.full(2, 0.5),
        np.array(spectrum_range),
        0.0,
        effect_unknown=False,
        measures=limits.IdentifiabilityMeasures(0.1, 0.1, {}, {}, lag=0.05, dt=0.01, **measures),
    )


def test_what_the_model_leaves_out_adds_its_variances():
    """Where the likelihood knows everything exactly: two effects, damping, lag and delay."""
    covariance = covariance_by_omissions()
    errors = limits.OmissionErrors
    relative = np.full((2, 2), errors.effect**2) + errors.motor**2 * np.eye(2)
    effects = ESTIMATES[:2]
    assert_allclose(covariance[:2, :2], np.outer(effects, effects) * relative)
    lag_variance = (0.05 * errors.lag) ** 2
    assert_allclose(covariance[2, 2:], [errors.damping**2, 0, 0])
    exchanged = lag_variance * np.array([[0, -0.5], [-0.5, 1]])
    assert_allclose(covariance[3:, 3:], np.diag([lag_variance, errors.delay**2]) + exchanged)


def test_an_effect_that_changes_with_the_command_widens_intervals():
    """It is meant at a command within one standard deviation, as likely at each: a change of 18 % errs by 18/√3 %.

    And slow torque by quick commands is taken for damping.
    """
    straight = covariance_by_omissions()
    curved = covariance_by_omissions(thrust_curve=-0.18)
    added = np.zeros((5, 5))
    added[:2, :2] = np.outer(ESTIMATES[:2], ESTIMATES[:2]) * 0.18**2 / 3
    added[2, 2] = (0.18 * limits.OmissionErrors.thrust_curve_damping) ** 2
    assert_allclose(curved - straight, added, atol=1e-12)


def test_commands_that_nothing_predicts_widen_the_intervals():
    """Of 10 % of the commands' variance nobody knows how long they last: added to all that the model leaves out.

    A lag that is too long comes with a delay that is too short by as much.
    """
    added = covariance_by_omissions(unpredicted_share=0.1) - covariance_by_omissions()
    errors = limits.OmissionErrors
    error = 0.1 * np.array([errors.unpredicted_effect, errors.unpredicted_lag])
    lag_variance = (0.05 * error[1]) ** 2
    expected = [*(ESTIMATES[:2] * error[0]) ** 2, 0.0, lag_variance, lag_variance]
    assert_allclose(added.diagonal(), expected, atol=1e-15)


@mark.parametrize("spectrum_range", [0.0, 0.3, 30.0], ids=["little", "some", "no idea"])
def test_the_delay_errs_by_the_lag_that_is_taken_for_it(spectrum_range):
    """Their sum is as certain as without that error, and the delay's error stays credible where the lag is unknown."""
    covariance = covariance_by_omissions(spectrum_range=(0.0, 0.0, spectrum_range))
    lag_variance, delay_variance = covariance.diagonal()[3:]
    expected = 0.05**2 * (np.pi * (spectrum_range / 3) ** 2 + limits.OmissionErrors.lag**2)
    assert lag_variance == approx(expected)
    own_variance = limits.OmissionErrors.delay**2
    credible_variance = (3 * DELAY_PRIOR.sd) ** 2
    assert delay_variance == approx(own_variance + min(lag_variance, credible_variance))
    assert covariance[3:, 3:].sum() == approx(lag_variance + own_variance)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_noise_of_commands_is_what_nothing_predicts():
    flight = in_closed_loop(0, steering=1.0, samples=700)
    noise = 30 * default_rng(1).standard_normal(flight.inputs.shape)
    noisy = Record.from_flights(replace(flight, inputs=flight.inputs + noise))
    plain_share = cut_windows(Record.from_flights(flight)).unpredicted_share
    noise_share = np.mean(noise**2) / (np.mean(noise**2) + flight.inputs.var(axis=0).mean())
    # A part of the noise stays unpredicted beside what was so before.
    assert plain_share + noise_share / 2 < cut_windows(noisy).unpredicted_share < 1


@mark.slow
@mark.parametrize(
    "seed, advance, fitted",
    [(0, 0.6, None), (0, -0.3, approx(0.4, abs=0.05)), (1, -0.4, MAX_JUMP_ADVANCE)],
    ids=["late", "early", "as early as possible"],
)
def test_jumps_may_come_early_in_a_step_and_not_late(seed, advance, fitted):
    """The log has the jumps earlier or later than the vehicle: the fit must move them back."""
    flight = in_closed_loop(seed, steering=1.0, wind=0.2)
    logged = with_advanced_jumps(flight.inputs[None], advance)[0]
    estimate = physical(replace(flight, inputs=logged, effect_directions=np.sign(MOTORS)))
    assert estimate.refinements.get(Refinement.JUMPS) == fitted
    if fitted is not None:
        effect, _ = estimate.mean_effect()
        assert effect == approx(abs(MOTORS).mean(), rel=0.02)


@mark.slow
def test_uncertain_parameters_widen_it_to_first_order():
    record = Record.from_flights(in_closed_loop(0, steering=0.5))
    sd = 0.03 * abs(MOTORS)
    covariance = np.zeros((7, 7))
    covariance[:4, :4] = np.outer(sd, sd)
    uncertain = simulate_response(
        TRUE._replace(covariance=covariance), record, 1500 + DOUBLET
    ).variance
    base = simulate_response(TRUE, record, 1500 + DOUBLET)
    other = simulate_response(TRUE._replace(effect=MOTORS + sd), record, 1500 + DOUBLET)
    assert_allclose(uncertain - base.variance, (other.mean - base.mean) ** 2, rtol=1e-3, atol=1e-12)


@mark.slow
def test_outputs_may_come_in_any_order_and_must_be_an_angle_and_its_rate():
    """Angle and rate are swapped, and then two rates are given."""
    flight = in_closed_loop(0, steering=0.5)
    with_swapped_outputs = replace(flight, outputs=flight.outputs[:, ::-1])
    one, other = (
        simulate_response(TRUE, Record.from_flights(each), 1500 + DOUBLET)
        for each in (flight, with_swapped_outputs)
    )
    assert_allclose(one.mean, other.mean[:, ::-1])
    assert_allclose(one.variance, other.variance[:, ::-1])
    with raises(ValueError, match="an angle and its rate"):
        rates = Flight(flight.time, flight.inputs, flight.outputs[:, 1:])
        simulate_response(TRUE, Record.from_flights(rates), DOUBLET)


SETTINGS = Settings(order=3, window=9, parameter_precision=10.0)


@mark.in_full
def test_bands_hold_commanded_flights():
    """Simulated responses to doublets of flights that were not trained on lie within their 90 % bands."""
    inside = []
    errors = []
    for seed in range(3):
        flight = in_closed_loop(
            seed, steering=1.0, samples=700 + STEPS, wind=0.5, commanded=DOUBLET
        )
        train = flight[:700]
        test = flight[700:]
        learned = mavdem.learn(train, SETTINGS)
        assert learned.physical is not None and learned.physical.identifiable
        ahead = learned.simulate(test.inputs)
        inside.append(np.mean(abs(ahead - test.outputs) <= learned.simulate_band(test.inputs)))
        errors.append(mavdem.evaluate.relative_mspe(train, test, ahead))
    assert np.mean(inside) > 0.8
    assert np.median(errors) < 0.1
    variance = simulate_response(learned.physical, learned.record, test.inputs).variance
    # Half of a normal distribution.
    assert_allclose(learned.simulate_band(test.inputs, 0.5), 0.67449 * np.sqrt(variance), rtol=1e-5)


@mark.slow
def test_nothing_is_identifiable_where_motors_only_react_to_wind_and_no_band_exists():
    """A hover in wind without steering shows no physical parameters, so that simulations warn."""
    flight = in_closed_loop(0, steering=0.0, wind=3.0)
    learned = mavdem.learn(flight, SETTINGS)
    estimate = learned.physical
    assert estimate.status == dict.fromkeys(PARAMETERS, "not identifiable")
    assert np.isnan(estimate.interval().effect).all()
    assert estimate.caution.code is NoPhysical.EFFECT_NOT_IDENTIFIABLE
    assert estimate.caution.figures["reason"] == estimate.reasons["effect"]
    with warns(UserWarning, match="may be far off.*not identifiable"):
        assert learned.simulate(flight.inputs[:20]).shape == (20, 2)
    with raises(ValueError, match="not be larger"), warns(UserWarning):
        learned.simulate(flight.inputs * 1e200)
    with raises(ValueError, match="no band.*not identifiable"):
        learned.simulate_band(flight.inputs[:20])
