"""The sentences at the head of a comparison of two states: the differences that matter."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

from mavdem.containers import JsonValues
from mavdem.facts import Level
from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.parameter_changes import ParameterChange, axes_of_parameter
from mavdem.fleet.quantities import (
    ATTITUDE_GAIN_MARGIN,
    ATTITUDE_PHASE_MARGIN,
    GAIN_MARGIN,
    MAX_SENSITIVITY,
    PHASE_MARGIN,
    SHARE,
)
from mavdem.fleet.random_effects import QuantityChange
from mavdem.fleet.report_columns import value_at
from mavdem.report.blocks import Blocks, Sentence, headline_sentence
from mavdem.report.difference.changes import (
    changes_by_cause,
    changes_by_relevance,
    doubtful_changes,
    result_sentences,
)
from mavdem.report.difference.effort import effort_sentences
from mavdem.report.difference.flight_cautions import mixed_sides
from mavdem.report.difference.gain_table import (
    changed_rate_gains,
    further_parameters,
    gain_phrase,
    gain_table,
    rate_gains_in_order,
)
from mavdem.report.difference.identity import identity_cautions
from mavdem.report.difference.lights import (
    BadLight,
    LightReason,
    Review,
    bad_lights,
    compared_levels,
    details_below_heading,
    imu_with_comparable_vibration,
    later_side,
    light_heading,
    lights_of_both,
    lights_of_worst_level,
    remark_on_imus,
    vibration_changes,
    watched_light_heading,
)
from mavdem.report.difference.motors import MotorVerdict
from mavdem.report.difference.parameter_groups import parameter_group_texts
from mavdem.report.difference.parameter_rows import parameter_text
from mavdem.report.difference.quantity_texts import (
    SHOWN_QUANTITIES,
    change_text,
    change_without_interval,
    increase_with_interval,
    values_of_both_states,
)
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.difference.yaw_trim import yaw_trim_sentences
from mavdem.report.numbers import listed
from mavdem.report.templates import (
    first_and_further_sentences,
    render_section,
    without_full_stop,
)

KINDS_OF_MARGINS = {
    ("rate", "phase_margin"): PHASE_MARGIN,
    ("rate", "gain_margin"): GAIN_MARGIN,
    ("rate", "ms"): MAX_SENSITIVITY,
    ("attitude", "phase_margin"): ATTITUDE_PHASE_MARGIN,
    ("attitude", "gain_margin"): ATTITUDE_GAIN_MARGIN,
}
"""Kinds of compared quantities, by the loop and the figure that the light on margins names."""

MAX_HEADLINE_PARAMETERS = 4
"""Largest number of changed parameters other than gains that the headline names: a choice."""

LEAD_OF_GAINS = "Gains changed:"
"""Lead of the sentence on changed gains in the template ``difference_gains``."""

MAX_HEADLINE_EFFECTS = 3
"""Largest number of figures of loops that the headline names with the gains: a choice."""


class _HeadlineParts(NamedTuple):
    """The differences that the headline of a comparison states, each as sentences; empty where there is none."""

    cautions: list[Sentence]
    """That the states are of two vehicles, or one of a simulation."""

    lights: list[Sentence]
    """On the lights (judgements of one subject each, such as the motors) that are bad on a side, and on motors that are
    judged differently."""

    effort: list[Sentence]
    """Whether all motors work harder."""

    result: list[Sentence]
    """Whether compared figures changed."""

    gains: list[Sentence]
    """On changed gains, and their effects."""

    worse_lights: list[Sentence]
    """On the other lights that are good in the earlier log and to be watched in the later one."""

    better_lights: list[Sentence]
    """On those that are good in the later log."""

    has_unexplained_change: bool
    """Whether some compared figure changed for which the gains, for example, are no explanation."""


def headline_of_comparison(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the sentences at the head of a comparison, on the terminal and on pages: the differences that matter.

    They come in the order of :class:`_HeadlineParts`, with these exceptions:

    - Where A and B are the same flight, only that is said.
    - Changed gains come before bad lights of which none is bad in B alone: they surely changed, and may be the cause.
    - If the gains explain all changed figures, the result says only that nothing else changed for sure. So it comes
      last, or before the lights that became better if some change is doubtful, since that may be a damage.

    Args:
        reviewed: comparison of the two states, with the reviews of both logs and changed parameters.

    Returns:
        The sentences with their leads.
    """
    difference = reviewed.difference
    if difference.is_of_same_flight:
        return render_section("difference_same_flight", flights=difference.flights.before)
    parts = _headline_parts(reviewed)
    gains = parts.gains
    sentences = [*parts.cautions]
    if _do_gains_come_first(bad_lights(reviewed.reviews), reviewed):
        sentences += gains
        gains = []
    sentences += parts.lights
    if parts.has_unexplained_change:
        sentences += [*parts.effort, *parts.result, *gains]
        return [*sentences, *parts.worse_lights, *parts.better_lights]
    sentences += [*gains, *parts.worse_lights, *parts.effort]
    if doubtful_changes(reviewed):
        return [*sentences, *parts.result, *parts.better_lights]
    return [*sentences, *parts.better_lights, *parts.result]


