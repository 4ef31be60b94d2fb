"""The status lights of two logs side by side: which are bad or differ, and why."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from mavdem.containers import JsonValues, Names
from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import LIKELY_PROBABILITY, MotorsBetween
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.report.blocks import Blocks, Rated, Sentence, Table
from mavdem.report.difference.side_titles import side_title
from mavdem.report.numbers import listed, rounded
from mavdem.report.templates import (
    as_clause,
    capitalize_first,
    first_clause,
    first_sentence,
    render_section,
    without_full_stop,
)

Review = Mapping[str, Any]
"""The document of a review, as ``report.json`` has it; any of its keys may be missing."""

NO_REVIEWS: Mapping[str, Review] = MappingProxyType({})
"""No review documents, as of fleets."""

WARNING_LEVELS = (Level.BAD, Level.WATCH)
"""Levels of a light that warns, the worse first."""

REFERENCE = "reference"
"""State of the motors in a flight with which others are compared, and which was not judged itself."""

STATES_WORST_FIRST = (*WARNING_LEVELS, Level.GOOD, REFERENCE, Level.UNKNOWN)
"""All states of a light in the order in which texts on several flights name them: what was not judged comes last."""

MAX_HEADING_LENGTH = 90
"""Letters from which on a heading omits figures in brackets, and then all after a semicolon: a choice, two lines."""

FIGURES_IN_BRACKETS = re.compile(r" \((?!probability)[^()]*\d[^()]*\)")
"""Figures in brackets, such as an interval; a probability decides how the heading is meant, and stays."""


SEMICOLON = re.compile(r"; (?![^()]*\))")
"""A semicolon outside of brackets."""

REASSURANCE = "Margin goal probably met: "
"""Beginning of the sentence on margins to be watched, whose interval leaves open whether they suffice."""

INTERVAL = re.compile(r"\S+ to \S+ %")
"""Figures in brackets that are the interval of an estimate in percent, such as "17 to 32 %"."""


class LightReason(NamedTuple):
    """Why a status light has its level."""

    side: str
    """Side whose light it explains, "A" or "B"; empty if the text need not say which."""

    sentence: str
    """Sentence of the light."""

    @property
    def text(self) -> str:
        """The sentence, after the side if it has one."""
        return f"{self.side}: {self.sentence}" if self.side else self.sentence


class BadLight(NamedTuple):
    """A light that is bad on at least one side."""

    name: str
    """Name of the light, such as "margins"."""

    bad_sides: Names
    """Sides on which it is bad: "A", "B", or both."""

    axis: str
    """Axis that makes it bad; empty where it is none."""

    levels: str
    """Levels of both sides, such as "bad in A, good in B"."""

    reasons: Sequence[LightReason]
    """Why it is bad, and why the other side is unknown if it is; two where both are bad for different reasons."""

    remark: str
    """Remark on IMUs, which follows the reasons; mostly empty."""


def bad_lights(reviews: Mapping[str, Review]) -> list[BadLight]:
    """Returns the status lights that are bad in at least one of the two compared logs.

    A status light is the judgement of one subject, such as the motors, with a level (good, watch, bad or unknown). A
    bad light matters more to the reader than a measured quantity that changed.

    Args:
        reviews: review documents of both logs, by side, "A" and "B". A document without lights, such as the review of a
            fleet, is compared with nothing.

    Returns:
        The bad lights: those that are bad in the later log before those that became better. Of either, first those that
        are the headline of their flight, such as a crash, and then the others, each in the order of the review of A.
    """
    headlines: list[BadLight] = []
    others: list[BadLight] = []
    for name, lights_by_side in lights_of_both(reviews).items():
        bad_sides = [side for side, light in lights_by_side.items() if light["level"] == Level.BAD]
        if not bad_sides:
            continue
        bad_light = _bad_light(name, lights_by_side, bad_sides)
        if any(_is_headline(lights_by_side[side], reviews[side]) for side in bad_sides):
            headlines.append(bad_light)
        else:
            others.append(bad_light)
    later = later_side(reviews)
    return sorted([*headlines, *others], key=lambda light: later not in light.bad_sides)


def _is_headline(light: JsonValues, review: Review) -> bool:
    """Returns whether the headline of a flight states one of its status lights.

    Args:
        light: the light, the judgement of one subject, as the review has it.
        review: review document of the flight.
    """
    headline_sentence = value_at(review, "headline.sentence")
    return bool(light["sentence"] == headline_sentence)


def _bad_light(
    name: str, lights_by_side: Mapping[str, JsonValues], bad_sides: Sequence[str]
) -> BadLight:
    """Returns one status light that is bad in a compared log, with its levels in both logs and the reasons for them.

    Args:
        name: name of the light, such as "margins".
        lights_by_side: the light as the review documents of the two logs have it, by side, "A" and "B".
        bad_sides: the sides on which the light is bad, at least one. The axis is taken from the first of them.
    """
    compared_light = compared_levels(lights_by_side)
    return BadLight(
        name,
        bad_sides=tuple(bad_sides),
        axis=value_at(lights_by_side[bad_sides[0]], "figures.axis") or "",
        levels=compared_light.levels,
        reasons=compared_light.reasons,
        remark=compared_light.remark,
    )


def lights_of_both(reviews: Mapping[str, Review]) -> dict[str, dict[str, JsonValues]]:
    """Returns the lights that both logs have: by name the light of each side, "A" before "B", in the order of A.

    Args:
        reviews: review documents of both logs, by side; one without lights, as of a fleet, has none in common.
    """
    first_side, second_side = STATE_NAMES
    first_lights = reviews.get(first_side, {}).get("lights") or {}
    second_lights = reviews.get(second_side, {}).get("lights") or {}
    common_lights = {}
    for name, first_light in first_lights.items():
        if name in second_lights:
            common_lights[name] = {first_side: first_light, second_side: second_lights[name]}
    return common_lights


class ComparedLevels(NamedTuple):
    """A status light in both logs, in words."""

    levels: str
    """Level in each log, such as "bad in A, good in B"."""

    reasons: Sequence[LightReason]
    """Reason for the warning, such as "Motor 3 lost 19 to 41 % of its thrust at 47 s."; two if both lights warn."""

    remark: str = ""
    """Remark on IMUs with a space before it; empty where none is needed."""

    @property
    def reason(self) -> str:
        """All reasons and the remark as one text."""
        return " ".join(reason.text for reason in self.reasons) + self.remark


def compared_levels(lights_by_side: Mapping[str, JsonValues]) -> ComparedLevels:
    """Compares a status light, the judgement of one subject such as the motors, of two logs.

    Args:
        lights_by_side: the light in the review document of each log, by side, "A" and "B"; at least one is bad or to be
            watched.

    Returns:
        The levels as text, such as "bad in A, good in B", and the reasons: that of the light that warns, and that of
        the other one if it warns, too, for another reason, or is unknown.
    """
    levels = _levels_text(lights_by_side)
    first_light, second_light = lights_by_side.values()
    do_both_warn = all(light["level"] in WARNING_LEVELS for light in (first_light, second_light))
    if not do_both_warn:
        reasons = _reasons_of_single_warning(lights_by_side)
    elif first_light["sentence"] == second_light["sentence"]:
        return ComparedLevels(levels, [LightReason("", first_light["sentence"])])
    else:
        reasons = _reasons_of_both_warnings(lights_by_side)
    return ComparedLevels(levels, reasons, remark_on_imus(lights_by_side))


def _reasons_of_both_warnings(lights_by_side: Mapping[str, JsonValues]) -> list[LightReason]:
    """Returns why a status light warns in two logs, for different reasons.

    Args:
        lights_by_side: the light in the review document of each log, by side. Beside a bad one, the first sentence on
            one that is only to be watched is enough.
    """
    worst_sides = lights_of_worst_level(lights_by_side).keys()
    reasons = []
    for side, light in lights_by_side.items():
        is_milder = side not in worst_sides
        sentence = _warning_alone(light["sentence"])
        if is_milder:
            sentence = first_sentence(sentence)
        reasons.append(LightReason(side, sentence))
    return reasons


def _reasons_of_single_warning(lights_by_side: Mapping[str, JsonValues]) -> list[LightReason]:
    """Returns why a status light warns in one of two logs and, if it is unknown in the other, why that is so.

    Args:
        lights_by_side: the light in the review document of each log, by side.
    """
    [warning_light] = lights_of_worst_level(lights_by_side).values()
    reasons = [LightReason("", warning_light["sentence"])]
    for side, light in lights_by_side.items():
        last_state = states_in_flights(light)[-1]
        if last_state == Level.UNKNOWN:
            reasons.append(LightReason(side, light["sentence"]))
    return reasons


def _levels_text(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns the levels of a status light in two logs, such as "bad in A and B" or "bad in A, good in B".

    Args:
        lights_by_side: the light in the review document of each log or fleet, by side.
    """
    are_of_fleets = any(len(levels_in_flights(light)) > 1 for light in lights_by_side.values())
    levels = {light["level"] for light in lights_by_side.values()}
    if len(levels) == 1 and not are_of_fleets:
        [level] = levels
        return f"{level} in {' and '.join(lights_by_side)}"
    separator = "; " if are_of_fleets else ", "
    return separator.join(_level_text(side, light) for side, light in lights_by_side.items())


