"""Differences between states of a vehicle: found where they are, rarely where they are not, and never hidden."""

import json
from dataclasses import replace
from math import expm1, log1p

import numpy as np
import scipy
from fleet_rows import flight_row
from numpy.random import default_rng
from pytest import approx, mark
from scipy.stats import norm, t

from mavdem.confidence import coverage_factor
from mavdem.documents import complete_document
from mavdem.documents.fleet import Diff
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts.fleet import ComparedSubject, Incomparable, QuantityOutcome
from mavdem.fleet.calibration_changes import calibration_changes
from mavdem.fleet.difference import vehicle_difference
from mavdem.fleet.flight_conditions import mean_conditions
from mavdem.fleet.parameter_changes import (
    ParameterChange,
    axes_with_other_attitude_gains,
    axes_with_other_gains,
    changed_parameters,
    compared_parameters,
    parameters_changed_by_autopilot,
    states_without_gains,
)
from mavdem.fleet.quantities import (
    ATTITUDE_GAIN_MARGIN,
    ATTITUDE_PHASE_MARGIN,
    DAMPING,
    EFFECT,
    GAIN_MARGIN,
    LAG,
    LOGARITHMIC_KINDS,
    LOOP_KINDS,
    MAX_SENSITIVITY,
    MEAN_EFFECT,
    OVERSHOOT,
    PHASE_MARGIN,
    RISE,
    SHARE,
    Estimate,
    Quantity,
)
from mavdem.fleet.random_effects import (
    SD_BETWEEN_FLIGHTS,
    QuantityChange,
    quantity_change,
    significance_of_single_change,
    with_outcomes,
)

Z90 = 1.645
SHARES = np.array([1.0, 0.98, 1.03, 0.99])
EFFECTS = np.array([-40.0, 40.0, 41.0, -39.0])
COLUMNS_OF_LOOPS = {
    PHASE_MARGIN: "phase_margin",
    GAIN_MARGIN: "gain_margin",
    ATTITUDE_PHASE_MARGIN: "attitude_phase_margin",
    ATTITUDE_GAIN_MARGIN: "attitude_gain_margin",
    MAX_SENSITIVITY: "ms",
    OVERSHOOT: "rate_overshoot",
    RISE: "rate_rise",
}


def flight(number, rng=None, share=0.0, effect=0.0, motor=2, **changed):
    """A flight of two axes whose errors have the size that its intervals say, and flights differ as assumed.

    The motor's share is larger by ``share``, and its effect by the factor 1 + ``effect``.
    """
    rng = rng or default_rng(number)
    is_weak_motor = np.eye(4)[motor]
    half_width = 0.01
    shares = (
        SHARES
        + share * is_weak_motor
        + half_width / Z90 * rng.normal(size=4)
        + SD_BETWEEN_FLIGHTS[SHARE] * rng.normal(size=4)
    )
    factors = (1 + effect * is_weak_motor) * np.exp(SD_BETWEEN_FLIGHTS[EFFECT] * rng.normal(size=4))
    rows = []
    for axis, scale in (("roll", 1.0), ("pitch", 0.8)):
        effects = (
            scale
            * EFFECTS
            * factors
            * np.exp(0.03 * rng.normal(size=4) + SD_BETWEEN_FLIGHTS[MEAN_EFFECT] * rng.normal())
        )
        rows.append(
            flight_row(
                "quad",
                number,
                axis,
                trim_share=tuple(shares / shares.mean()),
                trim_share_interval=(half_width,) * 4,
                effect=tuple(effects),
                effect_interval=tuple(Z90 * 0.03 * abs(effects)),
                damping=0.6
                + (0.2 / Z90) * rng.normal()
                + SD_BETWEEN_FLIGHTS["damping"] * rng.normal(),
                lag=0.04 + (0.01 / Z90) * rng.normal() + SD_BETWEEN_FLIGHTS["lag"] * rng.normal(),
                **(margins(rng.spawn(1)[0]) | changed),
            )
        )
    return rows


