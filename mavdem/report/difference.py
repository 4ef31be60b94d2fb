"""What changed between two states of a vehicle (before and after): its figures, and its status lights."""

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
from mavdem.report.blocks import Blocks, Rated, Sentence, Table, caution, shortened
from mavdem.report.fleet import short_name, vehicle_type
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
       where both sides warn of different motors, or one side does and the other does not.
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
    bad_lights = _bad_lights(reviews)
    light_sentences = _sentences_on_bad_lights(bad_lights)
    if not any(light.name == Light.MOTORS for light in bad_lights):
        light_sentences += _sentence_on_watched_motors(reviews)
    bad_axes = {light.axis for light in bad_lights if light.name == Light.MARGINS}
    changes = _changes_by_relevance(difference, bad_axes)
    changed_axes = {
        change.quantity.axis for change in changes if change.quantity.kind in LOOP_KINDS
    }
    gain_sentences = _sentences_on_gains(difference, changes, parameters, bad_axes | changed_axes)
    result = _result_sentences(
        difference,
        changes,
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
    gains = _gains_by_relevance(parameters, relevant_axes)
    if not gains:
        gains = _gains_by_relevance(parameters, ())
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
        *_change_sentences(difference, headline),
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
    """Returns a sentence on each bad light; a reason that several have, such as a crash, stands with the first only."""
    sentences = []
    stated_reasons = set[str]()
    for light in lights:
        text = f"{light.levels}. {light.reason}"
        if light.reason in stated_reasons:
            text = f"{light.levels}; bad for the reason above."
        stated_reasons.add(light.reason)
        sentences.append(Sentence(text, f"{light.name.capitalize()}:"))
    return sentences


def _bad_lights(reviews: Mapping[str, Review]) -> list[_BadLight]:
    """Returns the lights that are bad on at least one side, whatever they are on the other.

    A light is the judgement of one subject, such as the motors, with a level. A bad light matters more than a figure
    that changed.

    Args:
        reviews: review documents of both logs, by side; one without lights, as of a fleet, is compared with nothing.

    Returns:
        The lights, in their order.
    """
    bad_lights = []
    for name, lights_by_side in _lights_of_both(reviews).items():
        levels = [light["level"] for light in lights_by_side.values()]
        if Level.BAD not in levels:
            continue
        bad_sides = tuple(
            side for side, light in lights_by_side.items() if light["level"] == Level.BAD
        )
        axis = value_at(lights_by_side[bad_sides[0]], "figures.axis") or ""
        levels_of_sides, reason = _levels_and_reason(lights_by_side)
        bad_lights.append(_BadLight(name, bad_sides, axis, levels_of_sides, reason))
    return bad_lights


def has_motor_difference(reviews: Mapping[str, Review]) -> bool:
    """Returns whether the motors of both flights differ by their lights: in level, or in the motor that is named.

    What a motor lost in flight is a figure of that flight alone, which is not tested together with the compared ones.
    A light that warns of nothing on both sides, such as a good and an unknown one, is no difference of the motors.

    Args:
        reviews: review documents of both logs, by side; one without lights, as of a fleet, is compared with nothing.
    """
    lights_by_side = _lights_of_both(reviews).get(Light.MOTORS)
    if lights_by_side is None:
        return False
    first, second = lights_by_side.values()
    warns = any(light["level"] in WARNING_LEVELS for light in (first, second))
    return warns and not _are_equal(first, second)


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
    """Returns the levels of a light on both sides, and what makes it bad or to be watched.

    Args:
        lights_by_side: the light of each log's review document, by side; at least one is bad or to be watched.

    Returns:
        The levels, such as "bad in A, good in B", and the reason, such as "Motor 3 lost 19 to 41 % of its thrust at
        47 s.", with the sentences of both sides if both have the same level and the sentences differ.
    """
    first_side, second_side = STATE_NAMES
    first, second = lights_by_side[first_side], lights_by_side[second_side]
    if first["level"] != second["level"]:
        second_is_worse = second["level"] == Level.BAD or first["level"] not in WARNING_LEVELS
        worse_light = second if second_is_worse else first
        levels = f"{first['level']} in {first_side}, {second['level']} in {second_side}"
        return levels, f"{worse_light['sentence']}{_remark_on_imus(first, second)}"
    levels = f"{first['level']} in {first_side} and {second_side}"
    if first["sentence"] == second["sentence"]:
        return levels, first["sentence"]
    first_motor = motor_number(first.get("subject") or "")
    second_motor = motor_number(second.get("subject") or "")
    if None not in (first_motor, second_motor) and first_motor != second_motor:
        levels += ", of different motors"
    sentences = (
        f"{first_side}: {first['sentence']} {second_side}: {second['sentence']}"
        f"{_remark_on_imus(first, second)}"
    )
    return levels, sentences


def _remark_on_imus(first_light: JsonValues, second_light: JsonValues) -> str:
    """Returns the remark that two lights are of different IMUs, with a space before it; empty if they are not.

    The light of the vibration is of the IMU that vibrates most, and IMUs are mounted in different ways: the difference
    of two of them is no change of the vehicle.

    Args:
        first_light, second_light: lights of two review documents.
    """
    subjects = [light.get("subject") or "" for light in (first_light, second_light)]
    are_imus = all(subject.startswith("IMU ") for subject in subjects)
    if not are_imus or subjects[0] == subjects[1]:
        return ""
    return f" {subjects[0]} and {subjects[1]} are different sensors: their difference is no change."


def _sentence_on_watched_motors(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns the sentence on the motors' light where it differs, and is bad on no side; none otherwise.

    Args:
        reviews: review documents of both logs, by side; one without lights, as of a fleet, is compared with nothing.
    """
    if not has_motor_difference(reviews):
        return []
    levels, reason = _levels_and_reason(_lights_of_both(reviews)[Light.MOTORS])
    return [Sentence(f"{levels}. {reason}", f"{Light.MOTORS.capitalize()}:")]


def sentences_on_watched_lights(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns a sentence on each light of the vehicle with the level "watch" on one side, and "good" on the other.

    The lights of the wind and of the log are left out: they judge the day and the recording, and not the vehicle. That
    of the motors stands before them (:func:`_sentence_on_watched_motors`).

    Args:
        reviews: review documents of both logs, by side; one without lights, as of a fleet, is compared with nothing.
    """
    sentences = []
    for name, lights_by_side in _lights_of_both(reviews).items():
        if name in (Light.MOTORS, Light.WIND, Light.LOG):
            continue
        levels = {light["level"] for light in lights_by_side.values()}
        if levels == {Level.GOOD, Level.WATCH}:
            texts = []
            for side, light in lights_by_side.items():
                # The lead has the name of the light already.
                detail = light["sentence"].removeprefix(f"{name.capitalize()} ")
                sentence = without_full_stop(shortened(detail, MAX_LIGHT_CHARACTERS))
                texts.append(f"{light['level']} in {side} ({sentence})")
            remark = _remark_on_imus(*lights_by_side.values())
            sentences.append(Sentence(f"{', '.join(texts)}.{remark}", f"{name.capitalize()}:"))
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
    """Returns the lights of both logs: a table of those whose levels differ, and a sentence on the others.

    A light is the judgement of one subject by a review, such as the motors, with a level.

    Args:
        reviews: review documents of both logs, by side ("A" and "B").

    Returns:
        The table with a row for each differing light and a column for each side, with level and sentence, in the first
        log's order of lights, and the sentence; nothing if either log has no lights.
    """
    lights_by_side = {side: review.get("lights") or {} for side, review in reviews.items()}
    if not all(lights_by_side.values()):
        return []
    first_lights, second_lights = lights_by_side.values()
    rows = []
    # Lights that are equal on both sides are only named.
    names_by_level = dict[str, list[str]]()
    for name, first_light in first_lights.items():
        second_light = second_lights.get(name)
        if second_light is not None and _are_equal(first_light, second_light):
            names_by_level.setdefault(first_light["level"], []).append(name)
        else:
            rows.append([name, _light_cell(first_light), _light_cell(second_light)])
    table = [Table(["light", *reviews], rows, words=True)] if rows else []
    return [*table, *render_section("difference_lights", names_by_level=names_by_level)]


def motor_table(reviews: Mapping[str, Review], difference: VehicleDifference) -> Blocks:
    """Returns a table that compares the motors of two flights one by one.

    A row has the motor, what the review of each flight warns of about it, such as the thrust that it lost, and the
    changes of its relative trim and of its control effectiveness, with their 90 % intervals.

    Args:
        reviews: review documents of both logs, by side; of a fleet, empty.
        difference: comparison of the two states.

    Returns:
        The table; nothing if neither flight has a warning about a single motor, since the changes alone are shown
        elsewhere.
    """
    warnings_by_side = {side: _motor_warnings(reviews.get(side, {})) for side in STATE_NAMES}
    if not any(warnings_by_side.values()):
        return []
    motor_numbers = set[int]()
    for side, warnings in warnings_by_side.items():
        hover_motors = value_at(reviews[side], "condition.hover.motors") if warnings else None
        motor_numbers |= {*warnings, *range(1, len(hover_motors or ()) + 1)}
    changes_by_kind: dict[str, dict[int, QuantityChange]] = {SHARE: {}, EFFECT: {}}
    for change in difference.changes:
        if change.quantity.is_of_motor:
            motor_numbers.add(change.quantity.motor)
            changes_by_kind[change.quantity.kind][change.quantity.motor] = change
    # A quantity that was compared for no motor gets no column.
    shown_kinds = [kind for kind, changes in changes_by_kind.items() if changes]
    rows = []
    for motor in sorted(motor_numbers):
        cells = [
            _motor_cell(reviews[side], warnings_by_side[side].get(motor)) for side in STATE_NAMES
        ]
        for kind in shown_kinds:
            change_of_motor = changes_by_kind[kind].get(motor)
            cells.append("" if change_of_motor is None else _change_with_interval(change_of_motor))
        rows.append([f"motor {motor}", *cells])
    titles = [SHOWN_QUANTITIES[kind].name for kind in shown_kinds]
    return [Table(["", *STATE_NAMES, *titles], rows, words=True)]


def _motor_warnings(review: Review) -> dict[int, JsonValues]:
    """Returns the worst warning of a review about each motor, by the number of the motor, from 1 on.

    Motors without a warning are left out. Of equally bad warnings that of the motors' light is taken, or else the first
    event.

    Args:
        review: review document of a log; empty for a fleet.

    Returns:
        The warnings as facts of the document, with keys such as "level", "subject" and "sentence".
    """
    facts = [value_at(review, f"lights.{Light.MOTORS}"), *review.get("events", ())]
    warnings: dict[int, JsonValues] = {}
    for level in WARNING_LEVELS:
        for fact in facts:
            motor = motor_number((fact or {}).get("subject") or "")
            if motor is not None and fact["level"] == level:
                warnings.setdefault(motor, fact)
    return warnings


def _motor_cell(review: Review, fact: JsonValues | None) -> str:
    """Returns the cell of one motor in one flight: its warning, shortened and with its level, or that there is none.

    Args:
        review: review document of the log; empty for a fleet.
        fact: the worst warning about the motor (:func:`_motor_warnings`); None without one.
    """
    if fact is None:
        level = Level(value_at(review, f"lights.{Light.MOTORS}.level") or Level.UNKNOWN)
        [sentence] = render_section(
            "difference_motor", is_known=level is not Level.UNKNOWN, loss=None
        )
        return sentence.text
    [sentence] = render_section(
        "difference_motor",
        is_known=True,
        loss=value_at(fact, "figures.loss"),
        time=fact.get("time"),
        sentence=MOTOR_AT_START.sub("", fact["sentence"]),
    )
    text = without_full_stop(shortened(sentence.text, MAX_MOTOR_CHARACTERS))
    return Rated(text, Level(fact["level"]))


def _are_equal(first_light: JsonValues, second_light: JsonValues) -> bool:
    """Returns whether two lights have one level and, if they warn, say the same of the same motor, IMU or axis.

    Args:
        first_light, second_light: lights of two review documents.
    """
    if first_light["level"] != second_light["level"]:
        return False
    if first_light["level"] not in WARNING_LEVELS:
        return True
    keys = ("code", "subject", "figures.axis")
    return all(value_at(first_light, key) == value_at(second_light, key) for key in keys)


def _light_cell(light: JsonValues | None) -> Rated | str:
    """Returns the cell of a light in a table: its level and its sentence; empty if a log does not have the light."""
    if light is None:
        return ""
    return Rated(light["level"], Level(light["level"]), light["sentence"])


def headline_blocks(
    headlines: Mapping[str, str | None], comparison_headline: Sequence[Sentence] = ()
) -> Blocks:
    """Returns the headline of each log's own review as a sentence with the lead "A by itself:" or "B by itself:".

    Args:
        headlines: headline of the review of each log, by side, "A" and "B"; None for a side without one.
        comparison_headline: sentences that head the comparison, which are shown above.

    Returns:
        A sentence for each side; none for a side whose headline the comparison has stated already.
    """
    blocks = Blocks()
    for side, sentence in headlines.items():
        if sentence and not any(sentence in headline.text for headline in comparison_headline):
            blocks.append(Sentence(sentence, f"{side} by itself:"))
    return blocks


def baseline_blocks(
    latest_row: FlightRow, difference: VehicleDifference, *, has_identity_cautions: bool = True
) -> Blocks:
    """Returns the report on the differences between a vehicle's latest flight and its baseline of healthy flights.

    Args:
        latest_row: row of the latest flight in the fleet's table, for its date and file.
        difference: difference of that flight from the baseline.
        has_identity_cautions: whether the report says so if several vehicles may have the name.

    Returns:
        Sentences: which flights are compared, whether anything changed, what changed, and cautions.
    """
    lead = "Since the baseline:"
    date = "" if latest_row.date is None else f" ({latest_row.date:%Y-%m-%d})"
    baseline_count = counted(difference.flights.before, "flight")
    file = PurePath(latest_row.file).name
    text = f"the latest flight, {file}{date}, compared with {baseline_count}."
    return [
        Sentence(text, lead),
        *_result_sentences(difference, _changes_by_relevance(difference)),
        *_change_sentences(difference),
        *(_identity_cautions(difference) if has_identity_cautions else ()),
    ]


def _changes_by_relevance(
    difference: VehicleDifference, axes: Collection[str] = ()
) -> list[QuantityChange]:
    """Returns the changed quantities: those of loops of some axes first, then the surest (lowest p-value) first.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.
        axes: axes whose margins are bad on one side, so that changes of their loops matter most.
    """
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    changes_of_bad_loops = []
    other_changes = []
    for change in sorted(changes, key=lambda change: change.p):
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
    """Separates the changes that other gains explain from those that they do not; both keep their order."""
    changes_by_cause = _ChangesByCause([], [])
    for change in changes:
        if difference.follows_from_gains(change):
            changes_by_cause.by_gains.append(change)
        else:
            changes_by_cause.unexplained.append(change)
    return changes_by_cause


def _result_sentences(
    difference: VehicleDifference,
    changes: Sequence[QuantityChange],
    *,
    has_bad_light: bool = False,
    has_motor_difference: bool = False,
) -> list[Sentence]:
    """Returns the result of the comparison in one sentence: the change that matters most, or that nothing changed.

    The surest doubtful change is named with it, or in its place: one whose own interval shows a change, which the test
    of all quantities together does not confirm.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.
        changes: the changed quantities, the most relevant first.
        has_bad_light: whether a light is bad on a side, so that it must not be said that nothing differs.
        has_motor_difference: whether the motors differ by their lights, so that only other figures may not.
    """
    unexplained_changes, by_gains = _changes_by_cause(difference, changes)
    doubtful = sorted(filter(_is_doubtful, difference.tested), key=lambda change: change.p)
    candidates = unexplained_changes or doubtful
    outcomes = Counter(change.outcome for change in difference.changes)
    return render_section(
        "difference_conclusion",
        change=change_text(candidates[0], difference) if candidates else "",
        further_count=len(candidates) - 1,
        is_doubtful=not unexplained_changes,
        doubtful=change_text(doubtful[0], difference) if unexplained_changes and doubtful else "",
        p=candidates[0].p if candidates else None,
        tested_count=len(difference.tested),
        uncertain_count=outcomes[QuantityOutcome.UNCERTAIN],
        same_count=outcomes[QuantityOutcome.SAME],
        has_figures=bool(difference.changes),
        has_changes_by_gains=bool(by_gains),
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
    difference: VehicleDifference, headline: Sequence[Sentence] = ()
) -> list[Sentence]:
    """Returns a sentence on all compared quantities with the same outcome, for each outcome that there is.

    In this order: the quantities that changed; those that changed by other gains; doubtful ones, whose own interval
    shows a change that the test of all quantities together does not confirm; uncertain ones, whose interval allows for
    a change as for none; and those that stayed the same.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.
        headline: sentences shown above; changes by gains that they name are left out.
    """
    doubtful = []
    uncertain = list[QuantityChange]()
    for change in difference.changes:
        if _is_doubtful(change):
            doubtful.append(change_text(change, difference))
        elif change.outcome is QuantityOutcome.UNCERTAIN:
            uncertain.append(change)
    unexplained_changes, by_gains = _changes_by_cause(difference, _changes_by_relevance(difference))
    # The headline names the first change, so that a single one is not repeated.
    listed_changes = unexplained_changes if len(unexplained_changes) > 1 else []
    tested_changes = difference.tested
    surest_change = min(
        filter(_is_doubtful, tested_changes), key=lambda change: change.p, default=None
    )
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
        doubtful=doubtful,
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
    """Returns the sentence on how much may have changed, and what would have been found, where no change was found.

    Args:
        difference: comparison of two states, quantity by quantity.

    Returns:
        The sentence, with the largest change that the intervals of each kind of quantity contain, and the change that
        nine of ten such comparisons find. It is empty if a tested quantity changed or is doubtful, or if both states
        are the same flight.
    """
    tested_changes = difference.tested
    for change in tested_changes:
        if change.outcome is QuantityOutcome.CHANGED or _is_doubtful(change):
            return []
    if difference.is_of_same_flight:
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


def _gains_by_relevance(
    parameters: Sequence[ParameterChange], axes: Collection[str]
) -> list[ParameterChange]:
    """Returns the changed gains of the rate controllers, those that changed by the largest factor first.

    Args:
        parameters: parameters of the autopilot that changed.
        axes: axes whose gains are wanted; all axes where it is empty.

    Returns:
        The gains.
    """
    gains = []
    for parameter in parameters:
        is_of_axes = not axes or not {*axes}.isdisjoint(axes_of_parameter(parameter.name))
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
    4. A quantity changed that new gains do not explain: to check the part that this points to.
    5. A change is doubtful: to inspect the motor that perhaps became weaker, if there is one, and to fly again.
    6. Otherwise: no step.

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
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    unexplained_changes = _changes_by_cause(difference, changes).unexplained
    if unexplained_changes:
        return _what_to_check(unexplained_changes, difference)
    doubtful_changes = [change for change in difference.tested if _is_doubtful(change)]
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
    """Returns the next step of each log's own review in which a light is bad, that of the later log first.

    The step of the earlier log is left out if each of its bad lights is good in the later log of the same vehicle, or
    says there the same of the same motor or axis.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
        are_two_vehicles: whether A and B are two vehicles, so that B does not show whether A was mended.
    """
    later_side = _later_side(reviews)
    (earlier_side,) = set(STATE_NAMES) - {later_side}
    sides = []
    bad_lights = _bad_lights(reviews)
    if any(later_side in light.bad_sides for light in bad_lights):
        sides.append(later_side)
    for light in bad_lights:
        earlier, later = (
            reviews[side]["lights"][light.name] for side in (earlier_side, later_side)
        )
        is_open = are_two_vehicles or not (
            later["level"] == Level.GOOD or _are_equal(earlier, later)
        )
        if earlier_side in light.bad_sides and is_open and earlier_side not in sides:
            sides.append(earlier_side)
    steps: list[Sentence] = []
    for side in sides:
        next_step = value_at(reviews[side], "next_step.sentence")
        if next_step and next_step not in [step.text for step in steps]:
            steps.append(Sentence(next_step, f"Next, by {side}:"))
    return steps


def _what_to_check(
    changes: Sequence[QuantityChange], difference: VehicleDifference
) -> list[Sentence]:
    """Returns the sentence on what to check after a change: the motor that became weaker or, without one, the surest.

    Args:
        changes: the changed quantities that new gains do not explain, at least one.
        difference: comparison of the vehicle, with the names of its motors.
    """
    weaker_motors = [change for change in changes if _is_weaker(change)]
    surest_change = min(weaker_motors or changes, key=lambda change: change.p)
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
