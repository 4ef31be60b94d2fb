"""What changed between two states of a vehicle in sentences: what is the same, what is uncertain, what is unknown."""

import re
from collections.abc import Iterator, Mapping, Sequence
from math import degrees
from pathlib import PurePath
from typing import Any, NamedTuple

from mavdem.containers import Names, group_by
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts import Level
from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.fleet.quantities import (
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
from mavdem.fleet.random_effects import SD_BETWEEN_FLIGHTS, QuantityChange
from mavdem.fleet.row import UNKNOWN, FlightRow
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.report.blocks import Blocks, Rated, Sentence, Table, caution
from mavdem.report.numbers import counted, listed, plus_minus, rounded, without_remark
from mavdem.report.templates import render_section

Review = Mapping[str, Any]
"""The document of a review, as ``report.json`` has it; any of its keys may be missing."""

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
    OVERSHOOT: ShownQuantity("overshoot of the rate", 100.0, "%"),
    RISE: ShownQuantity("rise time of the rate", 1e3, "ms"),
}
"""How quantities are shown, by their kind."""

PARAMETER_NAMES_OF_AXES = {
    "roll": re.compile("RLL|ROLL"),
    "pitch": re.compile("PIT"),
    "yaw": re.compile("YAW"),
}
"""What names of ArduPilot's and PX4's parameters contain that belong to one axis."""

MAX_PARAMETERS_BESIDE = 4
"""Largest number of changed parameters that are named beside a changed margin: a choice."""


def difference_blocks(
    difference: VehicleDifference,
    parameters: Sequence[ParameterChange] = (),
    lacking: Names = (),
) -> Blocks:
    """Returns sentences on the differences between two states of a vehicle, or two vehicles, with their certainty.

    Doubts about the vehicles come first, then what changed and what could not be compared, parameters, and conditions.
    Where A and B are the same flight, only that is said.

    Args:
        difference: comparison of the two states.
        parameters: parameters of the autopilot that changed.
        lacking: sides, "A" or "B", whose parameters are not known.

    Returns:
        The sentences.
    """
    if difference.is_of_same_flight:
        return [*render_section("difference_same_flight")]
    missing_by_reason = group_by(difference.incomparable, lambda missing: missing.reason)
    not_compared = []
    for reason, missing_quantities in missing_by_reason.items():
        names = listed(missing.quantity for missing in missing_quantities)
        not_compared.append(Sentence(f"{names}: {reason}", "Not compared:"))
    conclusions = render_section("difference", difference, between=SD_BETWEEN_FLIGHTS)
    parameter_sentences = render_section(
        "difference_parameters", difference, parameters=parameters, lacking=lacking
    )
    return [
        *_vehicle_doubts(difference),
        *_change_sentences(difference, parameters),
        *not_compared,
        *parameter_sentences,
        *conclusions,
    ]