def margins(rng):
    """Figures of loops of 34°, 8 dB and Ms 2, which err and differ between flights as assumed."""
    values = {
        PHASE_MARGIN: 0.6,
        GAIN_MARGIN: 8.0,
        MAX_SENSITIVITY: 2.0,
        ATTITUDE_PHASE_MARGIN: 1.1,
        ATTITUDE_GAIN_MARGIN: 14.0,
        OVERSHOOT: 0.2,
        RISE: 0.05,
    }
    half_widths = {
        PHASE_MARGIN: 0.1,
        GAIN_MARGIN: 1.0,
        ATTITUDE_PHASE_MARGIN: 0.1,
        ATTITUDE_GAIN_MARGIN: 1.0,
        MAX_SENSITIVITY: 0.2,
        OVERSHOOT: 0.03,
        RISE: 0.004,
    }
    columns = {}
    for kind, name in COLUMNS_OF_LOOPS.items():
        within = half_widths[kind] / Z90 * rng.normal()
        between = SD_BETWEEN_FLIGHTS[kind] * rng.normal()
        if kind in LOGARITHMIC_KINDS:
            between *= values[kind]
        columns[name] = values[kind] + within + between
        columns[f"{name}_interval"] = half_widths[kind]
    return columns


def state(numbers, seed=0, **changed):
    rng = default_rng(seed)
    return [row for number in numbers for row in flight(number, rng, **changed)]


@mark.in_full
def test_of_many_pairs_of_flights_of_the_same_vehicle_few_have_any_change():
    rng = default_rng(4)
    pairs = 150
    changed = sum(
        bool(
            vehicle_difference(flight(0, rng), flight(1, rng)).changes_with(QuantityOutcome.CHANGED)
        )
        for _ in range(pairs)
    )
    # Twice the family's error would be beyond chance in 150 pairs.
    assert changed <= pairs * SIGNIFICANCE * 2


def test_a_phase_margin_that_fell_far_is_a_change_in_spite_of_wide_intervals():
    """From 56° ± 22° to 13° ± 8°: certain by itself, whatever else is tested with it."""
    before, after = (
        flight(
            number, phase_margin=np.radians(margin), phase_margin_interval=np.radians(half_width)
        )
        for number, margin, half_width in ((0, 56.0, 22.0), (1, 13.0, 8.0))
    )
    changes = vehicle_difference(before, after).changes
    (follows_from_gains,) = (
        change for change in changes if change.quantity == Quantity(PHASE_MARGIN, axis="roll")
    )
    assert (
        follows_from_gains.p <= SIGNIFICANCE
        and follows_from_gains.outcome is not QuantityOutcome.SAME
    )
    assert np.degrees(follows_from_gains.difference) == approx(-43.0, abs=0.1)


@mark.in_full
def test_false_discoveries_are_as_rare_as_stated():
    """Of 20 quantities 5 changed by 4 standard deviations.

    Over 400 trials, few of those that are called changed did not change.
    """
    rng = default_rng(8)
    false_shares = []
    difference = 0
    for _ in range(400):
        sizes = np.where(np.arange(20) < 5, 4.0, 0.0)
        scores = sizes + rng.normal(size=20)
        p_values = 2 * norm.sf(abs(scores))
        changes = [
            QuantityChange(Quantity(SHARE, motor), 0.0, 0.0, 1.0, 1.0, p_value, 0)
            for motor, p_value in enumerate(p_values.tolist())
        ]
        changed_motors = {
            change.quantity.motor
            for change in with_outcomes(changes)
            if change.outcome is QuantityOutcome.CHANGED
        }
        false_shares.append(
            len([motor for motor in changed_motors if motor >= 5]) / max(len(changed_motors), 1)
        )
        difference += len([motor for motor in changed_motors if motor < 5])
    assert np.mean(false_shares) < SIGNIFICANCE
    assert difference / (400 * 5) > 0.9