def _headline_parts(reviewed: ReviewedDifference) -> _HeadlineParts:
    """Returns the differences that the headline of a comparison states.

    Figures of the motor that a light names are its evidence, and no result of their own. Of the figures that changed,
    one is named: of a loop with a bad margin, or else the surest one. If the trims of all motors are those of another
    yaw trim, that is named too. Gains are those of loops with a bad margin or a changed figure, or else all changed
    gains.

    Args:
        reviewed: comparison of the two states, with the reviews of both logs and changed parameters.
    """
    difference = reviewed.difference
    evidence = _stated_evidence_of_weak_motor(reviewed)
    lights = bad_lights(reviewed.reviews)
    light_sentences = _sentences_on_lights(lights, reviewed, evidence)
    bad_axes = {light.axis for light in lights if light.name == Light.MARGINS}
    changes = changes_by_relevance(difference, bad_axes, evidence)
    worse_lights, better_lights = _sentences_on_watched_lights_by_change(reviewed.reviews)
    effort = effort_sentences(reviewed)
    # Lights that became better stand above the result only if no change is doubtful.
    are_better_lights_above = bool(better_lights) and not doubtful_changes(reviewed)
    has_difference_above = bool(worse_lights or effort or are_better_lights_above)
    result = result_sentences(reviewed, changes, has_difference_above=has_difference_above)
    return _HeadlineParts(
        cautions=identity_cautions(reviewed) if reviewed.are_two_vehicles else [],
        lights=light_sentences,
        effort=effort,
        result=[*result, *yaw_trim_sentences(reviewed)],
        gains=_sentences_on_gains(reviewed, changes, light_sentences),
        worse_lights=worse_lights,
        better_lights=better_lights,
        has_unexplained_change=bool(changes_by_cause(difference, changes).unexplained),
    )


def _stated_evidence_of_weak_motor(reviewed: ReviewedDifference) -> tuple[QuantityChange, ...]:
    """Returns the changes that the sentence on the motors states as evidence of a weak motor, such as that of its trim.

    If the trim of another motor changed too, a later sentence compares the trims, and mostly begins with that of the
    weak motor. Its sure changes are then left out here, so that they are not stated twice.

    Args:
        reviewed: comparison of the two states, with what is known of the motors.
    """
    evidence = reviewed.motors.evidence
    other_changes = changes_by_relevance(reviewed.difference, without=evidence)
    unexplained = changes_by_cause(reviewed.difference, other_changes).unexplained
    if not any(change.quantity.kind == SHARE for change in unexplained):
        return evidence
    return tuple(change for change in evidence if change.outcome != QuantityOutcome.CHANGED)