def light_blocks(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns a sentence on each light that is bad on one side, and known not to be on the other.

    A light is the judgement of one part of the vehicle, such as its motors, with a level. That it turned bad is more
    than that a figure changed. Where the other side is unknown, nothing is known to differ.

    Args:
        reviews: review documents of both logs, by side; one without lights, as of a fleet, is compared with nothing.

    Returns:
        The sentences, with the name of the light as their lead.
    """
    lights_by_side = {side: review.get("lights") or {} for side, review in reviews.items()}
    sentences = []
    # Both documents list the same lights, so those of either side will do.
    for name in next(iter(lights_by_side.values())):
        if not all(name in lights_of_side for lights_of_side in lights_by_side.values()):
            continue
        lights = {side: lights_of_side[name] for side, lights_of_side in lights_by_side.items()}
        bad_sides = [side for side, light in lights.items() if light["level"] == Level.BAD]
        levels = {light["level"] for light in lights.values()}
        if len(bad_sides) != 1 or not levels & {Level.GOOD, Level.WATCH}:
            continue
        (bad_side,) = bad_sides
        (other_side,) = lights.keys() - {bad_side}
        text = (
            f"bad in {bad_side.upper()}, {lights[other_side]['level']} in {other_side.upper()}. "
            f"{lights[bad_side]['sentence']}"
        )
        sentences.append(Sentence(text, f"{name.capitalize()}:"))
    return sentences


def light_table(reviews: Mapping[str, Review]) -> Table | None:
    """Returns the lights of both logs, a row for each side with level and sentence; None without the lights of both.

    Args:
        reviews: review documents of both logs, by side.
    """
    lights_by_side = {side: review.get("lights") or {} for side, review in reviews.items()}
    if not all(lights_by_side.values()):
        return None
    rows = []
    for name in next(iter(lights_by_side.values())):
        for side, lights in lights_by_side.items():
            light = lights.get(name)
            if light is not None:
                level = Rated(light["level"], Level(light["level"]))
                rows.append([f"{name}, {side}", level, light["sentence"]])
    return Table(["light", "level", "what it says"], rows, words=True)


def headline_blocks(headlines: Mapping[str, str | None]) -> Blocks:
    """Returns the headline of each side by itself.

    Args:
        headlines: headline of each side; None for a side without one.
    """
    return [
        Sentence(headline, f"{side.upper()} by itself:")
        for side, headline in headlines.items()
        if headline
    ]


def baseline_blocks(latest_row: FlightRow, difference: VehicleDifference | None) -> Blocks:
    """Returns the report on the differences between a vehicle's latest flight and its baseline.

    Args:
        latest_row: row of the latest flight.
        difference: difference of that flight from the baseline; None if the baseline has no flight of the vehicle.

    Returns:
        The sentences.
    """
    lead = "Since the baseline:"
    if difference is None:
        return [Sentence("the baseline has no flight of this vehicle.", lead)]
    date = "" if latest_row.date is None else f" ({latest_row.date:%Y-%m-%d})"
    baseline_count = counted(difference.flights.before, "flight")
    file = PurePath(latest_row.file).name
    text = f"the latest flight, {file}{date}, compared with {baseline_count}."
    return [Sentence(text, lead), *_change_sentences(difference), *_vehicle_doubts(difference)]


def conclusion_without_change(difference: VehicleDifference) -> str:
    """Returns the sentence on all quantities of a comparison in which none changed: whether that is known.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.

    Returns:
        The sentence; empty if a quantity changed.
    """
    if difference.changes_with(QuantityOutcome.CHANGED):
        return ""
    return _change_sentences(difference)[0].lead


def _change_sentences(
    difference: VehicleDifference, parameters: Sequence[ParameterChange] = ()
) -> list[Sentence]:
    """Returns sentences on the quantities that changed, that stayed the same, and that are uncertain.

    A quantity is uncertain if the data show neither a change nor its absence. Uncertain quantities that would be
    significant if they were tested alone are named first: the joint test of many quantities makes them doubtful.

    Args:
        difference: comparison of two groups of flights of a vehicle, quantity by quantity.
        parameters: parameters of the autopilot that changed.

    Returns:
        The sentences.
    """
    changed = []
    significant_alone = []
    unknown = list[QuantityChange]()
    for change in difference.changes:
        text = change_text(change, difference) + _parameters_beside(change, parameters)
        if change.outcome is QuantityOutcome.CHANGED:
            changed.append(text)
        elif change.is_significant_alone:
            significant_alone.append(text)
        elif change.outcome is QuantityOutcome.UNCERTAIN:
            unknown.append(change)
    return render_section(
        "difference_changes",
        changed=changed,
        significant_alone=significant_alone,
        same=[*_texts_by_kind(difference.changes_with(QuantityOutcome.SAME))],
        unknown=[*_texts_of_equal_changes(unknown, difference, parameters)],
        others=_are_two_vehicles(difference),
        has_trims=any(change.quantity.kind == SHARE for change in difference.changes),
        tested=len(difference.changes),
        level=SIGNIFICANCE,
    )


def _texts_of_equal_changes(
    changes: Sequence[QuantityChange],
    difference: VehicleDifference,
    parameters: Sequence[ParameterChange],
) -> Iterator[str]:
    """Yields the text of each change, one for all motors whose figures read alike.

    Args:
        changes: changes of quantities of motors or axes.
        difference: comparison of the vehicle, with the names of its motors.
        parameters: parameters of the autopilot that changed.
    """
    motors_by_text = dict[str, list[str]]()
    for change in changes:
        text = change_text(change, difference) + _parameters_beside(change, parameters)
        motors = []
        if change.quantity.is_of_motor:
            motors = [_motor_name(change, difference)]
            text = text.removeprefix(f"{motors[0]}'s ")
        motors_by_text.setdefault(text, []).extend(motors)
    for text, motors in motors_by_text.items():
        yield f"{listed(motors)}'s {text}" if motors else text


def _parameters_beside(change: QuantityChange, parameters: Sequence[ParameterChange]) -> str:
    """Returns the changed parameters that a figure of a loop depends on, such as " (ATC_RAT_RLL_P 0.135 → 0.108)".

    These are parameters of control that name the figure's axis or none, such as filters. Other quantities do not depend
    on parameters, and have an empty text.

    Args:
        change: the quantity.
        parameters: parameters of the autopilot that changed.
    """
    if change.quantity.kind not in LOOP_KINDS:
        return ""
    texts = []
    for parameter in parameters:
        if not CONTROL_PARAMETERS.match(parameter.name):
            continue
        axes = [
            axis
            for axis, pattern in PARAMETER_NAMES_OF_AXES.items()
            if pattern.search(parameter.name)
        ]
        if not axes or change.quantity.axis in axes:
            texts.append(f"{parameter.name} {parameter.before:g} → {parameter.after:g}")
    if not texts:
        return ""
    hidden_count = len(texts) - MAX_PARAMETERS_BESIDE
    if hidden_count > 0:
        texts = [*texts[:MAX_PARAMETERS_BESIDE], f"{hidden_count} more"]
    return f", with {listed(texts)}"


def surest_change(difference: VehicleDifference) -> QuantityChange | None:
    """Returns the change with the lowest p-value; None if nothing changed."""
    changes = difference.changes_with(QuantityOutcome.CHANGED)
    return min(changes, key=lambda change: change.p, default=None)


def next_blocks(
    difference: VehicleDifference, parameters: Sequence[ParameterChange] = ()
) -> list[Sentence]:
    """Returns the next step: a sentence that names the part of the vehicle to check after a change.

    It is the motor that became weaker with the lowest p-value. If none did, it is the part of the change with the
    lowest p-value.

    Args:
        difference: comparison of two states, quantity by quantity.
        parameters: parameters of the autopilot that changed between them.

    Returns:
        One sentence. None without a change, if new gains explain all changes, or if the states are of two vehicles,
        whose differences are no faults.
    """
    changes = []
    for change in difference.changes_with(QuantityOutcome.CHANGED):
        if not _parameters_beside(change, parameters):
            changes.append(change)
    vehicles_before, vehicles_after = difference.vehicles
    known_vehicles = {*vehicles_before, *vehicles_after} - {UNKNOWN}
    if not changes or len(known_vehicles) > 1:
        return []
    weaker_motors = [change for change in changes if _is_weaker(change)]
    candidates = weaker_motors or changes
    surest = min(candidates, key=lambda change: change.p)
    motor = _motor_name(surest, difference) if surest.quantity.is_of_motor else ""
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

    Shares and effects of motors have no value before and after. For the other quantities both values are shown, and
    then the change with the half width of its 90 % interval; that of quantities compared as ratios is in percent.

    Args:
        change: change of one quantity.
        difference: comparison of the vehicle, with the names of its motors.
    """
    quantity = change.quantity
    shown_form = SHOWN_QUANTITIES[quantity.kind]
    if quantity.is_of_motor:
        name = f"{_motor_name(change, difference)}'s {shown_form.name}"
    else:
        name = f"{shown_form.name} on {quantity.axis}"
    if quantity.kind in LOGARITHMIC_KINDS:
        percent = 100 * change.half_width
        decimals = 0 if percent >= MIN_WHOLE_PERCENT else 1
        increase = _signed(f"{100 * change.difference:z.{decimals}f}")
        change_with_interval = f"{increase} % ± {percent:.{decimals}f} %"
    else:
        change_with_interval = _signed(
            plus_minus(shown_form.scale * change.difference, shown_form.scale * change.half_width)
        )
    if change.before is None or change.after is None:
        return f"{name} {change_with_interval}"
    before = rounded(shown_form.scale * change.before)
    after = rounded(shown_form.scale * change.after)
    space = " " if shown_form.unit not in ("°", "") else ""
    return f"{name} {before} → {after}{space}{shown_form.unit} ({change_with_interval})"


def _texts_by_kind(changes: Sequence[QuantityChange]) -> Iterator[str]:
    """Yields a text for each kind of quantity, such as "relative trim of motor 1 and motor 2 (± 2 %)".

    The uncertainty is the widest half width of the 90 % intervals of one kind, so that the text holds for each of its
    quantities.

    Args:
        changes: changes of quantities that stayed the same within their uncertainty.
    """
    changes_by_kind = group_by(changes, lambda change: change.quantity.kind)
    for kind, changes_of_kind in changes_by_kind.items():
        shown_form = SHOWN_QUANTITIES[kind]
        names = []
        for change in changes_of_kind:
            quantity = change.quantity
            names.append(f"motor {quantity.motor}" if quantity.is_of_motor else quantity.axis)
        widest_half_width = max(change.half_width for change in changes_of_kind)
        if kind in LOGARITHMIC_KINDS:
            # The half width of a logarithm is that of a ratio.
            uncertainty = f"{rounded(100 * widest_half_width)} %"
        else:
            uncertainty = f"{rounded(shown_form.scale * widest_half_width)} {shown_form.unit}"
        yield f"{shown_form.name} of {listed(names)} (± {uncertainty})"


def _signed(number: str) -> str:
    """Returns a formatted number with its sign, a minus sign in the place of a hyphen."""
    if number.startswith(("-", "(-")):
        return number.replace("-", "−")
    return f"+{number}"


def _vehicle_doubts(difference: VehicleDifference) -> Blocks:
    """Returns cautions about whether both states are of one vehicle, by the names of their vehicles.

    If the vehicle of a state has no name, this cannot be checked, and a sentence says so.

    Args:
        difference: comparison of two states, with the names of the vehicles of each.
    """
    names_before, names_after = difference.vehicles
    if UNKNOWN in (*names_before, *names_after):
        return [*render_section("difference_unnamed")]
    doubts = render_section(
        "difference_vehicles",
        before=names_before,
        after=names_after,
        others=_are_two_vehicles(difference),
        found=difference,
    )
    return [caution(doubt.text) for doubt in doubts]


def _are_two_vehicles(difference: VehicleDifference) -> bool:
    """Returns whether the states are known to be of different vehicles, so that what differs did not change.

    Args:
        difference: comparison of two states, with the names of the vehicles of each.
    """
    names_before, names_after = difference.vehicles
    has_names = bool(names_before and names_after)
    is_known = has_names and UNKNOWN not in (*names_before, *names_after)
    return is_known and set(names_before) != set(names_after)