def test_many_loops_that_did_not_change_do_not_hide_one_motor():
    """A motor is tested among the motors. That a loop with other gains differs is known and not tested."""
    p_values = {Quantity(SHARE, motor): 0.8 for motor in range(1, 4)}
    p_values[Quantity(SHARE, 4)] = 0.004
    for kind in LOOP_KINDS:
        p_values |= {Quantity(kind, axis=axis): 0.5 for axis in ("roll", "pitch", "yaw")}
    doubtful_loop = Quantity(RISE, axis="roll")
    p_values[doubtful_loop] = 0.08
    changes = [
        QuantityChange(quantity, 0.0, 0.0, -0.3, 0.2 if p < 0.1 else 1.0, p, 0.0)
        for quantity, p in p_values.items()
    ]
    for axes, changed in (((), set()), (("roll",), {doubtful_loop})):
        difference = {
            change.quantity
            for change in with_outcomes(changes, axes)
            if change.outcome is QuantityOutcome.CHANGED
        }
        assert difference == {Quantity(SHARE, 4)} | changed


def test_limits_and_gains_of_the_attitude_change_no_rate_loop():
    """The names of changed parameters decide which loops have other gains: the rate loops, or attitude loops only."""
    names = ["MC_ROLL_P", "ATC_ANG_PIT_P", "MC_PITCHRATE_D"]
    changes = [ParameterChange(name, 1.0, 2.0) for name in names]
    assert axes_with_other_gains(changes[:2]) == ()
    assert axes_with_other_gains(changes) == ("pitch",)
    assert axes_with_other_attitude_gains(changes) == ("roll", "pitch")
    fell = {"attitude_gain_margin": 5.0, "attitude_gain_margin_interval": 0.5}
    pairs = [(changes[:1], {"roll"}), ((), set())]
    for parameters, axes in pairs:
        difference = vehicle_difference(flight(0), flight(1, **fell), parameters)
        follows_from_gains = {
            change.quantity.axis: difference.follows_from_gains(change)
            for change in difference.changes_with(QuantityOutcome.CHANGED)
            if change.quantity.kind == ATTITUDE_GAIN_MARGIN
        }
        assert follows_from_gains == {axis: axis in axes for axis in ("roll", "pitch")}
    limits = [
        "MC_ROLLRATE_MAX",
        "MC_YAWRAUTO_MAX",
        "ATC_RAT_RLL_IMAX",
        "ATC_RAT_YAW_SMAX",
        "RATE_RLL_IMAX",
    ]
    assert axes_with_other_gains(ParameterChange(name, 1.0, 2.0) for name in limits) == ()
    of_one_axis = ["ATC_RAT_YAW_FLTE", "RATE_YAW_I", "MC_YAWRATE_FF", "ATC_RAT_YAW_NEF"]
    for name in of_one_axis:
        assert axes_with_other_gains([ParameterChange(name, 1.0, 2.0)]) == ("yaw",)
    filters = [ParameterChange("INS_GYRO_FILTER", 20.0, 30.0)]
    assert axes_with_other_gains(filters) == ("roll", "pitch", "yaw")


@mark.slow
def test_what_changes_all_motors_changes_their_mean_and_none_beside_the_others():
    """All motors lose half of their effect: the mean effect changed, and no motor relative to the others."""
    before = state(range(8))
    after = state(range(8, 16), 1)
    weaker = [replace(row, effect=tuple(0.5 * value for value in row.effect)) for row in after]
    kinds = {
        change.quantity.kind
        for change in vehicle_difference(before, weaker).changes_with(QuantityOutcome.CHANGED)
    }
    assert kinds == {MEAN_EFFECT}


def test_a_difference_of_several_flights_and_its_chance_are_those_by_hand():
    """The damping of two flights is compared with that of one, and the result with the formula."""
    half_width = 0.1 * coverage_factor()
    before, after = (
        [
            flight_row("quad", number, damping=damping, damping_interval=half_width)
            for number, damping in common_columns
        ]
        for common_columns in ([(0, 0.5), (1, 0.7)], [(2, 1.0)])
    )
    (change,) = (
        one for one in vehicle_difference(before, after).changes if one.quantity.kind == DAMPING
    )
    assert change.quantity == (DAMPING, 0, "roll")
    assert (change.before, change.after) == approx((0.6, 1.0))
    # The variance is (8 · 0.2² + 0.02 - 0.01) / 9 between flights, and 0.1² within each.
    between = 0.33 / 9
    variance = 1.5 * (between + 0.01)
    freedom = variance**2 / ((1.5 * between) ** 2 / 9 + 0.015**2 / 20)
    assert change.half_width == approx(t.ppf(0.95, freedom) * variance**0.5)
    assert change.p == approx(2 * t.sf(0.4 / variance**0.5, freedom))