def _sentences_on_lights(
    lights: Sequence[BadLight],
    reviewed: ReviewedDifference,
    evidence: Collection[QuantityChange],
) -> list[Sentence]:
    """Returns a sentence on each bad light, and on the motors if they are judged differently, with measured evidence.

    Args:
        lights: the lights (judgements of one subject each) that are bad in at least one of the states.
        reviewed: comparison of the two states, with the reviews of both logs.
        evidence: changes of figures of a weak motor that the sentence on the motors states.
    """
    sentences = _sentences_on_bad_lights(lights, reviewed)
    is_motors_light_bad = any(light.name == Light.MOTORS for light in lights)
    if reviewed.motors.differs and not is_motors_light_bad:
        sentences.append(_sentence_on_motors(reviewed.reviews))
    # Means over flights with and without the fault agree with neither.
    if mixed_sides(reviewed):
        return sentences
    motors = reviewed.motors._replace(evidence=tuple(evidence))
    return with_evidence(sentences, motors, reviewed.difference)


def _do_gains_come_first(lights: Sequence[BadLight], reviewed: ReviewedDifference) -> bool:
    """Returns whether changed gains are stated before bad lights (judgements): they are sure, and may be the cause.

    A light that is bad in B alone, or motors that are judged differently, matter more than gains. Gains of two vehicles
    are no change.

    Args:
        lights: the lights that are bad in at least one of the states.
        reviewed: comparison of the two states, with the changed parameters.
    """
    has_changed_gains = bool(changed_rate_gains(reviewed.parameters, ()))
    _, second_side = STATE_NAMES
    is_light_worse = any(light.bad_sides == (second_side,) for light in lights)
    is_worse = is_light_worse or reviewed.motors.differs
    return bool(lights) and has_changed_gains and not is_worse and not reviewed.are_two_vehicles


def headline_in_two_sizes(reviewed: ReviewedDifference, headline: Sequence[Sentence]) -> Blocks:
    """Returns the sentences at the top of page and terminal, the important ones with large letters.

    - A sentence on a status light (the judgement of one subject, such as the motors) that warns has a heading above it.
    - Of any other difference the first sentence is in large letters. Two vehicles differ in much, so that only their
      first difference is.
    - That nothing else changed is in large letters only if no difference is above it.
    - Of the lights that are only to be watched, the first has a heading, if nothing is above it.
    - Cautions, such as that the flights are of two vehicles, stay in usual text.
    - Below the sentence on changed gains stands their table.

    Args:
        reviewed: comparison of both flights.
        headline: the sentences that head the comparison, in their order.
    """
    cautions = identity_cautions(reviewed)
    watched_lights = sentences_on_watched_lights(reviewed.reviews)
    headings = light_headings(reviewed)
    blocks = Blocks()
    is_first_difference = True
    for sentence in headline:
        # Leads such as "Changed:" introduce a difference. One that is a sentence itself says that there is none.
        states_difference = sentence.lead.endswith(":")
        is_important = is_first_difference or (states_difference and not reviewed.are_two_vehicles)
        # A light has an empty heading if an earlier heading states its cause.
        is_cause_stated = headings.get(sentence.lead) == ""
        if sentence in cautions or not is_important or is_cause_stated or not sentence.lead:
            # A sentence that is a lead alone would be in large letters.
            blocks.append(sentence if sentence.text else Sentence(sentence.lead))
            continue
        if sentence in watched_lights and is_first_difference:
            blocks += _watched_light_below_heading(sentence, reviewed)
        elif sentence in watched_lights:
            blocks.append(sentence)
        elif sentence.lead in headings:
            heading = headline_sentence(headings[sentence.lead])
            blocks += [heading, _sentence_below_heading(sentence, reviewed)]
        else:
            blocks += _large_sentence(sentence)
        if sentence.lead == LEAD_OF_GAINS:
            blocks += gain_table(reviewed)
        is_first_difference = False
    return blocks


