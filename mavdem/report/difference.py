"""Sentences and tables on what changed between two states of a vehicle, A and B: its figures and its status lights."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from math import ceil, degrees, inf, log
from pathlib import PurePath
from types import MappingProxyType
from typing import Any, NamedTuple

from mavdem.containers import JsonValues, Names, group_by
from mavdem.dataset.axes import AXES
from mavdem.facts import Level
from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import motor_number
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.names import NO_NAMES
from mavdem.fleet.parameter_changes import ParameterChange, axes_of_parameter
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
)
from mavdem.fleet.random_effects import (
    EQUIVALENCE_LIMITS,
    SD_BETWEEN_FLIGHTS,
    QuantityChange,
    significance_of_single_change,
)
from mavdem.fleet.report_columns import value_at
from mavdem.fleet.row import UNKNOWN, FlightRow
from mavdem.ingest.vocabulary import RATE_PID_GAINS
from mavdem.motors.change_hypotheses import FAULT_RISE
from mavdem.report.blocks import Blocks, Rated, Sentence, Table, caution, shortened
from mavdem.report.fleet import ANOMALOUS_HEALTHS, short_name, vehicle_type
from mavdem.report.numbers import counted, listed, plus_minus, rounded, without_remark
from mavdem.report.templates import render_section, without_full_stop

Review = Mapping[str, Any]
"""The document of a review, as ``report.json`` has it; any of its keys may be missing."""

NO_REVIEWS: Mapping[str, Review] = MappingProxyType({})
"""No review documents, as of fleets."""

MIN_WHOLE_PERCENT = 3.0
"""Half width, %, from which on a relative change is shown without decimals, which would mean nothing: a choice."""


class ShownQuantity(NamedTuple):
    """How a kind of quantity is shown."""

    name: str
    """Name in a sentence."""

    scale: float
    """Factor from the compared unit to the shown one."""

    unit: str
    """Shown unit."""


SHOWN_QUANTITIES = {
    SHARE: ShownQuantity("relative trim", 100.0, "%"),
    EFFECT: ShownQuantity("control effectiveness", 100.0, "%"),
    MEAN_EFFECT: ShownQuantity("mean control effectiveness", 100.0, "%"),
    DAMPING: ShownQuantity("rate damping", 1.0, "1/s"),
    LAG: ShownQuantity("motor time constant", 1e3, "ms"),
    PHASE_MARGIN: ShownQuantity("phase margin", degrees(1.0), "°"),
    GAIN_MARGIN: ShownQuantity("gain margin", 1.0, "dB"),
    MAX_SENSITIVITY: ShownQuantity("Ms", 1.0, ""),
    ATTITUDE_PHASE_MARGIN: ShownQuantity("phase margin of the attitude", degrees(1.0), "°"),
    ATTITUDE_GAIN_MARGIN: ShownQuantity("gain margin of the attitude", 1.0, "dB"),
    OVERSHOOT: ShownQuantity("overshoot of the rate", 100.0, "%"),
    RISE: ShownQuantity("rise time of the rate", 1e3, "ms"),
}
"""How quantities are shown, by their kind."""

MOTOR_AT_START = re.compile(r"^[Mm]otor \d+ (\([^()]*\) )?")
"""The motor at the beginning of a sentence, with its place, such as "Motor 1 (front right) "."""

MAX_MOTOR_CHARACTERS = 32
"""Largest length of what a table says of a motor in one flight: two of them fit into 80 columns with the changes."""

WARNING_LEVELS = (Level.BAD, Level.WATCH)
"""Levels of a light that warns, the worse first."""

MAX_LIGHT_CHARACTERS = 60
"""Largest length of what a light of one flight says in the headline, without its details: a choice."""

MAX_HEADLINE_GAINS = 4
"""Largest number of changed gains that the headline names: a choice."""

MAX_HEADLINE_EFFECTS = 3
"""Largest number of figures of loops that the headline names with the gains: a choice."""


def headline_of_comparison(
    reviews: Mapping[str, Review],
    difference: VehicleDifference,
    parameters: Sequence[ParameterChange] = (),
) -> list[Sentence]:
    """Returns the sentences at the head of a comparison, on the terminal and on pages: the differences that matter.

    They come in this order; where A and B are the same flight, only that is said.

    1. Whether the states are of two vehicles.
    2. The lights (judgements of one subject each, such as the motors) that are bad on a side, and that of the motors
       where both sides warn of different motors, or one side does and the other does not. Figures of the motor that it
       names are its evidence, and no result of their own.
    3. Whether compared figures changed. One change is named: of a loop with a bad margin, or else the surest one.
    4. The changed gains of loops with a bad margin or a changed figure, or else all changed gains, and their effects.
       Where no figure changed that they do not explain, they come first.
    5. The other lights of the vehicle that are to be watched on one side, and good on the other.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; of a fleet, empty.
        difference: comparison of the two states.
        parameters: parameters of the autopilot that changed.

    Returns:
        The sentences with their leads.
    """
    if difference.is_of_same_flight:
        return render_section("difference_same_flight", flights=difference.flights.before)
    motors = _motor_verdict(reviews, difference)
    bad_lights = _bad_lights(reviews)
    light_sentences = _sentences_on_bad_lights(bad_lights)
    if not any(light.name == Light.MOTORS for light in bad_lights):
        light_sentences += _sentence_on_watched_motors(reviews)
    light_sentences = _with_evidence(light_sentences, motors, difference)
    bad_axes = {light.axis for light in bad_lights if light.name == Light.MARGINS}
    changes = _changes_by_relevance(difference, bad_axes, motors.evidence)
    changed_axes = {
        change.quantity.axis for change in changes if change.quantity.kind in LOOP_KINDS
    }
    gain_sentences = _sentences_on_gains(difference, changes, parameters, bad_axes | changed_axes)
    result = _result_sentences(
        difference,
        changes,
        motors,
        has_bad_light=bool(bad_lights),
        has_motor_difference=has_motor_difference(reviews),
    )
    sentences: list[Sentence] = []
    if _are_two_vehicles(difference):
        sentences += _identity_cautions(difference)
    sentences += light_sentences
    if _changes_by_cause(difference, changes).unexplained:
        sentences += [*result, *gain_sentences]
    else:
        # The result is then that no figure changed which the gains do not explain, so that it follows them.
        sentences += [*gain_sentences, *result]
    return [*sentences, *sentences_on_watched_lights(reviews)]


def _sentences_on_gains(
    difference: VehicleDifference,
    changes: Sequence[QuantityChange],
    parameters: Sequence[ParameterChange],
    relevant_axes: Collection[str],
) -> list[Sentence]:
    """Returns the sentence of the headline on changed gains, and on the changes of quantities that follow from them.

    Args:
        difference: comparison of the two states.
        changes: the changed quantities, the most relevant first.
        parameters: parameters of the autopilot that changed.
        relevant_axes: axes of loops with a bad margin or a changed quantity, whose gains are named; if none of these
            changed, all changed gains are.

    Returns:
        A list with one sentence; empty if no parameter changed.
    """
    gains = _changed_rate_gains(parameters, relevant_axes)
    if not gains:
        gains = _changed_rate_gains(parameters, ())
    shown_gains = [_parameter_text(gain) for gain in gains[:MAX_HEADLINE_GAINS]]
    axes_of_gains = {axis for gain in gains for axis in axes_of_parameter(gain.name)}
    effects = []
    for change in changes:
        if difference.follows_from_gains(change) and change.quantity.axis in axes_of_gains:
            effects.append(change_text(change, difference))
    return render_section(
        "difference_gains",
        gains=shown_gains,
        further_count=len(parameters) - len(shown_gains),
        effects=effects[:MAX_HEADLINE_EFFECTS],
        are_two_vehicles=_are_two_vehicles(difference),
    )


def difference_blocks(
    difference: VehicleDifference,
    parameters: Sequence[ParameterChange] = (),
    lacking: Names = (),
    headline: Sequence[Sentence] = (),
    reviews: Mapping[str, Review] = NO_REVIEWS,
) -> Blocks:
    """Returns sentences on the differences between two states of a vehicle, or two vehicles, with their certainty.

    They follow the headline, which says whether they are two vehicles. Doubts about a single one come first, then what
    changed and what could not be compared, parameters, and conditions. Where A and B are the same flight, there are
    none.

    Args:
        difference: comparison of the two states.
        parameters: parameters of the autopilot that changed.
        lacking: sides, "A" or "B", whose parameters are not known.
        headline: the sentences that head the comparison, which are shown above: what they name is not repeated.
        reviews: review documents of both logs, by side, "A" and "B".

    Returns:
        The sentences.
    """
    if difference.is_of_same_flight:
        return []
    missing_by_reason = group_by(difference.incomparable, lambda missing: missing.reason)
    not_compared = []
    for reason, missing_quantities in missing_by_reason.items():
        names = listed(missing.quantity for missing in missing_quantities)
        not_compared.append(Sentence(f"{names}: {reason}", "Not compared:"))
    conditions_and_method = render_section(
        "difference",
        difference,
        between=SD_BETWEEN_FLIGHTS,
        tested_count=len(difference.tested),
        families=difference.tested_families,
        are_two_vehicles=_are_two_vehicles(difference),
    )
    parameter_sentences = render_section(
        "difference_parameters",
        difference,
        parameters=[_parameter_text(parameter) for parameter in _gains_first(parameters)],
        lacking=lacking,
    )
    return [
        *(() if _are_two_vehicles(difference) else _identity_cautions(difference)),
        *_change_sentences(difference, _motor_verdict(reviews, difference), headline),
        *not_compared,
        *parameter_sentences,
        *conditions_and_method,
    ]


class _BadLight(NamedTuple):
    """A light that is bad on at least one side."""

    name: str
    """Name of the light, such as "margins"."""

    bad_sides: Names
    """Sides on which it is bad: "A", "B", or both."""

    axis: str
    """Axis that makes it bad; empty where it is none."""

    levels: str
    """Levels of both sides, such as "bad in A, good in B"."""

    reason: str
    """Sentence of the bad light; sentences of both lights where both are bad for different reasons."""


def _sentences_on_bad_lights(lights: Iterable[_BadLight]) -> list[Sentence]:
    """Returns one sentence for each status light that is bad: its levels in both logs, and the reason.

    One reason, such as a crash, may make several lights bad. It is written out for the first of them only, and the
    others refer to it.

    Args:
        lights: the bad lights, in the order of their sentences.
    """
    sentences = []
    stated_reasons = set[str]()
    for light in lights:
        if light.reason in stated_reasons:
            text = f"{light.levels}; bad for the reason above."
        else:
            text = f"{light.levels}. {light.reason}"
            stated_reasons.add(light.reason)
        sentences.append(Sentence(text, lead=f"{light.name.capitalize()}:"))
    return sentences


def _bad_lights(reviews: Mapping[str, Review]) -> list[_BadLight]:
    """Returns the status lights that are bad in at least one of the two compared logs.

    A status light is the judgement of one subject, such as the motors, with a level (good, watch, bad or unknown). A
    bad light matters more to the reader than a measured quantity that changed.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; one without lights, such as that of a fleet, is
            compared with nothing.

    Returns:
        The bad lights, in the order of the review of A.
    """
    bad_lights = []
    for name, lights_by_side in _lights_of_both(reviews).items():
        bad_sides = []
        for side, light in lights_by_side.items():
            if light["level"] == Level.BAD:
                bad_sides.append(side)
        if not bad_sides:
            continue
        first_bad_light = lights_by_side[bad_sides[0]]
        axis = value_at(first_bad_light, "figures.axis") or ""
        levels, reason = _levels_and_reason(lights_by_side)
        bad_lights.append(_BadLight(name, tuple(bad_sides), axis, levels, reason))
    return bad_lights


def has_motor_difference(reviews: Mapping[str, Review]) -> bool:
    """Returns whether the reviews of two logs judge the motors differently: with another level, or of another motor.

    The status lights of the motors are compared, and not the measured quantities, since what a motor lost during a
    flight is known of that flight alone. If neither light warns (one is good and the other unknown, for example), the
    motors count as equal.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; one without lights, such as that of a fleet, is
            compared with nothing.
    """
    motor_lights = _lights_of_both(reviews).get(Light.MOTORS)
    if motor_lights is None:
        return False
    first_light, second_light = motor_lights.values()
    warns = first_light["level"] in WARNING_LEVELS or second_light["level"] in WARNING_LEVELS
    return warns and not _are_equal(first_light, second_light)


class MotorVerdict(NamedTuple):
    """What is known of the motors beside the compared figures, which are then no verdicts of their own.

    The motors of a flight are judged by their balance, which is all trims together, after the part that lean makes.
    That test finds a weak motor where each trim alone is uncertain, and none where lean shifts a trim.
    """

    evidence: tuple[QuantityChange, ...] = ()
    """Changes of figures of a motor that is named as weak, as a weak motor makes them, sure or doubtful."""

    fault_probability: float | None = None
    """Probability of a weak motor in the later flight by the balance of all motors; None if it was not judged."""

    is_weak: bool = False
    """Whether the later flight differs by its motors from others of the vehicle."""

    def settles(self, change: QuantityChange) -> bool:
        """Returns whether the motors' own judgement takes the place of the result of a change that is doubtful."""
        if change in self.evidence:
            return True
        return change.quantity.kind == SHARE and self.fault_probability is not None