def _level_text(side: str, light: JsonValues) -> str:
    """Returns the level of a status light on one side of a comparison, such as "good in A".

    A side may be a fleet, that is several logs. The text is then, for example, "good in all 3 logs of A" or "bad
    in 2 of 5 logs of A, the last one too".

    Args:
        side: "A" or "B".
        light: the light in the review document of the side; that of a fleet has the level of each flight as ``levels``.
    """
    states = states_in_flights(light)
    last_state = states[-1]
    if len(states) == 1:
        return f"{last_state} in {side}"
    if states.count(last_state) == len(states):
        number_of_logs = "both" if len(states) == 2 else f"all {len(states)}"
        return f"{last_state} in {number_of_logs} logs of {side}"
    worst_state = next(state for state in STATES_WORST_FIRST if state in states)
    worst_count = states.count(worst_state)
    text = f"{worst_state} in {worst_count} of {len(states)} logs of {side}"
    if last_state != worst_state:
        return f"{text}, {last_state} in the last one"
    return f"{text}, the last one" if worst_count == 1 else f"{text}, the last one too"


def light_heading(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns the heading on a status light that warns, such as "In B: motor 1 lost about 25 % of its thrust …".

    It states the log in which the light is worse. If it is equally bad in both, for different reasons, it has a
    sentence for each.

    Args:
        lights_by_side: the light in the review document of each log, by side, "A" and "B"; at least one is bad or to be
            watched.
    """
    if len(lights_by_side) == 2 and _is_loss_of_same_motor(*lights_by_side.values()):
        return _heading_on_same_motor(lights_by_side)
    flights_by_clause = dict[str, list[str]]()
    for side, light in lights_of_worst_level(lights_by_side).items():
        flight = _flight_in_heading(side, light)
        flights_by_clause.setdefault(_heading_clause(light["sentence"]), []).append(flight)
    headings = list[Sentence]()
    for clause, flights in flights_by_clause.items():
        headings += render_section("difference_answer", sides=flights, clause=clause)
    return " ".join(heading.text for heading in headings)


def _is_loss_of_same_motor(first_light: JsonValues, second_light: JsonValues) -> bool:
    """Returns whether two logs judge that the same motor has probably lost thrust, so that one heading states both.

    Args:
        first_light, second_light: the same status light in the review documents of both logs.
    """
    for light in (first_light, second_light):
        probability = value_at(light, "figures.probability")
        is_loss = light.get("code") == MotorsBetween.MOTOR_WEAK and light.get("subject")
        if not is_loss or probability is None or probability < LIKELY_PROBABILITY:
            return False
    return _latest_lights_are_equal(first_light, second_light)


def _heading_on_same_motor(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns the heading on a motor that lost thrust in both logs, such as "In A and B: motor 1 lost about 23 % …".

    Args:
        lights_by_side: the light of the motors in the review document of each log, by side, "A" and "B".
    """
    lights = list(lights_by_side.values())
    flights = [_flight_in_heading(side, light) for side, light in lights_by_side.items()]
    are_of_fleets = all(len(levels_in_flights(light)) > 1 for light in lights)
    if are_of_fleets:
        flights = [f"the last logs of {listed(lights_by_side)}"]
    [heading] = render_section(
        "difference_same_motor",
        flights=flights,
        motor=lights[0]["subject"],
        losses=[value_at(light, "figures.loss")[0] for light in lights],
        probabilities=[value_at(light, "figures.motor_probability") for light in lights],
    )
    return heading.text


def _flight_in_heading(side: str, light: JsonValues) -> str:
    """Returns which flight a heading is about: that of a log, as its side, or the last one of a fleet.

    Args:
        side: "A" or "B".
        light: the light; that of a fleet has the levels of its flights in order of date as ``levels``.

    Returns:
        A text such as "A", "1 of 3 logs of A" where no other log has that level, or "the last of 3 logs of A";
        "(all bad)" follows where all have it.
    """
    levels = levels_in_flights(light)
    if len(levels) == 1:
        return side
    count_of_level = levels.count(light["level"])
    if count_of_level == 1:
        return f"1 of {len(levels)} logs of {side}"
    if count_of_level == len(levels):
        return f"the last of {len(levels)} logs of {side} (all {light['level']})"
    return f"the last of {len(levels)} logs of {side}"


def lights_of_worst_level(lights_by_side: Mapping[str, JsonValues]) -> dict[str, JsonValues]:
    """Returns a status light of the log in which it has the worse level; of both logs if the levels are the same.

    Args:
        lights_by_side: the light in the review document of each log, by side, "A" and "B"; at least one is bad or to
            be watched.

    Returns:
        The lights by side. They are those that a heading states.
    """
    levels = {light["level"] for light in lights_by_side.values()}
    worst_level = next(level for level in WARNING_LEVELS if level in levels)
    worst_lights = {}
    for side, light in lights_by_side.items():
        if light["level"] == worst_level:
            worst_lights[side] = light
    return worst_lights


def watched_light_heading(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns the heading of a light that is to be watched in one of two logs and good in the other.

    Args:
        lights_by_side: the light in the review document of each log, by side, "A" and "B".

    Returns:
        A sentence such as "Vibration of IMU 2 15.7 → 9.4 m/s²: watch in A, good in B.".
    """
    sides_by_level = {light["level"]: side for side, light in lights_by_side.items()}
    watched_side, good_side = sides_by_level[Level.WATCH], sides_by_level[Level.GOOD]
    lights = lights_by_side.values()
    [heading] = render_section(
        "difference_watched",
        watched_side=watched_side,
        good_side=good_side,
        imu=imu_with_comparable_vibration(lights_by_side),
        vibrations=[value_at(light, "figures.vibration") for light in lights],
        levels=[light["level"] for light in lights],
        clause=_heading_clause(_warning_alone(lights_by_side[watched_side]["sentence"])),
    )
    return heading.text


def imu_with_comparable_vibration(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns the IMU whose vibration two logs judge, such as "IMU 2"; empty if their figures cannot be compared.

    They cannot be if the logs judge different IMUs, or for lights on another subject. If samples were clipped, the
    sentence of the light says more than the figures.

    Args:
        lights_by_side: a light in the review document of each log, by side, "A" and "B".
    """
    subjects = set()
    for light in lights_by_side.values():
        has_vibration = "vibration" in (light.get("figures") or {})
        if not has_vibration or value_at(light, "figures.clips"):
            return ""
        subjects.add(light.get("subject") or "")
    return subjects.pop() if len(subjects) == 1 else ""


def _warning_alone(sentence: str) -> str:
    """Returns the sentence of a light that warns, without the words that would say beside its level that all is well.

    An example is "The roll rate loop has Ms 1.9 (1.6 to 2.4; the maximum sensitivity).".
    """
    return capitalize_first(sentence.removeprefix(REASSURANCE))


def _heading_clause(sentence: str) -> str:
    """Returns the first clause of a light's sentence for a heading, such as "motor 3 lost about 25 % of its thrust".

    Args:
        sentence: sentence of the light, which says what it warns of. Figures in brackets are left out of a long clause.
    """
    clause = _clause_for_heading(sentence)
    if len(clause) > MAX_HEADING_LENGTH:
        clause = FIGURES_IN_BRACKETS.sub("", clause)
    return as_clause(clause)


def _clause_for_heading(sentence: str) -> str:
    """Returns the beginning of a light's sentence that its heading is made of.

    It is the first clause; if that is too long for a heading, only its part before a semicolon.

    Args:
        sentence: sentence of the light.
    """
    clause = without_full_stop(first_clause(first_sentence(sentence)))
    if len(FIGURES_IN_BRACKETS.sub("", clause)) > MAX_HEADING_LENGTH:
        return SEMICOLON.split(clause)[0]
    return clause


def details_below_heading(sentence: str) -> str:
    """Returns what the sentence of a light says beyond the heading above it (:func:`light_heading`).

    Args:
        sentence: sentence of the light, which begins with what the heading states.

    Returns:
        The clauses after it, as in "It works 27 % harder."; before them the interval that a long heading leaves out.
        Empty if the heading states all, and the whole sentence if the heading leaves out more than one interval.
    """
    stated_clause = _clause_for_heading(sentence)
    further_clauses = capitalize_first(sentence.removeprefix(stated_clause).lstrip(";:. "))
    if len(stated_clause) <= MAX_HEADING_LENGTH:
        return further_clauses
    omitted_figures = FIGURES_IN_BRACKETS.findall(stated_clause)
    if not omitted_figures:
        return further_clauses
    interval, _, remark = omitted_figures[0].strip(" ()").partition("; ")
    if len(omitted_figures) > 1 or not INTERVAL.fullmatch(interval):
        return sentence
    [interval_sentence] = render_section("difference_interval", interval=interval, remark=remark)
    return f"{interval_sentence.text} {further_clauses}"


def vibrations_of_same_imu(
    lights_by_side: Mapping[str, JsonValues],
) -> dict[str, tuple[float, float]]:
    """Returns the vibration of each IMU that both logs have.

    IMUs are mounted in different ways, so that a difference between two of them does not mean that the vehicle changed:
    each is compared with itself.

    Args:
        lights_by_side: the light on vibration in the review document of each log, by side, "A" and "B".

    Returns:
        By the name of the IMU, such as "IMU 2", its mean vibration in A and in B, m/s², along the axis that vibrates
        most, in the order of their numbers. IMUs that were not recorded in both logs are left out.
    """
    first_light, second_light = lights_by_side.values()
    first_vibrations = _vibration_by_imu(first_light)
    second_vibrations = _vibration_by_imu(second_light)
    vibrations_of_both = {}
    for imu in sorted(first_vibrations.keys() & second_vibrations.keys()):
        vibrations_of_both[imu] = (first_vibrations[imu], second_vibrations[imu])
    return vibrations_of_both


def _vibration_by_imu(light: JsonValues) -> dict[str, float]:
    """Returns the mean vibration of each IMU of a log, m/s², by its name, such as "IMU 1".

    Args:
        light: the judgement of the vibration in the review document of the log. Its subject is the IMU that vibrates
            most, and its figures have the vibration of this one and the list of all. Documents of earlier versions do
            not have the list.
    """
    figures = light.get("figures") or {}
    vibration_by_imu = {}
    if light.get("subject") and "vibration" in figures:
        vibration_by_imu[light["subject"]] = figures["vibration"]
    vibration_of_all = figures.get("imu_levels") or ()
    for number, vibration in enumerate(vibration_of_all, start=1):
        vibration_by_imu[f"IMU {number}"] = vibration
    return vibration_by_imu


def remark_on_imus(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns a remark that keeps a reader from comparing the vibration of two different IMUs.

    The light of the vibration, its judgement, is about the IMU that vibrates most. If that is IMU 1 in log A and IMU 3
    in log B, their difference is no change. The remark then has the change of each IMU (:func:`vibration_changes`).

    Args:
        lights_by_side: the same light in the review document of each log, by side, "A" and "B".

    Returns:
        The remark with a space before it; if no IMU was recorded in both logs, it says that the sensors differ. Empty
        if both lights are about the same IMU, or about something else.
    """
    first_light, second_light = lights_by_side.values()
    first_subject = first_light.get("subject") or ""
    second_subject = second_light.get("subject") or ""
    are_imus = first_subject.startswith("IMU ") and second_subject.startswith("IMU ")
    if not are_imus or first_subject == second_subject:
        return ""
    changes = vibration_changes(lights_by_side)
    if not changes:
        sensors = f"{first_subject} and {second_subject}"
        return f" {sensors} are different sensors: their difference is no change."
    return f" {changes}."


def vibration_changes(lights_by_side: Mapping[str, JsonValues]) -> str:
    """Returns the vibration of each IMU in both logs, such as "IMU 1: 11 → 5.1 m/s²; IMU 2: 16 → 7.4 m/s²".

    Args:
        lights_by_side: the light on vibration in the review document of each log, by side, "A" and "B".

    Returns:
        The text, without a full stop; empty if no IMU is known in both logs, and for a light on another subject.
    """
    changes = []
    for imu, (vibration_in_a, vibration_in_b) in vibrations_of_same_imu(lights_by_side).items():
        changes.append(f"{imu}: {rounded(vibration_in_a)} → {rounded(vibration_in_b)} m/s²")
    return "; ".join(changes)


def later_side(reviews: Mapping[str, Review]) -> str:
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


def light_blocks(reviews: Mapping[str, Review], text_above: str = "") -> Blocks:
    """Returns the status lights of two logs side by side: a table of those that differ, and a sentence on the others.

    A status light is the judgement of one subject by a review, such as the motors, with a level.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
        text_above: text at the top of the page. For sentences that it has, the table refers to it.

    Returns:
        The table, with a row for each differing light and a column with level and sentence for each side, and then the
        sentence. Of a fleet, the column counts its flights by level. Empty if either side has no lights.
    """
    lights_by_side = {side: lights_of_side(review) for side, review in reviews.items()}
    if not all(lights_by_side.values()):
        return []
    first_lights, second_lights = lights_by_side.values()
    rows = []
    # Lights that are equal on both sides are only named.
    equal_names_by_level = dict[str, list[str]]()
    for name, first_light in first_lights.items():
        second_light = second_lights.get(name)
        if second_light is not None and lights_are_equal(first_light, second_light):
            equal_names_by_level.setdefault(first_light["level"], []).append(name)
        else:
            rows.append([name, *_light_cells(first_light, second_light, text_above)])
    blocks: Blocks = []
    if rows:
        titles = []
        for side, lights in lights_by_side.items():
            log_count = max(len(levels_in_flights(light)) for light in lights.values())
            titles.append(side_title(side, log_count))
        blocks.append(Table(["light", *titles], rows, words=True))
    blocks += render_section("difference_lights", names_by_level=equal_names_by_level)
    return blocks


def sentences_on_further_watched_lights(
    reviews: Mapping[str, Review], headline: Sequence[Sentence]
) -> list[Sentence]:
    """Returns sentences on the lights to be watched that the headline does not name, with their reasons.

    A light is the judgement of one subject. These are to be watched in both logs, or in one and not known in the other:
    they show no change, but may be the reason of the next step. An example is "Watch in A and B: vibration. Vibration
    16 m/s² on IMU 2." Those of wind and log are left out, since they judge the day and the recording.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
        headline: the sentences that head the comparison; their leads name lights, such as "Motors:".
    """
    names_in_headline = {sentence.lead.removesuffix(":").lower() for sentence in headline}
    sentences = []
    for name, lights_by_side in lights_of_both(reviews).items():
        if name in (Light.WIND, Light.LOG) or name in names_in_headline:
            continue
        levels = set[str]()
        for light in lights_by_side.values():
            levels.update(levels_in_flights(light))
        if Level.WATCH not in levels or not levels <= {Level.WATCH, Level.UNKNOWN}:
            continue
        compared = compared_levels(lights_by_side)
        reasons = []
        for reason in compared.reasons:
            reasons.append(reason._replace(sentence=first_sentence(reason.sentence)).text)
        text = f"{name}. {' '.join(reasons)}{compared.remark}"
        sentences.append(Sentence(text, lead=f"{capitalize_first(compared.levels)}:"))
    return sentences


def lights_of_side(review: Review) -> dict[str, JsonValues]:
    """Returns the status lights (judgements of motors, vibration and others) of one side of a comparison, by name.

    Args:
        review: review document of a log, with its lights; or that of a fleet, with the levels of each light in all its
            flights (``light_levels``), and a sentence only on the motors. The level of a fleet's light is the last.
    """
    lights = {}
    for name, levels in (review.get("light_levels") or {}).items():
        lights[name] = {"level": levels[-1], "sentence": "", "levels": levels}
    return lights | (review.get("lights") or {})


def states_in_flights(light: JsonValues) -> list[str]:
    """Returns the level of a status light, such as "good", in each flight of a fleet, or in the one flight of a log.

    Motors that were not judged, since those of other flights are compared with them, are ``REFERENCE`` instead.

    Args:
        light: the light in a review document. That of a fleet has ``levels`` and ``flights``, in order of date, and
            each flight may have ``is_reference``.
    """
    levels = levels_in_flights(light)
    states = [str(level) for level in levels]
    for number, flight in enumerate(light.get("flights") or ()):
        if flight.get("is_reference"):
            states[number] = REFERENCE
    return states


def levels_in_flights(light: JsonValues) -> Sequence[Level]:
    """Returns the level of a status light in each flight of a fleet, in order of date; of a log its one level."""
    return light.get("levels") or [light["level"]]


def lights_are_equal(first_light: JsonValues, second_light: JsonValues) -> bool:
    """Returns whether a status light means the same on both sides: the same level and, if it warns, the same reason.

    A status light is the judgement of one subject, such as the motors. The reason is the same if the code of the
    finding is, and the motor, IMU or axis that it is about. Its numbers, such as the thrust that was lost, may differ.
    Of a fleet, all flights must have that level.

    Args:
        first_light, second_light: the same light in the review documents of both sides.
    """
    all_levels = {*levels_in_flights(first_light), *levels_in_flights(second_light)}
    return len(all_levels) == 1 and _latest_lights_are_equal(first_light, second_light)


def _latest_lights_are_equal(first_light: JsonValues, second_light: JsonValues) -> bool:
    """Returns whether a status light has the same level and, if it warns, the same reason in the latest of the flights.

    A log has one flight. Of a fleet, :func:`lights_are_equal` also compares the flights before.

    Args:
        first_light, second_light: the same light in the review documents of both logs or fleets.
    """
    if first_light["level"] != second_light["level"]:
        return False
    is_warning = first_light["level"] in WARNING_LEVELS
    if is_warning:
        # "figures.axis" is the key "axis" in the dictionary "figures".
        identifying_keys = ("code", "subject", "figures.axis")
        return all(
            value_at(first_light, key) == value_at(second_light, key) for key in identifying_keys
        )
    # Without a warning there is no reason to compare. But good stability margins of one axis mean less than those of
    # three axes. For lights on other subjects both sets of axes are empty.
    return _axes_of_margins(first_light) == _axes_of_margins(second_light)


def _axes_of_margins(light: JsonValues) -> frozenset[str]:
    """Returns the axes of which a status light states the margins of the loops; none for another light."""
    if light.get("code") != MarginsLight.LOOP_MARGINS:
        return frozenset()
    return frozenset(value_at(light, "figures.names") or ())


def _light_cells(
    first_light: JsonValues, second_light: JsonValues | None, text_above: str
) -> list[Rated | str]:
    """Returns the two cells of a table that compares a status light of two logs: one cell for each log.

    A status light is the judgement of one subject, such as the vibration. If it is about IMU 1 in one log and about
    IMU 3 in the other, the second cell ends with how the vibration of each of them changed.

    Args:
        first_light: the light in the review document of the first log, with its ``level`` and ``sentence``.
        second_light: the same light of the second log; None if that log does not have it.
        text_above: text above the table, to which a cell refers for a sentence that it has.

    Returns:
        Cells with the level, for example "good", which a page colours by it and explains by the sentence. The second
        cell is empty text without a second light.
    """
    first_cell = _light_cell(first_light, text_above)
    if second_light is None:
        return [first_cell, ""]
    first_side, second_side = STATE_NAMES
    change_of_imus = remark_on_imus({first_side: first_light, second_side: second_light})
    return [first_cell, _light_cell(second_light, text_above, change_of_imus)]


def _light_cell(light: JsonValues, text_above: str, remark: str = "") -> Rated:
    """Returns a table cell with the level of a status light, such as "bad", and an explanation behind it.

    The explanation is the sentence of the light, which says why it has that level.

    Args:
        light: the light (the judgement of one subject, such as the vibration) in the review document of a log or fleet.
        text_above: text above the table. If it has the sentence, the explanation refers to it instead.
        remark: text that is added to the explanation, with a space before it; empty for none.
    """
    sentence = light["sentence"]
    if sentence and sentence in text_above:
        [reference] = render_section("difference_stated_above")
        sentence = reference.text
    states = states_in_flights(light)
    if len(states) > 1:
        return _light_cell_of_fleet(states, sentence, remark)
    return Rated(light["level"], Level(light["level"]), reason=sentence + remark)


def _light_cell_of_fleet(states: Sequence[str], sentence_on_last: str, remark: str) -> Rated:
    """Returns a table cell with the worst level of a status light in the logs of a fleet, and an explanation.

    For example "bad", explained by "in 2 of 9 logs, good in 7. The last one, good: …".

    Args:
        states: level of the light in each flight, in order of date; ``REFERENCE`` for motors that were not judged,
            since those of other flights are compared with them.
        sentence_on_last: sentence of the light of the last flight.
        remark: text that is added to the explanation, with a space before it; empty for none.
    """
    log_counts = Counter(states)
    worst_state, *other_states = [state for state in STATES_WORST_FIRST if state in log_counts]
    [explanation] = render_section(
        "difference_light_of_flights",
        worst_count=log_counts[worst_state],
        count=len(states),
        other_counts={state: log_counts[state] for state in other_states},
        last_state=states[-1],
        sentence_on_last=sentence_on_last,
    )
    level = Level.UNKNOWN if worst_state == REFERENCE else Level(worst_state)
    return Rated(worst_state, level, reason=explanation.text + remark)