def _watched_light_below_heading(
    sentence: Sentence, reviewed: ReviewedDifference
) -> list[Sentence]:
    """Returns the heading on a light that is to be watched, and below it the sentence on the light.

    Args:
        sentence: the sentence on the light (the judgement of one subject); its lead names it, such as "Vibration:".
        reviewed: comparison of two states, with the reviews of their logs.
    """
    lights_by_side = lights_of_both(reviewed.reviews)[_light_name(sentence.lead)]
    heading = headline_sentence(watched_light_heading(lights_by_side))
    return [heading, _details_of_watched_light(sentence, lights_by_side)]


def _sentence_below_heading(sentence: Sentence, reviewed: ReviewedDifference) -> Sentence:
    """Returns the sentence on a status light without what the heading above it states.

    For example, below the heading "In B: motor 1 is weak." the reason "Motor 1 is weak; it works 27 % harder." becomes
    "It works 27 % harder.". A status light is the judgement of one subject, such as the motors.

    Args:
        sentence: the sentence, with the reasons of the light's levels in A and B; its lead names the light, such as
            "Motors:".
        reviewed: comparison of two states, with the reviews of their logs.
    """
    text = sentence.text
    lights_by_side = lights_of_both(reviewed.reviews)[_light_name(sentence.lead)]
    # The heading states the reason of the worse level only, so that the reason of the other state stays whole.
    for side, light in lights_of_worst_level(lights_by_side).items():
        reason = light["sentence"]
        details = details_below_heading(reason)
        is_introduced_by_side = LightReason(side, reason).text in text
        if is_introduced_by_side and not details:
            # The text has the side before the reason, as in "B: …", and nothing would follow it: the reason stays.
            continue
        text = text.replace(reason, details)
    # A reason that is left out leaves the spaces around it.
    return sentence._replace(text=re.sub("  +", " ", text).strip())


def _details_of_watched_light(
    sentence: Sentence, lights_by_side: Mapping[str, JsonValues]
) -> Sentence:
    """Returns the sentence on a light that is to be watched, without what the heading above it states.

    Of vibration, the vibration of each IMU in both logs is left, without the levels. Other sentences stay as they are.

    Args:
        sentence: the sentence on the light (the judgement of one subject), with its levels in both logs.
        lights_by_side: the light in the review document of each log, by side, "A" and "B".
    """
    if not imu_with_comparable_vibration(lights_by_side):
        return sentence
    return sentence._replace(text=f"{vibration_changes(lights_by_side)}.")


def _large_sentence(sentence: Sentence) -> list[Sentence]:
    """Returns a sentence whose beginning is in large letters; the rest, which explains it, is in usual text.

    The beginning is the lead if that is a sentence itself, and otherwise the lead with the first sentence of the text.
    """
    if sentence.lead.endswith("."):
        beginning, explanation = sentence.lead, sentence.text
    else:
        result, explanation = first_and_further_sentences(sentence.text)
        beginning = f"{sentence.lead} {result}".strip()
    blocks = [headline_sentence(beginning)]
    if explanation:
        blocks.append(Sentence(explanation))
    return blocks


def light_headings(reviewed: ReviewedDifference) -> dict[str, str]:
    """Returns the headings above the sentences on lights that differ, such as "In B: motor 1 is weak.".

    Args:
        reviewed: comparison of the two states, with the reviews of both logs.

    Returns:
        Each heading by the lead of the sentence below it, such as "Motors:". It is empty where the heading of an
        earlier sentence states the same cause.
    """
    lights_by_name = lights_of_both(reviewed.reviews)
    headings = dict[str, str]()
    for name in _lights_with_heading(reviewed):
        heading = light_heading(lights_by_name[name])
        is_stated_above = heading in headings.values()
        headings[_lead_of_light(name)] = "" if is_stated_above else heading
    return headings