NO_VERDICT = MotorVerdict()
"""The motors were not judged, as of two vehicles."""


def _motor_verdict(reviews: Mapping[str, Review], difference: VehicleDifference) -> MotorVerdict:
    """Collects what a comparison of two logs knows of the motors: which are weak, and how probable a fault is.

    Weak motors are those of which one log's status light warns and the other's does not, or not of the same motor. If
    both warn of the same motor, its measured quantities show whether it became worse. The probability is that of the
    later log, from its comparison with other flights of the vehicle.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; of a fleet, empty.
        difference: comparison of the two states, quantity by quantity.
    """
    weak_motors = {}
    if has_motor_difference(reviews):
        for side, light in _lights_of_both(reviews)[Light.MOTORS].items():
            if light["level"] in WARNING_LEVELS:
                weak_motors[side] = motor_number(light.get("subject") or "")
    evidence = tuple(_evidence_of_weak_motors(difference, weak_motors))
    later_review = reviews.get(_later_side(reviews)) or {}
    motor_health = value_at(later_review, "motor_health") or {}
    return MotorVerdict(
        evidence,
        motor_health.get("fault_probability"),
        motor_health.get("health") in ANOMALOUS_HEALTHS,
    )


def _evidence_of_weak_motors(
    difference: VehicleDifference, weak_motors: Mapping[str, int | None]
) -> Iterator[QuantityChange]:
    """Yields the measured changes that agree with what is known already: that a motor is weak in one of two states.

    Args:
        difference: comparison of the two states, quantity by quantity.
        weak_motors: number of the weak motor by the name of the state, "A" or "B"; None for an unknown one.

    Yields:
        Changes of a weak motor's quantities, such as its trim, in the direction of the weakness.
    """
    first_side, second_side = STATE_NAMES
    for change in difference.changes:
        if not change.quantity.is_of_motor:
            continue
        is_significant = change.outcome is QuantityOutcome.CHANGED or _is_doubtful(change)
        weaker_side = second_side if _is_weaker(change) else first_side
        if is_significant and weak_motors.get(weaker_side) == change.quantity.motor:
            yield change