def test_the_same_is_said_only_where_the_whole_interval_is_small():
    """A quantity is "same" if its whole interval is below a limit, otherwise "uncertain"."""
    limits = {SHARE: 0.06, EFFECT: 0.2, MEAN_EFFECT: 0.2, DAMPING: 0.8, LAG: 0.02}
    for share, outcome in ((0.69, "same"), (0.71, "uncertain")):
        changes = []
        for kind, limit in limits.items():
            if kind in LOGARITHMIC_KINDS:
                # The limit of a ratio is one of percent: 20 % more, and not what has the logarithm 0.2.
                limit = np.log1p(limit)
            difference, half_width = -0.3 * limit, share * limit
            changes.append(
                QuantityChange(Quantity(kind), 0.0, 0.0, difference, half_width, 1.0, 0.0)
            )
        assert {change.outcome for change in with_outcomes(changes)} == {outcome}


def test_the_verdict_does_not_depend_on_which_state_is_the_first():
    """The interval of a ratio and its p-value are of one statistic, the logarithm."""
    states = (state([0]), state([1], share=0.1, effect=-0.2, motor=2))
    forward = vehicle_difference(*states).changes
    backward = vehicle_difference(*reversed(states)).changes
    ratios = 0
    for there, back in zip(forward, backward, strict=True):
        assert there.quantity == back.quantity
        assert there.p == approx(back.p) and there.outcome == back.outcome
        assert there.interval_contains_zero == back.interval_contains_zero == (there.p >= 0.1)
        low, high = there.interval
        assert (low <= 0 <= high) == there.interval_contains_zero
        if there.quantity.kind in LOGARITHMIC_KINDS:
            ratios += 1
            assert back.interval == approx((1 / (1 + high) - 1, 1 / (1 + low) - 1))
    assert ratios


def allowances_of_effect(ratio):
    """Of the quantities that depend on the mean effect, where that changed by a factor."""
    return {
        MEAN_EFFECT: np.log(ratio),
        GAIN_MARGIN: 8.7 * np.log(ratio),
        PHASE_MARGIN: 0.7 * np.log(ratio),
        ATTITUDE_GAIN_MARGIN: 8.7 * np.log(ratio),
        ATTITUDE_PHASE_MARGIN: 0.7 * np.log(ratio),
        MAX_SENSITIVITY: 1.2 * np.log(ratio),
        OVERSHOOT: 0.4 * np.log(ratio),
        RISE: np.log(ratio),
    }


@mark.parametrize(
    "changed, allowances",
    [
        ({"lean_roll": 0.1, "lean_pitch": 0.0}, {SHARE: 0.05}),
        # A lean that is not known has no effect.
        ({"lean_roll": None, "lean_pitch": None}, {SHARE: 0.035 * 2**0.5}),
        ({"voltage_mean": 12.0}, allowances_of_effect(4 / 3)),
        ({"collective": 0.6}, allowances_of_effect(1.5)),
    ],
)
def test_other_conditions_widen_what_they_can_change(changed, allowances):
    """Lean, voltage and collective differ between the flights.

    Intervals of quantities that depend on them are wider.
    """
    common_columns = {"lean_roll": 0.2, "lean_pitch": 0.0, "voltage_mean": 16.0, "collective": 0.4}
    same = vehicle_difference(state([0], **common_columns), state([1], 1, **common_columns))
    other = vehicle_difference(
        state([0], **common_columns), state([1], 1, **(common_columns | changed))
    )
    for change, two in zip(same.changes, other.changes, strict=True):
        assert change.quantity == two.quantity
        allowance = allowances.get(change.quantity.kind, 0.0)
        if allowance:
            assert two.half_width > change.half_width
        else:
            assert two.half_width <= change.half_width
        assert two.allowance == approx(allowance)
    assert not other.changes_with(QuantityOutcome.CHANGED)