def _lights_with_heading(reviewed: ReviewedDifference) -> list[str]:
    """Returns the names of the lights whose sentence has a heading: bad ones, and the motors if judged differently.

    Margins have none if their sentence states the change of one margin, such as "phase margin on roll 29 → 12°".

    Args:
        reviewed: comparison of the two states, with the reviews of both logs.
    """
    names = []
    for light in bad_lights(reviewed.reviews):
        if not _change_of_bad_margin(light, reviewed):
            names.append(light.name)
    if reviewed.motors.differs and Light.MOTORS not in names:
        names.append(Light.MOTORS)
    return names


def _lead_of_light(name: str) -> str:
    """Returns the lead of a sentence on a light, such as "Motors:"."""
    return f"{name.capitalize()}:"


def _light_name(lead: str) -> str:
    """Returns the name of the light that a sentence with such a lead is about: "motors" for "Motors:"."""
    return lead.removesuffix(":").lower()


def _sentences_on_gains(
    reviewed: ReviewedDifference,
    changes: Sequence[QuantityChange],
    light_sentences: Sequence[Sentence],
) -> list[Sentence]:
    """Returns the sentences of the headline on changed gains and their effects, such as a smaller phase margin.

    The first names the gains of the rate controllers that changed, and the second the quantities of the same axes that
    changed because of them, and what other changed parameters set. Without such gains the other parameters are named,
    if they are few. Parameters that the flight does not depend on, such as ids, are only in the list of all parameters.

    Args:
        reviewed: comparison of the two states, with the changed parameters.
        changes: the changed quantities, the most relevant first.
        light_sentences: sentences on the status lights, such as the margins. They stand above, and changes of
            quantities that they state are not repeated.

    Returns:
        These sentences, one on margins of rate loops whose change is not certain, and one on gains that both sides name
        differently, which are not compared; empty if no parameter changed and the names are the same.
    """
    gains = rate_gains_in_order(reviewed.parameters)
    further = further_parameters(reviewed)
    text_on_lights = " ".join(sentence.text for sentence in light_sentences)
    effects = []
    for change in _effects_of_gains(gains, changes, reviewed.difference):
        # A sentence on a light that states the change has its interval too.
        if change_text(change, reviewed.difference) not in text_on_lights:
            effects.append(change_without_interval(change, reviewed.difference))
    other_parameters = []
    if not gains and len(further) <= MAX_HEADLINE_PARAMETERS:
        other_parameters = [parameter_text(parameter) for parameter in further]
    return render_section(
        "difference_gains",
        gains=gain_phrase(gains),
        further_groups=parameter_group_texts(further),
        other_parameters=other_parameters,
        further_count=len(further),
        # Those that the flight does not depend on are among them.
        set_count=len(reviewed.parameters),
        effects=effects[:MAX_HEADLINE_EFFECTS],
        uncertain_margins=_uncertain_margins_by_axis(reviewed.difference),
        renamed_gain=reviewed.renamed_gain,
        are_two_vehicles=reviewed.are_two_vehicles,
    )


def _effects_of_gains(
    gains: Iterable[ParameterChange],
    changes: Iterable[QuantityChange],
    difference: VehicleDifference,
) -> list[QuantityChange]:
    """Returns the figures of loops that changed because gains of the same axis did, such as a phase margin.

    Args:
        gains: the changed gains.
        changes: the changed quantities, the most relevant first.
        difference: comparison of the two states.
    """
    axes_of_gains = set[str]()
    for gain in gains:
        axes_of_gains.update(axes_of_parameter(gain.name))
    effects = []
    for change in changes:
        is_of_same_axis = change.quantity.axis in axes_of_gains
        if is_of_same_axis and difference.follows_from_gains(change):
            effects.append(change)
    return effects