def _with_evidence(
    sentences: Sequence[Sentence], motors: MotorVerdict, difference: VehicleDifference
) -> list[Sentence]:
    """Adds the measured evidence for a weak motor to the sentence of the headline that names it.

    Args:
        sentences: sentences on status lights, such as that of the motors.
        motors: what is known of the motors, with the changes that are evidence.
        difference: comparison of the two states, with the names of the motors.

    Returns:
        The sentences; that of the motors ends with "This agrees with …" if there is evidence.
    """
    if not motors.evidence:
        return [*sentences]
    changes = listed(change_text(change, difference) for change in motors.evidence)
    lead_of_motors = f"{Light.MOTORS.capitalize()}:"
    extended_sentences = []
    for sentence in sentences:
        if sentence.lead == lead_of_motors:
            text = f"{sentence.text} This agrees with {changes}."
            sentence = Sentence(text, lead=lead_of_motors)
        extended_sentences.append(sentence)
    return extended_sentences


def _lights_of_both(reviews: Mapping[str, Review]) -> dict[str, dict[str, JsonValues]]:
    """Returns the lights that both logs have: by name the light of each side, "A" before "B", in the order of A.

    Args:
        reviews: review documents of both logs, by side; one without lights, as of a fleet, has none in common.
    """
    first_lights, second_lights = (
        reviews.get(side, {}).get("lights") or {} for side in STATE_NAMES
    )
    lights_of_both = {}
    for name, first_light in first_lights.items():
        if name in second_lights:
            pair = (first_light, second_lights[name])
            lights_of_both[name] = dict(zip(STATE_NAMES, pair, strict=True))
    return lights_of_both


def _levels_and_reason(lights_by_side: Mapping[str, JsonValues]) -> tuple[str, str]:
    """Returns two texts on a status light in both logs: its levels, and the reason for the worse one.

    Args:
        lights_by_side: the light in the review document of each log, by side, "A" and "B"; at least one is bad or to be
            watched.

    Returns:
        The levels, such as "bad in A, good in B", and the reason, such as "Motor 3 lost 19 to 41 % of its thrust at
        47 s.". If both lights have the same level for different reasons, both reasons are in the text.
    """
    first_side, second_side = STATE_NAMES
    first, second = lights_by_side[first_side], lights_by_side[second_side]
    if first["level"] != second["level"]:
        # The lights have different levels, and one of them is bad or "watch". The second is worse if it is bad, or if
        # it is to be watched and the first is good or unknown.
        second_is_worse = second["level"] == Level.BAD or first["level"] not in WARNING_LEVELS
        worse_light = second if second_is_worse else first
        levels = f"{first['level']} in {first_side}, {second['level']} in {second_side}"
        return levels, worse_light["sentence"] + _remark_on_imus(lights_by_side)
    levels = f"{first['level']} in {first_side} and {second_side}"
    if first["sentence"] == second["sentence"]:
        return levels, first["sentence"]
    first_motor = motor_number(first.get("subject") or "")
    second_motor = motor_number(second.get("subject") or "")
    are_of_motors = first_motor is not None and second_motor is not None
    if are_of_motors and first_motor != second_motor:
        levels += ", of different motors"
    reasons = f"{first_side}: {first['sentence']} {second_side}: {second['sentence']}"
    return levels, reasons + _remark_on_imus(lights_by_side)


def vibrations_of_same_imu(
    lights_by_side: Mapping[str, JsonValues],
) -> dict[str, tuple[float, float]]:
    """Returns the vibration of the same IMU in two logs, for each IMU that the status light of one of them names.

    The light on vibration names the IMU that vibrates most, which may be another one in each log. IMUs are mounted in
    different ways, so that a difference between two of them does not mean that the vehicle changed.

    Args:
        lights_by_side: the light on vibration in the review document of each log, by side, "A" and "B".

    Returns:
        By the name of the IMU, such as "IMU 2", its mean vibration in A and in B, m/s², along the axis that vibrates
        most. IMUs that were not recorded in both logs are left out.
    """
    first_levels, second_levels = (_vibration_by_imu(light) for light in lights_by_side.values())
    levels_of_both = {}
    for light in lights_by_side.values():
        imu = light.get("subject") or ""
        if imu in first_levels and imu in second_levels:
            levels_of_both[imu] = (first_levels[imu], second_levels[imu])
    return levels_of_both


def _vibration_by_imu(light: JsonValues) -> dict[str, float]:
    """Returns the mean vibration of each IMU of a log, m/s², by its name, such as "IMU 1".

    Args:
        light: the light on vibration in the review document of the log. Documents of earlier versions have only the
            vibration of the IMU that vibrates most.
    """
    figures = light.get("figures") or {}
    levels = {}
    if light.get("subject") and "vibration" in figures:
        levels[light["subject"]] = figures["vibration"]
    for number, level in enumerate(figures.get("imu_levels") or (), start=1):
        levels[f"IMU {number}"] = level
    return levels