NO_MODEL = dict.fromkeys(
    f"{name}{end}" for name in ("effect", "damping", "lag") for end in ("", "_status")
)
BY_DEMAND = {"inputs": "demand", "input_unit": "", "effect": (20.0,), "effect_interval": (1.0,)}


@mark.parametrize(
    "changed, kinds, quantity, reason",
    [
        (
            {"effect_status": "biased"},
            {SHARE, DAMPING, LAG, *LOOP_KINDS},
            EFFECT,
            Incomparable.NOT_REPORTED,
        ),
        ({"tier": "c", **NO_MODEL}, {SHARE, *LOOP_KINDS}, EFFECT, Incomparable.NOT_ESTIMATED),
        ({"trim_share": None}, {*SD_BETWEEN_FLIGHTS} - {SHARE}, SHARE, Incomparable.NOT_ESTIMATED),
        (BY_DEMAND, {SHARE, *LOOP_KINDS}, ComparedSubject.OF_MODELS, Incomparable.OTHER_INPUTS),
        (
            {"motors": tuple("123456"), "trim_share": None, "effect": None},
            set(),
            ComparedSubject.EVERYTHING,
            Incomparable.OTHER_VEHICLES,
        ),
        ({"trim_unit": "%"}, set(), ComparedSubject.EVERYTHING, Incomparable.OTHER_UNITS),
        ({"status": "It is empty."}, set(), ComparedSubject.EVERYTHING, Incomparable.NO_FLIGHT),
    ],
)
def test_what_is_not_known_in_both_is_not_compared_and_the_reason_is_said(
    changed, kinds, quantity, reason
):
    """One state lacks a quantity, has other inputs or units, or is another vehicle."""
    common_columns = {
        "frame": "QUADROTOR",
        "trim_unit": "µs",
        "inputs": "motors",
        "input_unit": "µs",
    }
    before = [replace(row, **common_columns) for row in flight(0)]
    after = [replace(row, **(common_columns | changed)) for row in flight(1)]
    difference = vehicle_difference(before, after)
    assert {change.quantity.kind for change in difference.changes} == kinds
    reason_by_quantity = {
        fact.figures.get("name", fact.code): reason for fact, reason in difference.incomparable
    }
    inner = reason_by_quantity[quantity].figures.get("reasons", (reason_by_quantity[quantity],))
    assert [fact.code for fact in inner] == [reason]
    sides = {"a": None, "b": None}
    values = {
        "a": "A",
        "b": "B",
        "parameters": [],
        "headlines": sides,
        "motor_health": sides,
        "common_files": [],
    }
    document = complete_document("diff", Diff.from_results(difference, **values))
    assert json.loads(json.dumps(document, allow_nan=False)) == document


def test_parameters_that_somebody_set_are_told_and_those_of_control_first():
    before = {
        "ANGLE_MAX": 3000.0,
        "ATC_RAT_RLL_P": 0.135,
        "MIS_TOTAL": 1.0,
        "INS_GYROFFS_X": 0.1,
    }
    after = {"ANGLE_MAX": 4500.0, "ATC_RAT_RLL_P": 0.2, "MIS_TOTAL": 2.0, "INS_GYROFFS_X": 0.2}
    changes = changed_parameters(before, after | {"ANGLE_NEW": 1.0})
    assert changes == [("ATC_RAT_RLL_P", 0.135, 0.2), ("ANGLE_MAX", 3000.0, 4500.0)]
    assert set(compared_parameters(before, after)) == {"ANGLE_MAX", "ATC_RAT_RLL_P"}
    set_by_autopilot = [("INS_GYROFFS_X", 0.1, 0.2), ("MIS_TOTAL", 1.0, 2.0)]
    assert parameters_changed_by_autopilot(before, after) == set_by_autopilot
    assert states_without_gains(before, {"MIS_TOTAL": 1.0}) == ("B",)