def _uncertain_margins_by_axis(difference: VehicleDifference) -> dict[str, list[str]]:
    """Returns the stability margins that are too uncertain to tell whether changed gains or filters changed them.

    Args:
        difference: comparison of two states of a vehicle, with the outcome of the test on each quantity.

    Returns:
        Texts such as "phase margin 29 → 54°" by axis, on the phase margin, in degrees, and the maximum sensitivity Ms
        of the rate loop in both states. Axes whose gains and filters are the same, or whose margins are known well
        enough, are left out.
    """
    margins_by_axis = dict[str, list[str]]()
    for change in difference.changes_with(QuantityOutcome.UNCERTAIN):
        quantity = change.quantity
        is_margin = quantity.kind in (PHASE_MARGIN, MAX_SENSITIVITY)
        # Only a loop with other gains or filters is expected to have other margins.
        if not is_margin or not difference.follows_from_gains(change):
            continue
        margin = f"{SHOWN_QUANTITIES[quantity.kind].name} {values_of_both_states(change)}"
        margins_by_axis.setdefault(quantity.axis, []).append(margin)
    return margins_by_axis


def _sentences_on_bad_lights(
    lights: Iterable[BadLight], reviewed: ReviewedDifference
) -> list[Sentence]:
    """Returns one sentence for each status light that is bad: its levels in both logs, and the reason.

    A status light is the judgement of one subject of a flight, such as the motors. One reason, such as a crash, may
    make several lights bad. It is written out for the first of them only, and the others refer to it. For bad stability
    margins the sentence says how the margin changed, if it is known in both logs.

    Args:
        lights: the bad lights, in the order of their sentences.
        reviewed: comparison of the two states, with the margins of both.
    """
    sentences = []
    stated_reasons = set[str]()
    for light in lights:
        change_of_margin = _change_of_bad_margin(light, reviewed)
        if change_of_margin:
            text = f"{light.levels}: {change_of_margin}."
        else:
            text = _text_on_bad_light(light, stated_reasons)
            stated_reasons.update(reason.sentence for reason in light.reasons)
        sentences.append(Sentence(text, lead=_lead_of_light(light.name)))
    return sentences


def _text_on_bad_light(light: BadLight, stated_reasons: Collection[str]) -> str:
    """Returns the levels of a bad light in both logs and why it is bad, such as "bad in A, good in B. Motor 3 lost …".

    Args:
        light: the light. It has two reasons if it is bad in both logs for different ones.
        stated_reasons: sentences on the reasons that were stated above: the text refers to them.
    """
    if all(reason.sentence in stated_reasons for reason in light.reasons):
        return f"{light.levels}, for the cause stated above."
    reason_texts = []
    for reason in light.reasons:
        if reason.sentence in stated_reasons:
            reason = reason._replace(sentence="as stated above.")
        reason_texts.append(reason.text)
    return f"{light.levels}. {' '.join(reason_texts)}{light.remark}"


def _change_of_bad_margin(light: BadLight, reviewed: ReviewedDifference) -> str:
    """Returns how the margin changed that makes the light on margins bad, such as "phase margin on roll 29 → 12°".

    Args:
        light: a status light (the judgement of one subject) that is bad in at least one of the two states.
        reviewed: comparison of the two states, with the margins of both.

    Returns:
        The change from state A to state B. It is empty for a light on another subject, and if no single margin can be
        named: different margins are bad in the two states, a margin is in doubt, it is not known in both states, or its
        change is too uncertain to be a result.
    """
    margin = _bad_margin(light, reviewed.reviews)
    if margin is None:
        return ""
    kind = KINDS_OF_MARGINS.get((margin.loop, margin.name))
    for change in reviewed.difference.changes:
        is_of_margin = change.quantity.kind == kind and change.quantity.axis == margin.axis
        if is_of_margin and change.outcome is not QuantityOutcome.UNCERTAIN:
            return change_text(change, reviewed.difference)
    return ""


class _Margin(NamedTuple):
    """A stability margin of a control loop."""

    loop: str
    """Name of the loop, such as "rate"."""

    name: str
    """Name of the margin, such as "phase_margin"."""

    axis: str
    """Axis of the loop, such as "roll"."""