def _remark_on_imus(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns a remark for the reader if a status light is about another IMU in each of two logs, as IMU 1 and IMU 3.

    Args:
        lights_by_side: the same light in the review document of each log, by side, "A" and "B".

    Returns:
        The remark with a space before it: the vibration of each of these IMUs in both logs or, if neither was recorded
        in both, that they are different sensors. Empty if both lights are about the same IMU, or about something else
        than an IMU.
    """
    first_subject, second_subject = (
        light.get("subject") or "" for light in lights_by_side.values()
    )
    are_imus = first_subject.startswith("IMU ") and second_subject.startswith("IMU ")
    if not are_imus or first_subject == second_subject:
        return ""
    comparisons = []
    for imu, (first_level, second_level) in vibrations_of_same_imu(lights_by_side).items():
        comparisons.append(f"{imu}: {rounded(first_level)} → {rounded(second_level)} m/s²")
    if not comparisons:
        sensors = f"{first_subject} and {second_subject}"
        return f" {sensors} are different sensors: their difference is no change."
    return f" {'; '.join(comparisons)}."


def _sentence_on_watched_motors(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns the headline's sentence on the motors where the two logs judge them differently.

    It is for motors whose status light is bad in neither log: bad lights have their own sentences.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; one without lights, such as that of a fleet, is
            compared with nothing.

    Returns:
        A list with one sentence; empty if the lights of the motors agree.
    """
    if not has_motor_difference(reviews):
        return []
    motor_lights = _lights_of_both(reviews)[Light.MOTORS]
    levels, reason = _levels_and_reason(motor_lights)
    return [Sentence(f"{levels}. {reason}", lead=f"{Light.MOTORS.capitalize()}:")]


def sentences_on_watched_lights(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns a sentence on each status light that has the level "watch" in one log and "good" in the other.

    Left out are the lights of the wind and of the log, which judge the day and the recording and not the vehicle, and
    that of the motors, which has its own sentence (:func:`_sentence_on_watched_motors`).

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; one without lights, such as that of a fleet, is
            compared with nothing.
    """
    sentences = []
    for name, lights_by_side in _lights_of_both(reviews).items():
        if name in (Light.MOTORS, Light.WIND, Light.LOG):
            continue
        levels = {light["level"] for light in lights_by_side.values()}
        if levels != {Level.GOOD, Level.WATCH}:
            continue
        texts = []
        for side, light in lights_by_side.items():
            # The sentence of a light may begin with its name, which is the lead of the new sentence already.
            reason = light["sentence"].removeprefix(f"{name.capitalize()} ")
            short_reason = without_full_stop(shortened(reason, MAX_LIGHT_CHARACTERS))
            texts.append(f"{light['level']} in {side} ({short_reason})")
        text = f"{', '.join(texts)}.{_remark_on_imus(lights_by_side)}"
        sentences.append(Sentence(text, lead=f"{name.capitalize()}:"))
    return sentences


def _later_side(reviews: Mapping[str, Review]) -> str:
    """Returns which of the two compared logs, "A" or "B", was flown later.

    It is "B" unless both dates are known and A has the later one.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
    """
    first_side, second_side = STATE_NAMES
    dates = [value_at(reviews.get(side) or {}, "identity.date") for side in STATE_NAMES]
    if all(dates) and dates[0] > dates[1]:
        return first_side
    return second_side


def light_blocks(reviews: Mapping[str, Review]) -> Blocks:
    """Returns the status lights of two logs side by side: a table of those that differ, and a sentence on the others.

    A status light is the judgement of one subject by a review, such as the motors, with a level.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".

    Returns:
        The table, with a row for each differing light and a column with level and sentence for each side, and then the
        sentence. Empty if either log has no lights.
    """
    lights_by_side = {side: review.get("lights") or {} for side, review in reviews.items()}
    if not all(lights_by_side.values()):
        return []
    first_lights, second_lights = lights_by_side.values()
    rows = []
    # Lights that are equal on both sides are only named.
    equal_names_by_level = dict[str, list[str]]()
    for name, first_light in first_lights.items():
        second_light = second_lights.get(name)
        if second_light is not None and _are_equal(first_light, second_light):
            equal_names_by_level.setdefault(first_light["level"], []).append(name)
        else:
            rows.append([name, _light_cell(first_light), _light_cell(second_light)])
    blocks: Blocks = []
    if rows:
        blocks.append(Table(["light", *reviews], rows, words=True))
    blocks += render_section("difference_lights", names_by_level=equal_names_by_level)
    return blocks


def motor_table(reviews: Mapping[str, Review], difference: VehicleDifference) -> Blocks:
    """Returns a table that compares the motors of two flights one by one, for a page or the terminal.

    Each row has the name of the motor, then for each flight the worst warning of its review about this motor, such as a
    loss of thrust, and then the changes of the motor's relative trim and control effectiveness from A to B, with their
    90 % intervals.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; of a fleet, empty.
        difference: comparison of the two states.

    Returns:
        A list with the table; empty if neither flight has a warning about a single motor, since the changes alone are
        shown elsewhere.
    """
    warnings_by_side = {side: _motor_warnings(reviews.get(side, {})) for side in STATE_NAMES}
    if not any(warnings_by_side.values()):
        return []
    motors = set[int]()
    for side, warnings in warnings_by_side.items():
        motors.update(warnings)
        if warnings:
            # All motors of a flight with a warning are listed, so that the sound ones can be compared.
            hover_motors = value_at(reviews[side], "condition.hover.motors") or ()
            motors.update(range(1, len(hover_motors) + 1))
    changes_by_kind: dict[str, dict[int, QuantityChange]] = {SHARE: {}, EFFECT: {}}
    for change in difference.changes:
        if change.quantity.is_of_motor:
            motors.add(change.quantity.motor)
            changes_by_kind[change.quantity.kind][change.quantity.motor] = change
    # A quantity that was compared for no motor gets no column.
    shown_kinds = [kind for kind, changes in changes_by_kind.items() if changes]
    rows = []
    for motor in sorted(motors):
        row = [f"motor {motor}"]
        for side in STATE_NAMES:
            row.append(_motor_cell(reviews[side], warnings_by_side[side].get(motor)))
        for kind in shown_kinds:
            change_of_motor = changes_by_kind[kind].get(motor)
            row.append("" if change_of_motor is None else _change_with_interval(change_of_motor))
        rows.append(row)
    titles = [SHOWN_QUANTITIES[kind].name for kind in shown_kinds]
    return [Table(["", *STATE_NAMES, *titles], rows, words=True)]


def _motor_warnings(review: Review) -> dict[int, JsonValues]:
    """Returns the worst warning of a log's review about each motor, for a table that compares the motors of two logs.

    Warnings are the status light of the motors and the events of the flight. Of equally bad ones the light is taken, or
    else the first event.

    Args:
        review: review document of a log; empty for a fleet.

    Returns:
        The warnings by the number of the motor, from 1 on, as the JSON document has them, with keys such as "level",
        "subject" and "sentence". Motors without a warning are left out.
    """
    motor_light = value_at(review, f"lights.{Light.MOTORS}")
    findings = [] if motor_light is None else [motor_light]
    findings += review.get("events", ())
    warnings: dict[int, JsonValues] = {}
    # The worst level comes first, so that a later and milder warning does not replace the one that is there.
    for level in WARNING_LEVELS:
        for finding in findings:
            motor = motor_number(finding.get("subject") or "")
            if motor is not None and finding["level"] == level:
                warnings.setdefault(motor, finding)
    return warnings


def _motor_cell(review: Review, warning: JsonValues | None) -> str:
    """Returns the table cell of one motor in one flight: its warning in few words, or that it has none.

    Args:
        review: review document of the log; empty for a fleet.
        warning: the worst warning about the motor (:func:`_motor_warnings`); None without one.

    Returns:
        The text, with the level of the warning for its colour. Without a warning it says so, or that the motors were
        not judged.
    """
    if warning is None:
        motors_level = value_at(review, f"lights.{Light.MOTORS}.level") or Level.UNKNOWN
        [sentence] = render_section(
            "difference_motor", is_known=Level(motors_level) is not Level.UNKNOWN, loss=None
        )
        return sentence.text
    # The row has the name of the motor already.
    sentence_without_motor = MOTOR_AT_START.sub("", warning["sentence"])
    [sentence] = render_section(
        "difference_motor",
        is_known=True,
        loss=value_at(warning, "figures.loss"),
        time=warning.get("time"),
        sentence=sentence_without_motor,
    )
    text = without_full_stop(shortened(sentence.text, MAX_MOTOR_CHARACTERS))
    return Rated(text, Level(warning["level"]))


def _are_equal(first_light: JsonValues, second_light: JsonValues) -> bool:
    """Returns whether a status light means the same in two logs: the same level and, if it warns, the same reason.

    The reason is the same if the code of the finding is, and the motor, IMU or axis that it is about. Its numbers, such
    as the thrust that was lost, may differ. Margins that are good must be of the same axes.

    Args:
        first_light, second_light: the same light in the review documents of both logs.
    """
    if first_light["level"] != second_light["level"]:
        return False
    if first_light["level"] not in WARNING_LEVELS:
        # Margins that are good on one axis only are not those of three axes.
        axes_of_margins = [_axes_of_margins(light) for light in (first_light, second_light)]
        return axes_of_margins[0] == axes_of_margins[1]
    keys = ("code", "subject", "figures.axis")
    return all(value_at(first_light, key) == value_at(second_light, key) for key in keys)


def _axes_of_margins(light: JsonValues) -> frozenset[str]:
    """Returns the axes of which a status light states the margins of the loops; none for another light."""
    if light.get("code") != MarginsLight.LOOP_MARGINS:
        return frozenset()
    return frozenset(value_at(light, "figures.names") or ())


def _light_cell(light: JsonValues | None) -> Rated | str:
    """Returns the cell of a light in a table: its level and its sentence; empty if a log does not have the light."""
    if light is None:
        return ""
    return Rated(light["level"], Level(light["level"]), light["sentence"])


def headline_blocks(
    headlines: Mapping[str, str | None], comparison_headline: Sequence[Sentence] = ()
) -> Blocks:
    """Returns the headline of each log's own review, as a sentence that begins "A by itself:" or "B by itself:".

    Args:
        headlines: headline of the review of each log, by side, "A" and "B"; None for a side without one.
        comparison_headline: the sentences above, which head the comparison of both logs.

    Returns:
        A sentence for each side whose headline the comparison does not contain already.
    """
    blocks = Blocks()
    for side, headline in headlines.items():
        is_stated = any(headline and headline in above.text for above in comparison_headline)
        if headline and not is_stated:
            blocks.append(Sentence(headline, lead=f"{side} by itself:"))
    return blocks


def baseline_blocks(
    latest_row: FlightRow, difference: VehicleDifference, *, has_identity_cautions: bool = True
) -> Blocks:
    """Returns the report on how a vehicle's latest flight differs from its baseline, the earlier healthy flights.

    Args:
        latest_row: row of the latest flight in the fleet's table; its date and file name are printed.
        difference: comparison of that flight with the baseline.
        has_identity_cautions: whether the reader is warned if the flights may be of several vehicles of the same name.

    Returns:
        Sentences: which flights are compared, whether anything changed, what changed, and cautions.
    """
    file = PurePath(latest_row.file).name
    date = "" if latest_row.date is None else f" ({latest_row.date:%Y-%m-%d})"
    baseline_count = counted(difference.flights.before, "flight")
    compared_flights = f"the latest flight, {file}{date}, compared with {baseline_count}."
    blocks: Blocks = [Sentence(compared_flights, lead="Since the baseline:")]
    _, latest_side = STATE_NAMES
    is_weak = latest_row.health in ANOMALOUS_HEALTHS
    weak_motors = {latest_side: latest_row.suspect_motor} if is_weak else {}
    evidence = tuple(_evidence_of_weak_motors(difference, weak_motors))
    motors = MotorVerdict(evidence, latest_row.fault_probability, is_weak)
    if is_weak and latest_row.health_reason:
        sentence = Sentence(latest_row.health_reason, lead=f"{Light.MOTORS.capitalize()}:")
        blocks += _with_evidence([sentence], motors, difference)
    changes = _changes_by_relevance(difference, without=evidence)
    blocks += _result_sentences(difference, changes, motors, has_motor_difference=is_weak)
    blocks += _change_sentences(difference, motors)
    if has_identity_cautions:
        blocks += _identity_cautions(difference)
    return blocks


def _changes_by_relevance(
    difference: VehicleDifference,
    axes: Collection[str] = (),
    without: Collection[QuantityChange] = (),
) -> list[QuantityChange]:
    """Returns the quantities that changed, the most relevant first, for the headline and lists of a comparison.

    First come the quantities of the control loops of some axes, then all others; within both groups the change with the
    lowest p-value, which is the most certain, comes first.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.
        axes: axes whose stability margins are bad in one of the groups, so that changes of their loops matter most.
        without: changes that are left out.
    """
    changes_of_bad_loops = []
    other_changes = []
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    for change in sorted(changes, key=lambda change: change.p):
        if change in without:
            continue
        if change.quantity.kind in LOOP_KINDS and change.quantity.axis in axes:
            changes_of_bad_loops.append(change)
        else:
            other_changes.append(change)
    return [*changes_of_bad_loops, *other_changes]


class _ChangesByCause(NamedTuple):
    """Changed quantities, by whether the changed gains of their control loop explain them."""

    unexplained: list[QuantityChange]
    """Changes that may be signs of a fault."""

    by_gains: list[QuantityChange]
    """Changes of figures of a rate loop whose gains or filters are known to differ."""


def _changes_by_cause(
    difference: VehicleDifference, changes: Iterable[QuantityChange]
) -> _ChangesByCause:
    """Separates the changes that follow from new controller gains from those that may be signs of a fault.

    Args:
        difference: comparison of two groups of flights, which knows the changed gains.
        changes: changed quantities; their order is kept in both groups.
    """
    changes_by_cause = _ChangesByCause(unexplained=[], by_gains=[])
    for change in changes:
        if difference.follows_from_gains(change):
            changes_by_cause.by_gains.append(change)
        else:
            changes_by_cause.unexplained.append(change)
    return changes_by_cause


def _result_sentences(
    difference: VehicleDifference,
    changes: Sequence[QuantityChange],
    motors: MotorVerdict = NO_VERDICT,
    *,
    has_bad_light: bool = False,
    has_motor_difference: bool = False,
) -> list[Sentence]:
    """Returns one sentence with the result of a comparison: the change that matters most, or that nothing changed.

    The most certain of the doubtful changes is named after it or, if nothing changed for sure, in its place. A change
    is doubtful if the quantity's own interval excludes "no change", but the test of all quantities together does not
    confirm it.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.
        changes: the changed quantities, the most relevant first, without those that are evidence for a weak motor.
        motors: what is known of the motors; doubtful figures that it settles are not named.
        has_bad_light: whether a status light is bad in one of the logs; then the sentence must not say that nothing
            differs.
        has_motor_difference: whether the status lights of the motors differ; then the sentence may only say that
            nothing else differs.
    """
    unexplained_changes, changes_by_gains = _changes_by_cause(difference, changes)
    doubtful_changes = [
        change
        for change in difference.tested
        if _is_doubtful(change) and not motors.settles(change)
    ]
    doubtful_changes.sort(key=lambda change: change.p)
    # What the sentence names: the first of these, and how many there are besides.
    candidates = unexplained_changes or doubtful_changes
    main_change = candidates[0] if candidates else None
    doubtful_text = ""
    if unexplained_changes and doubtful_changes:
        doubtful_text = change_text(doubtful_changes[0], difference)
    outcomes = Counter(
        change.outcome for change in difference.changes if change not in motors.evidence
    )
    return render_section(
        "difference_conclusion",
        change="" if main_change is None else change_text(main_change, difference),
        further_count=len(candidates) - 1,
        is_doubtful=not unexplained_changes,
        doubtful=doubtful_text,
        p=None if main_change is None else main_change.p,
        tested_count=len(difference.tested),
        uncertain_count=outcomes[QuantityOutcome.UNCERTAIN],
        same_count=outcomes[QuantityOutcome.SAME],
        has_figures=bool(difference.changes),
        has_changes_by_gains=bool(changes_by_gains),
        has_bad_light=has_bad_light,
        has_motor_difference=has_motor_difference,
        are_two_vehicles=_are_two_vehicles(difference),
    )


def _is_doubtful(change: QuantityChange) -> bool:
    """Returns whether a quantity does not count as changed though its own interval does not contain "no change".

    That interval disregards how many quantities are tested.
    """
    return change.outcome is QuantityOutcome.UNCERTAIN and not change.interval_contains_zero


def _change_sentences(
    difference: VehicleDifference, motors: MotorVerdict, headline: Sequence[Sentence] = ()
) -> list[Sentence]:
    """Returns a sentence on all compared quantities with the same outcome, for each outcome that there is.

    In this order: the quantities that changed; those that changed by other gains; doubtful ones, whose own interval
    shows a change that the test of all quantities together does not confirm; uncertain ones, whose interval allows for
    a change as for none; and those that stayed the same.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.
        motors: what is known of the motors, whose evidence the sentence on them has.
        headline: sentences shown above; changes by gains that they name are left out.
    """
    doubtful = []
    uncertain = list[QuantityChange]()
    for change in difference.changes:
        if change in motors.evidence:
            continue
        if _is_doubtful(change):
            doubtful.append(change)
        elif change.outcome is QuantityOutcome.UNCERTAIN:
            uncertain.append(change)
    unexplained_changes, by_gains = _changes_by_cause(
        difference, _changes_by_relevance(difference, without=motors.evidence)
    )
    # The headline names the first change, so that a single one is not repeated.
    listed_changes = unexplained_changes if len(unexplained_changes) > 1 else []
    tested_changes = difference.tested
    surest_change = min(
        (change for change in doubtful if change in tested_changes),
        key=lambda change: change.p,
        default=None,
    )
    are_trims_doubtful = any(change.quantity.kind == SHARE for change in doubtful)
    texts_above = " ".join(sentence.text for sentence in headline)
    texts_by_gains = [change_text(change, difference) for change in by_gains]
    sentences = render_section(
        "difference_changes",
        changed=[change_text(change, difference) for change in listed_changes],
        by_gains=[text for text in texts_by_gains if text not in texts_above],
        is_more=any(text in texts_above for text in texts_by_gains),
        axes=[
            axis
            for axis in AXES
            if axis in difference.axes_with_other_gains
            or axis in difference.axes_with_other_attitude_gains
        ],
        doubtful=[change_text(change, difference) for change in doubtful],
        # Probability of a weak motor by all trims together, where they show none and a single one is doubtful.
        fault_rise=FAULT_RISE,
        fault_probability=motors.fault_probability
        if are_trims_doubtful and not motors.is_weak
        else None,
        uncertain=[*_texts_of_equal_changes(uncertain, difference)],
        are_two_vehicles=_are_two_vehicles(difference),
        has_trims=any(change.quantity.kind == SHARE for change in difference.changes),
        tested_count=len(tested_changes),
        surest_p=None if surest_change is None else surest_change.p,
        # Probability that at least one of so many independent figures has such a p-value by chance.
        chance_of_any=None
        if surest_change is None
        else 1 - (1 - surest_change.p) ** len(tested_changes),
    )
    return [*sentences, *same_sentences(difference.changes_with(QuantityOutcome.SAME))]


def bound_sentences(difference: VehicleDifference) -> list[Sentence]:
    """Returns the sentence that says, where no change was found, how large a change may have been missed.

    It has two numbers for each kind of quantity: the largest change that its intervals still contain, and the change
    that nine of ten such comparisons would find.

    Args:
        difference: comparison of two states, quantity by quantity.

    Returns:
        A list with the sentence; empty if a tested quantity changed or is doubtful, or if both states are the same
        flight.
    """
    if difference.is_of_same_flight:
        return []
    tested_changes = difference.tested
    for change in tested_changes:
        if change.outcome is QuantityOutcome.CHANGED or _is_doubtful(change):
            return []
    changes_by_kind = group_by(tested_changes, lambda change: change.quantity.kind)
    bounds = []
    for kind, changes in changes_by_kind.items():
        significance = significance_of_single_change(tested_changes, kind)
        bounds.append(_bound_text(kind, changes, significance))
    return render_section("difference_bounds", bounds=bounds)


def _bound_text(kind: str, changes: Sequence[QuantityChange], significance: float) -> str:
    """Returns the text on quantities that did not change: their 90 % bounds, and the change that is detectable.

    Args:
        kind: kind of the quantities, such as ``DAMPING``.
        changes: changes of all quantities of this kind, at least one.
        significance: p-value below which one of them is called changed if it is the only one.

    Returns:
        Text such as "damping of roll within ±8 % and of pitch within ±9 % (found from 12 %)".
    """
    # Quantities with the same bound, as it is shown, are named together.
    changes_by_bound = group_by(
        changes, lambda change: _limit_text(kind, change.largest_difference)
    )
    bounds = []
    for bound, changes_with_bound in changes_by_bound.items():
        bounds.append(f"of {_names_of_quantities(changes_with_bound)} within ±{bound}")
    detectable = max(change.detectable_difference(significance) for change in changes)
    return (
        f"{SHOWN_QUANTITIES[kind].name} {listed(bounds)} "
        f"(found from {_limit_text(kind, detectable)})"
    )


def _names_of_quantities(changes: Sequence[QuantityChange]) -> str:
    """Returns the motors or axes of some quantities as text, such as "motor 1 and motor 2"."""
    names = []
    for change in changes:
        quantity = change.quantity
        names.append(f"motor {quantity.motor}" if quantity.is_of_motor else quantity.axis)
    return listed(names)


def _limit_text(kind: str, limit: float) -> str:
    """Returns an upper limit of a kind of quantity with its unit; whole percent, rounded up, from 3 % on."""
    percent = 100 * limit
    if kind in LOGARITHMIC_KINDS and percent >= MIN_WHOLE_PERCENT:
        return f"{ceil(percent)} %"
    return _amount_text(kind, limit)


def _amount_text(kind: str, amount: float) -> str:
    """Returns an amount of a kind of quantity with its unit, such as "2 %"; a logarithm is given as a ratio."""
    shown_form = SHOWN_QUANTITIES[kind]
    if kind in LOGARITHMIC_KINDS:
        return f"{rounded(100 * amount)} %"
    return f"{rounded(shown_form.scale * amount)} {shown_form.unit}".strip()


def equivalence_limit_text(kind: str) -> str:
    """Returns the largest difference of a kind of quantity that is called the same, with its unit, such as "6 %"."""
    return _amount_text(kind, EQUIVALENCE_LIMITS[kind])


def same_sentences(same: Sequence[QuantityChange]) -> list[Sentence]:
    """Returns the sentence on the quantities that stayed the same; none without any."""
    return render_section("difference_same", same=[*_texts_by_kind(same)])


def _texts_of_equal_changes(
    changes: Sequence[QuantityChange], difference: VehicleDifference
) -> Iterator[str]:
    """Yields the text of each change. Motors with the same change share one: "motor 1 and motor 2's effect −5 % ± 2 %".

    Args:
        changes: changes of quantities of motors or axes.
        difference: comparison of the vehicle, with the names of its motors.
    """
    motors_by_text = dict[str, list[str]]()
    for change in changes:
        text = change_text(change, difference)
        motors = []
        if change.quantity.is_of_motor:
            motor = _motor_name(change, difference)
            motors = [motor]
            # The name of the motor is put before the shared text again, with the names of the others.
            text = text.removeprefix(f"{motor}'s ")
        motors_by_text.setdefault(text, []).extend(motors)
    for text, motors in motors_by_text.items():
        yield f"{listed(motors)}'s {text}" if motors else text


def _changed_rate_gains(
    parameters: Sequence[ParameterChange], axes: Collection[str]
) -> list[ParameterChange]:
    """Returns the gains of the rate controllers that changed, the one with the largest factor of change first.

    Args:
        parameters: all parameters of the autopilot that changed.
        axes: only gains that act on one of these axes are returned; empty for those of all axes.
    """
    gains = []
    for parameter in parameters:
        is_of_axes = not axes or not set(axes).isdisjoint(axes_of_parameter(parameter.name))
        if RATE_PID_GAINS.match(parameter.name) and is_of_axes:
            gains.append(parameter)
    return sorted(gains, key=_log_factor, reverse=True)


def _log_factor(parameter: ParameterChange) -> float:
    """Returns the magnitude of the logarithm of the factor by which a parameter changed; infinite from or to 0."""
    if parameter.before == 0 or parameter.after == 0:
        return inf
    return abs(log(abs(parameter.after / parameter.before)))


def _parameter_text(parameter: ParameterChange) -> str:
    """Returns a changed parameter as text, such as "ATC_RAT_RLL_P 0.135 → 0.108"."""
    return f"{parameter.name} {parameter.before:.4g} → {parameter.after:.4g}"


def _gains_first(parameters: Sequence[ParameterChange]) -> list[ParameterChange]:
    """Returns the changed parameters with the gains of rate control before all others."""
    return sorted(parameters, key=lambda parameter: not RATE_PID_GAINS.match(parameter.name))


def next_blocks(
    difference: VehicleDifference, reviews: Mapping[str, Review] = NO_REVIEWS
) -> list[Sentence]:
    """Returns the next steps after a comparison.

    The first of these conditions that applies decides:

    1. A and B are the same flight: no step.
    2. A light is bad: the next step of that log's own review; for the earlier log, only if the later one does not show
       that its fault was mended.
    3. The states are of two vehicles: no step, since their differences are no faults.
    4. A light warns of a motor that the later log does not show to be mended: to inspect it.
    5. A quantity changed that new gains do not explain: to check the part that this points to.
    6. A change is doubtful: to inspect the motor that perhaps became weaker, if there is one that the judgement of all
       motors together does not exclude, and to fly again.
    7. Otherwise: no step.

    Args:
        difference: comparison of two states, quantity by quantity.
        reviews: review documents of both logs, by side, "A" and "B".

    Returns:
        A list with one sentence, two if both logs have a bad light, or an empty one.
    """
    if difference.is_of_same_flight:
        return []
    are_two_vehicles = len(_known_vehicles(difference)) > 1
    steps = _steps_of_bad_logs(reviews, are_two_vehicles=are_two_vehicles)
    if steps:
        return steps
    if are_two_vehicles:
        return []
    motor_steps = _step_of_watched_motor(reviews)
    if motor_steps:
        return motor_steps
    motors = _motor_verdict(reviews, difference)
    changes = _changes_by_relevance(difference, without=motors.evidence)
    unexplained_changes = _changes_by_cause(difference, changes).unexplained
    if unexplained_changes:
        return _what_to_check(unexplained_changes, difference)
    doubtful_changes = [
        change
        for change in difference.tested
        if _is_doubtful(change) and not motors.settles(change)
    ]
    if not doubtful_changes:
        return []
    weaker_motors = [change for change in doubtful_changes if _is_weaker(change)]
    surest_change = min(weaker_motors, key=lambda change: change.p, default=None)
    motor = "" if surest_change is None else _motor_name(surest_change, difference)
    return render_section("difference_doubt", motor=motor)


def _known_vehicles(difference: VehicleDifference) -> set[str]:
    """Returns the names of the vehicles of both states, without those that are not known."""
    names_before, names_after = difference.vehicles
    return {*names_before, *names_after} - {UNKNOWN}


def _steps_of_bad_logs(reviews: Mapping[str, Review], *, are_two_vehicles: bool) -> list[Sentence]:
    """Returns the next step that each log's own review advises, for the logs with a bad status light.

    The step of the log that was flown later comes first. That of the earlier log is left out if the later log of the
    same vehicle has settled all its bad lights: each is good there, or is bad for the same reason, for which the later
    log's own step stands.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
        are_two_vehicles: whether A and B are two vehicles, so that one does not show whether the other was mended.
    """
    later_side = _later_side(reviews)
    (earlier_side,) = set(STATE_NAMES) - {later_side}
    is_later_bad = False
    has_earlier_open_fault = False
    for light in _bad_lights(reviews):
        if later_side in light.bad_sides:
            is_later_bad = True
        earlier_light = reviews[earlier_side]["lights"][light.name]
        later_light = reviews[later_side]["lights"][light.name]
        is_settled = later_light["level"] == Level.GOOD or _are_equal(earlier_light, later_light)
        if earlier_side in light.bad_sides and (are_two_vehicles or not is_settled):
            has_earlier_open_fault = True
    sides = []
    if is_later_bad:
        sides.append(later_side)
    if has_earlier_open_fault:
        sides.append(earlier_side)
    steps: list[Sentence] = []
    for side in sides:
        next_step = value_at(reviews[side], "next_step.sentence")
        # Both logs may advise the same step.
        if next_step and next_step not in [step.text for step in steps]:
            steps.append(Sentence(next_step, lead=f"Next, by {side}:"))
    return steps


def _step_of_watched_motor(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns the step to inspect a motor that the reviews of two logs of one vehicle say is to be watched.

    A motor of the earlier log alone needs no step if the motors of the later one are good.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".

    Returns:
        A list with one sentence; empty if no motor is named.
    """
    if not has_motor_difference(reviews):
        return []
    later_side = _later_side(reviews)
    lights = _lights_of_both(reviews)[Light.MOTORS]
    for side, light in lights.items():
        is_mended = side != later_side and lights[later_side]["level"] == Level.GOOD
        number = motor_number(light.get("subject") or "")
        if light["level"] == Level.WATCH and number is not None and not is_mended:
            return render_section("difference_next", motor=f"motor {number}", is_weaker=True)
    return []


def _what_to_check(
    changes: Sequence[QuantityChange], difference: VehicleDifference
) -> list[Sentence]:
    """Returns the sentence that says which part to check after a change that new gains do not explain.

    A motor that became weaker comes before all other changes; of several candidates the most certain change, with the
    lowest p-value, is named.

    Args:
        changes: the changed quantities that new gains do not explain, at least one.
        difference: comparison of the vehicle, with the names of its motors.
    """
    weaker_motors = [change for change in changes if _is_weaker(change)]
    candidates = weaker_motors or changes
    surest_change = min(candidates, key=lambda change: change.p)
    motor = ""
    if surest_change.quantity.is_of_motor:
        motor = _motor_name(surest_change, difference)
    return render_section("difference_next", motor=motor, is_weaker=bool(weaker_motors))


def _is_weaker(change: QuantityChange) -> bool:
    """Returns whether a change means a weaker motor.

    A motor that became weaker either takes a larger share of the output to hold the vehicle level, or has less effect.

    Args:
        change: change of one quantity, such as a motor's share of the output.
    """
    if not change.quantity.is_of_motor:
        return False
    increases = change.difference > 0
    works_harder = change.quantity.kind == SHARE and increases
    has_less_effect = change.quantity.kind != SHARE and not increases
    return works_harder or has_less_effect


def _motor_name(change: QuantityChange, difference: VehicleDifference) -> str:
    """Returns the name of the motor of a change, without its position; its number where names are not known."""
    motor = change.quantity.motor
    if motor > len(difference.motors):
        return f"motor {motor}"
    return without_remark(difference.motors[motor - 1])


def change_text(change: QuantityChange, difference: VehicleDifference) -> str:
    """Returns a change as text, such as "motor 3's relative trim −18 % ± 6 %" or "Ms on roll 1.4 → 1.6 (+0.2 ± 0.1)".

    For shares and effects of motors only the change is shown, and for all other quantities both values before it. The
    change has the half width of its 90 % interval. Quantities that are compared as ratios change by percent.

    Args:
        change: change of one quantity between two states, with its interval.
        difference: comparison of the vehicle, with the names of its motors.
    """
    quantity = change.quantity
    shown_form = SHOWN_QUANTITIES[quantity.kind]
    if quantity.is_of_motor:
        name = f"{_motor_name(change, difference)}'s {shown_form.name}"
    else:
        name = f"{shown_form.name} on {quantity.axis}"
    change_with_interval = _change_with_interval(change)
    if quantity.kind in (SHARE, EFFECT, MEAN_EFFECT):
        return f"{name} {change_with_interval}"
    value_before = rounded(shown_form.scale * change.before)
    value_after = rounded(shown_form.scale * change.after)
    space = " " if shown_form.unit not in ("°", "") else ""
    return f"{name} {value_before} → {value_after}{space}{shown_form.unit} ({change_with_interval})"


def _change_with_interval(change: QuantityChange) -> str:
    """Returns a change with the half width of its 90 % interval, such as "−18 % ± 6 %" or "+1.2 ± 0.8", without unit.

    Args:
        change: change of one quantity; that of a quantity which is compared as a ratio is in percent.
    """
    if change.quantity.kind in LOGARITHMIC_KINDS:
        percent = 100 * change.half_width
        decimals = 0 if percent >= MIN_WHOLE_PERCENT else 1
        increase = _signed(f"{100 * change.difference:z.{decimals}f}")
        return f"{increase} % ± {percent:.{decimals}f} %"
    scale = SHOWN_QUANTITIES[change.quantity.kind].scale
    return _signed(plus_minus(scale * change.difference, scale * change.half_width))


def _texts_by_kind(changes: Sequence[QuantityChange]) -> Iterator[str]:
    """Yields a text for each kind of quantity, such as "relative trim of motor 1 and motor 2 (± 2 %)".

    The uncertainty is the widest half width of the 90 % intervals of one kind, so that the text holds for each of its
    quantities.

    Args:
        changes: changes of quantities that stayed the same within their uncertainty.
    """
    changes_by_kind = group_by(changes, lambda change: change.quantity.kind)
    for kind, changes_of_kind in changes_by_kind.items():
        widest_half_width = max(change.half_width for change in changes_of_kind)
        names = _names_of_quantities(changes_of_kind)
        uncertainty = _amount_text(kind, widest_half_width)
        yield f"{SHOWN_QUANTITIES[kind].name} of {names} (± {uncertainty})"


def _signed(number: str) -> str:
    """Returns a formatted number with its sign, a minus sign in the place of a hyphen."""
    if number.startswith(("-", "(-")):
        return number.replace("-", "−")
    return f"+{number}"


def _identity_cautions(difference: VehicleDifference) -> list[Sentence]:
    """Returns the warning that the compared flights may be of different vehicles; empty if they are of one vehicle.

    The reader is warned if a log does not name its vehicle, if the logs name two vehicles, or if the name is a MAVLink
    system id, which many vehicles share.

    Args:
        difference: comparison of a vehicle before and after, with the names of the vehicles in the logs of both.
    """
    names_before, names_after = difference.vehicles
    if UNKNOWN in (*names_before, *names_after):
        return [*render_section("difference_unnamed")]
    sentences = render_section(
        "difference_vehicles",
        before=_shown_names(names_before, difference.shared),
        after=_shown_names(names_after, difference.shared),
        are_two_vehicles=_are_two_vehicles(difference),
        shared_names=difference.shared,
    )
    return [caution(sentence.text) for sentence in sentences]


def _shown_names(names: Names, shared_names: Collection[str]) -> list[str]:
    """Returns names of vehicles as they are shown to the reader.

    Args:
        names: names of the vehicles in their logs.
        shared_names: those of the names that are MAVLink system ids, which several vehicles may have.

    Returns:
        For a system id what the vehicle is, such as "unnamed PX4 vehicle"; for a serial number its first and last
        characters; any other name as it is.
    """
    shown_names = []
    for name in names:
        if name in shared_names:
            shown_names.append(vehicle_type(name, "", NO_NAMES, is_shared=True))
        else:
            shown_names.append(short_name(name))
    return shown_names


def _are_two_vehicles(difference: VehicleDifference) -> bool:
    """Returns whether the states are known to be of two vehicles, so that differences need not be changes.

    Args:
        difference: comparison of two states, with the names of the vehicles of each.
    """
    names_before, names_after = difference.vehicles
    has_names = bool(names_before and names_after)
    is_known = has_names and UNKNOWN not in (*names_before, *names_after)
    return is_known and set(names_before) != set(names_after)