def test_what_a_person_calibrated_is_told_from_what_the_autopilot_learns():
    """Offsets of a compass alone may have been learned in flight; its scale is set by a calibration only."""
    certain = ["INS_ACC2SCAL_X", "AHRS_TRIM_Y", "COMPASS_DIA2_X", "COMPASS_OFS_X", "RC8_MAX"]
    autopilot = ["INS_GYROFFS_X", "INS_GYR1_CALTEMP", "STAT_BOOTCNT", "BARO1_GND_PRESS"]

    def changes(names):
        """Returns changes of these parameters, all of which the autopilot or a calibration sets."""
        before = dict.fromkeys(names, 0.0)
        assert not changed_parameters(before, dict.fromkeys(names, 1.0))
        return calibration_changes(
            parameters_changed_by_autopilot(before, dict.fromkeys(names, 1.0))
        )

    calibrated = ("accelerometers", "level", "compass", "radio")
    assert changes([*certain, *autopilot]) == (calibrated, len(certain), (), 0, len(autopilot))
    assert changes(["COMPASS_OFS2_Z"]) == ((), 0, ("compass",), 1, 0)
    px4 = [
        "CAL_ACC0_XSCALE",
        "CAL_ACC0_XOFF",
        "SENS_BOARD_X_OFF",
        "CAL_MAG1_XOFF",
        "CAL_GYRO0_XOFF",
    ]
    assert changes(px4) == (("accelerometers", "level"), 3, ("gyros", "compass"), 2, 0)


def test_the_document_states_where_the_steps_of_each_axis_come_from():
    before = flight(0, rate_step_source="measured")
    after = [replace(row, rate_step_source="identified_loop") for row in flight(1)]
    conditions = vehicle_difference(before, after).conditions
    axis = before[0].axis
    assert [state.step_sources[axis] for state in conditions] == [
        ("measured",),
        ("identified_loop",),
    ]


@mark.parametrize(("ends", "voltage"), [((12.6, 12.6), None), ((12.7, 12.5), 12.6)])
def test_flights_are_not_compared_by_a_voltage_that_nothing_measures(ends, voltage):
    start, end = ends
    row = flight_row("roll", 1, voltage_start=start, voltage_end=end, voltage_mean=12.6)
    assert mean_conditions([[row]]).voltage == voltage


def test_a_detectable_change_of_a_ratio_is_no_logarithm():
    """A ratio is tested by its logarithm; the change that is found from is the increase that a reader sees."""
    estimates = [Estimate(0.0, 0.3)]
    ratio = quantity_change(Quantity(SHARE, motor=1), estimates, estimates, allowance=0.0)
    logarithm = ratio._replace(quantity=Quantity(PHASE_MARGIN, axis="roll"))
    tested = logarithm.detectable_difference(SIGNIFICANCE)
    assert tested > 0.9
    assert ratio.detectable_difference(SIGNIFICANCE) == approx(expm1(tested))


@mark.in_full
def test_a_detectable_change_is_found_in_nine_of_ten_comparisons():
    """Simulated estimates with the assumed spread between flights, and four motors of which one changed."""
    rng = default_rng(11)
    sd = 0.02
    estimates = [Estimate(0.0, 0.01)]
    quantities = [Quantity(SHARE, motor) for motor in range(4)]
    changes = [quantity_change(quantity, estimates, estimates, 0.0) for quantity in quantities]
    significance = significance_of_single_change(changes, SHARE)
    assert significance == approx(SIGNIFICANCE / 4)
    true_change = changes[0].detectable_difference(significance)
    error_sd = changes[0].half_width / coverage_factor(freedom=changes[0].freedom)
    assert error_sd > sd
    found_count = 0
    for _ in range(1000):
        noise = rng.standard_t(changes[0].freedom, 4) * error_sd
        noise[0] += log1p(true_change)
        compared = []
        for change, log_ratio in zip(changes, noise.tolist(), strict=True):
            p = float(2 * scipy.special.stdtr(change.freedom, -abs(log_ratio) / error_sd))
            compared.append(change._replace(tested_difference=log_ratio, p=p))
        found_count += with_outcomes(compared)[0].outcome is QuantityOutcome.CHANGED
    assert 870 < found_count < 930