def _bad_margin(light: BadLight, reviews: Mapping[str, Review]) -> _Margin | None:
    """Returns the one stability margin that makes a light bad, in one of the logs or in both.

    Args:
        light: a status light (the judgement of one subject) that is bad in at least one of the logs.
        reviews: review documents of both logs, by side.

    Returns:
        The margin. None for a light on another subject, if different margins are bad in the logs, if a measured
        response contradicts the margin, and if the light is bad for another reason, such as an oscillation.
    """
    if light.name != Light.MARGINS:
        return None
    lights_by_side = lights_of_both(reviews)[light.name]
    margins = set[_Margin]()
    for side in light.bad_sides:
        bad_light = lights_by_side[side]
        is_about_margin = bad_light.get("code") == MarginsLight.LOOP_MARGINS
        is_contradicted = value_at(bad_light, "figures.reason")
        if not is_about_margin or is_contradicted:
            return None
        figures = bad_light["figures"]
        margins.add(_Margin(bad_light["subject"], figures["lacking"], figures["axis"]))
    return margins.pop() if len(margins) == 1 else None


def with_evidence(
    sentences: Sequence[Sentence], motors: MotorVerdict, difference: VehicleDifference
) -> list[Sentence]:
    """Adds the measured evidence for a weak motor to the sentence that names the motor.

    Args:
        sentences: sentences that compare the judgements of two flights, among them, perhaps, that of the motors.
        motors: what is known of the motors, with the measured changes that are evidence of a weak one.
        difference: comparison of the two states, with the names of the motors.

    Returns:
        The sentences; the one on the motors ends with "This agrees with …" if there is evidence, and says whether that
        is a sure change by itself, unless the motor is as likely sound as weak.
    """
    texts = " ".join(sentence.text for sentence in sentences)
    evidence = []
    for change in motors.evidence:
        # The sentence on the motors may have the trim already, as its first figure.
        if increase_with_interval(change) not in texts:
            evidence.append(change)
    if not evidence:
        return [*sentences]
    changes = listed(change_text(change, difference) for change in evidence)
    certainty = _certainty_of_evidence(evidence, motors)
    lead_of_motors = _lead_of_light(Light.MOTORS)
    extended_sentences = []
    for sentence in sentences:
        if sentence.lead == lead_of_motors:
            text = f"{sentence.text} This agrees with {changes}{certainty}."
            sentence = Sentence(text, lead=lead_of_motors)
        extended_sentences.append(sentence)
    return extended_sentences


def _certainty_of_evidence(evidence: Sequence[QuantityChange], motors: MotorVerdict) -> str:
    """Returns ", sure by itself" for a change of a weak motor that is certain; empty if some change is doubtful.

    It is also empty if the motor is as likely sound as weak, beside which it would read as a second verdict.

    Args:
        evidence: the changes that are stated, at least one.
        motors: what is known of the motors.
    """
    are_certain = all(change.outcome is QuantityOutcome.CHANGED for change in evidence)
    if not are_certain or motors.is_as_likely_as_not:
        return ""
    return ", sure by itself" if len(evidence) == 1 else ", each sure by itself"


def _sentence_on_motors(reviews: Mapping[str, Review]) -> Sentence:
    """Returns the sentence that compares how two flights of a vehicle were judged by their motors.

    An example is "Motors: good in A, watch in B. Motor 3 works 12 % harder than the mean of all motors."

    Args:
        reviews: review documents of both logs, by side, "A" and "B". Each has the judgement of the motors: a level
            (good, watch, bad or unknown) with a sentence.
    """
    judgements_by_side = lights_of_both(reviews)[Light.MOTORS]
    comparison = compared_levels(judgements_by_side)
    text = f"{comparison.levels}. {comparison.reason}"
    return Sentence(text, lead=_lead_of_light(Light.MOTORS))


def sentences_on_watched_lights(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns a sentence on each status light that has the level "watch" in one log and "good" in the other.

    A status light is the judgement of one subject. Those of wind and log are left out, since they judge the day and the
    recording and not the vehicle; that of the motors has a sentence of its own (:func:`_sentence_on_motors`). Lights
    that became worse come first.

    Args:
        reviews: review documents of both logs, by side, "A" and "B". A document without lights, such as the review of a
            fleet, is compared with nothing.
    """
    worse_lights, better_lights = _sentences_on_watched_lights_by_change(reviews)
    return [*worse_lights, *better_lights]


class _WorseAndBetterLights(NamedTuple):
    """Sentences on the lights that are to be watched in one log and good in the other, by what they are later."""

    worse: list[Sentence]
    """On the lights that are to be watched in the later log."""

    better: list[Sentence]
    """On the lights that are good in the later log."""


def _sentences_on_watched_lights_by_change(reviews: Mapping[str, Review]) -> _WorseAndBetterLights:
    """Returns a sentence on each light with the level "watch" in one log and "good" in the other, by its later level.

    Lights of the motors, the wind and the log are left out (:func:`sentences_on_watched_lights`).

    Args:
        reviews: review documents of both logs, by side, "A" and "B". The later one is that of the later date, or "B".
    """
    later = later_side(reviews)
    sentences = _WorseAndBetterLights(worse=[], better=[])
    for name, lights_by_side in lights_of_both(reviews).items():
        if name in (Light.MOTORS, Light.WIND, Light.LOG):
            continue
        levels = {light["level"] for light in lights_by_side.values()}
        if levels != {Level.GOOD, Level.WATCH}:
            continue
        sentence = _sentence_on_watched_light(name, lights_by_side)
        if lights_by_side[later]["level"] == Level.WATCH:
            sentences.worse.append(sentence)
        else:
            sentences.better.append(sentence)
    return sentences


def _sentence_on_watched_light(name: str, lights_by_side: Mapping[str, JsonValues]) -> Sentence:
    """Returns the sentence on a light (a judgement, such as of vibration) that is "watch" in one of two logs.

    For example "good in A, watch in B", each with its reason. If the vibration of the IMUs changed, the change is
    stated instead of the reasons: "good in A, watch in B. …". But if an accelerometer clipped, the reasons stay, since
    they state the clips.

    Args:
        name: name of the light, such as "vibration".
        lights_by_side: the light in the review document of each log, by side, "A" and "B".
    """
    levels = []
    levels_with_reasons = []
    for side, light in lights_by_side.items():
        levels.append(f"{light['level']} in {side}")
        # The sentence begins with the name of the light, which is therefore removed from the reason.
        reason = light["sentence"].removeprefix(f"{name.capitalize()} ")
        levels_with_reasons.append(f"{levels[-1]} ({without_full_stop(reason)})")
    changes = vibration_changes(lights_by_side)
    has_clips = any(value_at(light, "figures.clips") for light in lights_by_side.values())
    if changes and not has_clips:
        text = f"{', '.join(levels)}. {changes}."
    else:
        text = f"{', '.join(levels_with_reasons)}.{remark_on_imus(lights_by_side)}"
    return Sentence(text, lead=_lead_of_light(name))


def headline_blocks(
    headlines: Mapping[str, str | None], texts_above: Collection[str] = ()
) -> Blocks:
    """Returns the headline of each log's own review, as a sentence that begins "A by itself:" or "B by itself:".

    Args:
        headlines: headline of the review of each log, by side, "A" and "B"; None for a side without one.
        texts_above: texts that stand above; a headline that one of them contains is left out.

    Returns:
        A sentence for each side; one for both sides with the same headline.
    """
    sides_by_headline = dict[str, list[str]]()
    for side, headline in headlines.items():
        if not headline:
            continue
        is_stated_above = any(headline in text for text in texts_above)
        if not is_stated_above:
            sides_by_headline.setdefault(headline, []).append(side)
    blocks = Blocks()
    for headline, sides in sides_by_headline.items():
        lead = f"{sides[0]} by itself:" if len(sides) == 1 else "Each by itself:"
        blocks.append(Sentence(headline, lead=lead))
    return blocks
