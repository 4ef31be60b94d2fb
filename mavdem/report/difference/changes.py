"""Which compared figures of two states changed, which are doubtful or uncertain, and which stayed the same."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from mavdem.containers import group_by
from mavdem.dataset.axes import AXES
from mavdem.facts import Level
from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.lights import Light
from mavdem.fleet.comparability import LOOP_FIGURE_KINDS, MARGINS
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.quantities import LOOP_KINDS, SHARE
from mavdem.fleet.random_effects import (
    FAMILIES,
    SD_BETWEEN_FLIGHTS,
    QuantityChange,
    family_of,
    significance_of_single_change,
)
from mavdem.fleet.report_columns import value_at
from mavdem.motors.change_hypotheses import FAULT_RISE
from mavdem.report.blocks import Blocks, Sentence, Table
from mavdem.report.difference.lights import (
    Review,
    bad_lights,
    lights_are_equal,
    lights_of_both,
)
from mavdem.report.difference.parameters import parameter_sentences
from mavdem.report.difference.quantity_texts import (
    SHOWN_QUANTITIES,
    bound_row,
    bound_without_lean,
    change_text,
    change_without_lean,
    detectable_change,
    texts_by_kind,
    texts_of_equal_changes,
)
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.numbers import listed
from mavdem.report.templates import (
    as_clause,
    first_sentence,
    render_section,
    without_full_stop,
)


def difference_blocks(
    reviewed: ReviewedDifference, headline: Sequence[Sentence] = ()
) -> list[Sentence]:
    """Returns sentences on all differences between two states of a vehicle, or two vehicles, with their certainty.

    They follow the headline, in this order: quantities that changed, parameters that differ, quantities without a
    change, and what could not be compared. If both states are the same flight, there are none.

    Args:
        reviewed: comparison of the two states.
        headline: sentences that are shown above; changes that they name are not repeated.
    """
    if reviewed.difference.is_of_same_flight:
        return []
    return [
        *change_sentences(reviewed, headline),
        *parameter_sentences(reviewed, headline),
        *detail_sentences(reviewed),
    ]


def detail_sentences(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the sentences that follow those on what changed.

    They name the quantities without a change, those that could not be compared, and the method of the comparison.

    Args:
        reviewed: comparison of two states of a vehicle, quantity by quantity.
    """
    difference = reviewed.difference
    sentences = sentences_without_change(reviewed)
    # If nothing at all was compared, the sentences above name the missing quantities already.
    if difference.changes:
        sentences += sentences_on_missing_quantities(difference)
    doubtful = doubtful_changes(reviewed)
    surest_p = doubtful[0].p if doubtful else None
    sentences_on_method = render_section(
        "difference",
        difference,
        # Assumed standard deviation of each kind of quantity between flights of an unchanged vehicle.
        between=SD_BETWEEN_FLIGHTS,
        tested_count=len(difference.tested),
        # Quantities are tested in groups of one subject, such as the motors.
        families=difference.tested_families,
        are_two_vehicles=reviewed.are_two_vehicles,
        surest_p=surest_p,
        chance_of_any=_chance_of_any(surest_p, difference),
    )
    return [*sentences, *sentences_on_method]


def sentences_on_missing_quantities(difference: VehicleDifference) -> list[Sentence]:
    """Returns the sentences on figures that could not be compared, such as margins that one side does not have.

    Args:
        difference: comparison of two states, with the reason for each missing figure.

    Returns:
        A sentence for each reason, which begins with the names of the figures; none if all could be compared.
    """
    missing_by_reason = group_by(difference.incomparable, lambda missing: missing.reason)
    sentences = []
    for reason, missing_quantities in missing_by_reason.items():
        names = listed(missing.quantity for missing in missing_quantities)
        sentences.append(Sentence(f"{names}: {reason}", "Not compared:"))
    return sentences


def changes_by_relevance(
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


class ChangesByCause(NamedTuple):
    """Changed quantities, by whether the changed gains of their control loop explain them."""

    unexplained: list[QuantityChange]
    """Changes that may be signs of a fault."""

    by_gains: list[QuantityChange]
    """Changes of figures of a rate loop whose gains or filters are known to differ."""

    by_lean: list[QuantityChange]
    """Changes of trims that another lean explains."""


def changes_by_cause(
    difference: VehicleDifference, changes: Iterable[QuantityChange]
) -> ChangesByCause:
    """Separates the changes that follow from new gains or another lean from those that may be signs of a fault.

    Args:
        difference: comparison of two groups of flights, which knows the changed gains.
        changes: changed quantities; their order is kept in each group.
    """
    separated = ChangesByCause(unexplained=[], by_gains=[], by_lean=[])
    for change in changes:
        if difference.follows_from_gains(change):
            separated.by_gains.append(change)
        elif change.is_explained_by_lean:
            separated.by_lean.append(change)
        else:
            separated.unexplained.append(change)
    return separated


def doubtful_changes(reviewed: ReviewedDifference) -> list[QuantityChange]:
    """Returns the tested quantities whose change is doubtful, the most certain first.

    A change is doubtful if the quantity's own interval excludes "no change", but the test of all quantities together
    does not confirm it. The evidence of a weak motor is left out, since the sentence on that motor quotes it, and so
    are trims that lean explains.

    Args:
        reviewed: comparison of two states.
    """
    doubtful = []
    for change in reviewed.difference.tested:
        is_evidence = change in reviewed.motors.evidence
        if change.is_doubtful and not is_evidence and not change.is_explained_by_lean:
            doubtful.append(change)
    return sorted(doubtful, key=lambda change: change.p)


def trims_explained_by_lean(reviewed: ReviewedDifference) -> list[QuantityChange]:
    """Returns the changes of motors' trims that come only from another lean of the vehicle, such as in other wind.

    Changes that agree with a weak motor are left out, since the sentence on that motor quotes them.

    Args:
        reviewed: comparison of two states.
    """
    evidence = reviewed.motors.evidence
    changes = reviewed.difference.changes
    return [change for change in changes if change.is_explained_by_lean and change not in evidence]


def _text_with_lean(change: QuantityChange, difference: VehicleDifference) -> str:
    """Returns a trim that lean explains, such as "motor 4's relative trim −9 % (…), without lean −0 % (…)".

    Args:
        change: change of a trim that is known without lean.
        difference: comparison of the vehicle, with the names of its motors.
    """
    return f"{change_text(change, difference)}, {change_without_lean(change)}"


def largest_of_first_kind(changes: Sequence[QuantityChange]) -> QuantityChange | None:
    """Returns the change that a headline names: the largest of those of the same kind as the first, such as trims.

    Changes of different kinds, such as a trim and a phase margin, have no common scale.

    Args:
        changes: changed quantities, the most relevant first.

    Returns:
        The change; None without any.
    """
    if not changes:
        return None
    of_first_kind = [
        change for change in changes if change.quantity.kind == changes[0].quantity.kind
    ]
    return max(of_first_kind, key=lambda change: abs(change.tested_difference))


def _is_below_weak_motor(change: QuantityChange) -> bool:
    """Returns whether a motor's trim changed by less than that of a weak motor would; False for other quantities."""
    return change.quantity.kind == SHARE and abs(change.difference) < FAULT_RISE


def fault_probability_beside_doubtful_trims(
    reviewed: ReviewedDifference, doubtful: Iterable[QuantityChange]
) -> float | None:
    """Returns the probability of a weak motor by all trims together, where single trims are doubtful.

    Args:
        reviewed: comparison of two states, with the judgement of their motors.
        doubtful: the doubtful changes.

    Returns:
        The probability. None if no trim is doubtful, if a motor is known to be weak, or if the motors were not judged.
    """
    are_trims_doubtful = any(change.quantity.kind == SHARE for change in doubtful)
    if are_trims_doubtful and not reviewed.motors.is_weak:
        return reviewed.motors.fault_probability
    return None


def result_sentences(
    reviewed: ReviewedDifference,
    changes: Sequence[QuantityChange],
    *,
    has_difference_above: bool = False,
) -> list[Sentence]:
    """Returns one sentence with the result of a comparison: the change that matters most, or that nothing changed.

    Of two changes it names both, of more the number of the others. The largest of the doubtful changes is named after
    them or, if nothing changed for sure, in their place. Doubtful trims are not named beside a motor that is known to
    be weak: that was found by all trims together. If there is no doubtful change either, the sentence says how many
    figures were compared, and how many are too uncertain.

    Args:
        reviewed: comparison of two states, quantity by quantity.
        changes: the changed quantities, the most relevant first, without those that are evidence for a weak motor.
        has_difference_above: whether the sentences before say that a status light or the output of all motors differs:
            a change of a quantity is then called a further one.
    """
    difference = reviewed.difference
    causes = changes_by_cause(difference, changes)
    by_lean = trims_explained_by_lean(reviewed)
    doubtful = _doubtful_changes_to_name(reviewed)
    # Doubtful changes take the place of confirmed ones if there are none.
    candidates = causes.unexplained or doubtful
    main_change = largest_of_first_kind(candidates)
    further_changes = [change for change in candidates if change is not main_change]
    largest_doubtful = largest_of_first_kind(doubtful) if causes.unexplained else None
    return render_section(
        "difference_conclusion",
        change="" if main_change is None else change_text(main_change, difference),
        further_changes=[change_text(change, difference) for change in further_changes],
        is_doubtful=not causes.unexplained,
        has_doubt=bool(doubtful_changes(reviewed)),
        doubtful="" if largest_doubtful is None else change_text(largest_doubtful, difference),
        fault_rise=FAULT_RISE,
        by_lean=[_text_with_lean(change, difference) for change in by_lean],
        has_changes_by_lean=bool(causes.by_lean),
        fault_probability=fault_probability_beside_doubtful_trims(reviewed, [*doubtful, *by_lean]),
        excludes_weak_motor=reviewed.motors.excludes_weak_motor,
        is_below_weak_motor=main_change is not None and _is_below_weak_motor(main_change),
        has_changes_by_gains=bool(causes.by_gains),
        has_bad_light=bool(bad_lights(reviewed.reviews)),
        has_motor_difference=reviewed.motors.differs,
        has_difference_above=has_difference_above,
        are_two_vehicles=reviewed.are_two_vehicles,
        **_extent_of_comparison(reviewed),
    )


def _extent_of_comparison(reviewed: ReviewedDifference) -> dict[str, Any]:
    """Returns how many figures were compared, and what changes may not show, by the names in the result's template.

    Args:
        reviewed: comparison of two states, quantity by quantity.
    """
    difference = reviewed.difference
    outcomes = _outcome_counts(difference.changes, reviewed)
    # Of some figures it was not tested whether they changed.
    tested_outcomes = _outcome_counts(difference.tested, reviewed)
    return {
        "uncertain_count": outcomes[QuantityOutcome.UNCERTAIN],
        "same_count": outcomes[QuantityOutcome.SAME],
        "count": tested_outcomes.total(),
        "untested_count": len(difference.changes) - len(difference.tested),
        "limits_of_detection": _limits_of_detection(reviewed),
        "limit_without_lean": _limit_of_trims_without_lean(difference.tested),
        "unsure_count": tested_outcomes[QuantityOutcome.UNCERTAIN],
        "families": difference.tested_families,
        "subjects_not_compared": _subjects_with_reasons(reviewed),
        "has_figures": bool(difference.changes),
    }


def _doubtful_changes_to_name(reviewed: ReviewedDifference) -> list[QuantityChange]:
    """Returns the doubtful changes, without trims if a motor is named as weak: that was found by all trims together.

    Args:
        reviewed: comparison of two states, with the judgement of their motors.
    """
    is_motor_weak = bool(reviewed.motors.suspects)
    doubtful = []
    for change in doubtful_changes(reviewed):
        is_trim = change.quantity.kind == SHARE
        if not (is_motor_weak and is_trim):
            doubtful.append(change)
    return doubtful


def _outcome_counts(
    changes: Iterable[QuantityChange], reviewed: ReviewedDifference
) -> Counter[QuantityOutcome]:
    """Counts how many of some compared quantities changed, stayed the same, or are uncertain.

    Those of a motor that is named as weak and trims that lean explains do not count: they have their own sentences.

    Args:
        changes: changes of compared quantities.
        reviewed: comparison of two states, with the judgement of their motors.
    """
    with_own_sentence = [*reviewed.motors.evidence, *trims_explained_by_lean(reviewed)]
    outcomes = Counter[QuantityOutcome]()
    for change in changes:
        if change not in with_own_sentence and not reviewed.motors.covers(change):
            outcomes[change.outcome] += 1
    return outcomes


def _limits_of_detection(reviewed: ReviewedDifference) -> list[str]:
    """Returns the smallest change that would be found, of each kind of quantity, such as "17 % (relative trim)".

    Args:
        reviewed: comparison of two states, quantity by quantity.
    """
    tested = reviewed.difference.tested
    limits = []
    for kind, changes in group_by(tested, lambda change: change.quantity.kind).items():
        significance = significance_of_single_change(tested, kind)
        limit = detectable_change(kind, changes, significance)
        limits.append(f"{limit} ({SHOWN_QUANTITIES[kind].name})")
    return limits


def _limit_of_trims_without_lean(tested_changes: Sequence[QuantityChange]) -> str:
    """Returns by how much the motors' trims may have changed unseen, such as "10 %", without the part that lean makes.

    If the vehicle leaned differently, as in other wind, the 90 % intervals of the trims are wide. Those of the trims
    without lean stay narrow: the limit is the largest change that one of them contains.

    Args:
        tested_changes: changes of the tested quantities.

    Returns:
        The limit. It is empty if that of the trims themselves is smaller, if a trim is not known without lean or
        changed without it, and if other quantities than trims were tested.
    """
    for change in tested_changes:
        trim_without_lean = change.without_lean
        if trim_without_lean is None or not trim_without_lean.interval_contains_zero:
            return ""
        if trim_without_lean.largest_difference >= change.largest_difference:
            return ""
    return bound_without_lean(tested_changes) if tested_changes else ""


def subjects_not_compared(reviewed: ReviewedDifference) -> list[str]:
    """Lists what could not be compared between two states of a vehicle: families of figures, gains and parameters.

    A family is a group of figures of one subject, such as all figures of the control loops.

    Args:
        reviewed: comparison of two states.

    Returns:
        Names such as "loops" and "gains", in the order of the families; empty if a figure of each family and the
        parameters were compared.
    """
    compared_families = {family_of(change.quantity.kind) for change in reviewed.difference.changes}
    subjects = [family for family in FAMILIES if family not in compared_families]
    if reviewed.sides_without_parameters or reviewed.renamed_gain is not None:
        subjects.append("gains")
    if not reviewed.common_parameter_count:
        subjects.append("other parameters" if "gains" in subjects else "parameters")
    return subjects


def _subjects_with_reasons(reviewed: ReviewedDifference) -> list[str]:
    """Returns what could not be compared, families of figures with the reason in brackets where one is known.

    Args:
        reviewed: comparison of two states, with the reviews of their logs.

    Returns:
        Texts such as "loops (margins do not show at 9.8 Hz: attitude, body rates and motors need 40 Hz)".
    """
    reasons = {
        "physical parameters": _reason_without_physical_parameters(reviewed.difference),
        "loops": _reason_without_loops(reviewed.reviews),
    }
    texts = []
    subjects = subjects_not_compared(reviewed)
    for subject in subjects:
        reason = reasons.get(subject)
        texts.append(f"{subject} ({reason})" if reason else subject)
    if "loops" not in subjects:
        texts += _axes_without_margins_of_both(reviewed)
    return texts


def _axes_without_margins_of_both(reviewed: ReviewedDifference) -> list[str]:
    """Returns the axes whose margins are not known in both logs, with the reason.

    An example is "margins on pitch (B: the motors do not excite the axis enough)". Of several axes with different
    reasons only the sides are named, as in "margins on roll (not known in A)": the list of all figures has the reasons.

    Args:
        reviewed: comparison of two states, with the reviews of their logs.
    """
    texts = []
    brief_texts = []
    for missing in reviewed.difference.incomparable:
        if missing.quantity.figures.get("name") == MARGINS:
            reasons = []
            sides = []
            for fact in missing.reason.figures["reasons"]:
                side = fact.subject
                sides.append(side)
                reason = missing_margins_reason(reviewed.reviews, side, missing.quantity.subject)
                reasons.append(f"{side}: {reason}" if reason else str(fact))
            texts.append(f"{missing.quantity} ({'; '.join(reasons)})")
            brief_texts.append(f"{missing.quantity} (not known in {listed(sides)})")
    return brief_texts if len(texts) > 1 else texts


def missing_margins_reason(reviews: Mapping[str, Review], side: str, axis: str) -> str:
    """Returns why a log has no margins of an axis, as a clause; empty if its review gives no reason.

    Args:
        reviews: review documents of both logs, by side.
        side: the side without these margins, "A" or "B".
        axis: "roll", "pitch" or "yaw".
    """
    refusal = value_at(reviews.get(side, {}), f"axes.{axis}.refusal.sentence") or ""
    reason = first_sentence(refusal).removeprefix("No margins: ")
    return without_full_stop(as_clause(reason)) if reason else ""


def _reason_without_physical_parameters(difference: VehicleDifference) -> str:
    """Returns why no physical parameter was compared, as a clause; empty if it is not the same reason for all."""
    reasons = set()
    for missing in difference.incomparable:
        if missing.quantity.figures.get("name") not in LOOP_FIGURE_KINDS:
            reasons.add(without_full_stop(str(missing.reason)))
    return reasons.pop() if len(reasons) == 1 else ""


def _reason_without_loops(reviews: Mapping[str, Review]) -> str:
    """Returns why the loops of a log have no margins, as its light of the margins says; empty if both logs have them.

    Args:
        reviews: review documents of both logs, by side. The first side with an unknown light gives the reason.
    """
    lights = lights_of_both(reviews).get(Light.MARGINS, {})
    for side, light in lights.items():
        if light["level"] == Level.UNKNOWN:
            clause = without_full_stop(as_clause(first_sentence(light["sentence"])))
            is_common = lights_are_equal(*lights.values())
            return clause if is_common else f"{side}: {clause}"
    return ""


def change_sentences(
    reviewed: ReviewedDifference, headline: Sequence[Sentence] = ()
) -> list[Sentence]:
    """Returns the sentences on what changed between two states of a vehicle, such as before and after a repair.

    Up to three list the changes that nothing explains, those that other gains explain, and those that are doubtful.
    If no quantity could be compared, the sentences say why.

    Args:
        reviewed: comparison of two states, quantity by quantity.
        headline: sentences that head the comparison; changes that they name are left out.
    """
    difference = reviewed.difference
    if not difference.changes:
        return sentences_on_missing_quantities(difference)
    motors = reviewed.motors
    causes = changes_by_cause(difference, changes_by_relevance(difference, without=motors.evidence))
    # The headline names one change, and how many others there are.
    texts_above = " ".join(sentence.text for sentence in headline)
    texts_of_changes = [change_text(change, difference) for change in causes.unexplained]
    further_texts = _texts_not_above(texts_of_changes, texts_above)
    # The headline may name some of these without their intervals: all of them stand here with theirs.
    texts_by_gains = [change_text(change, difference) for change in causes.by_gains]
    doubtful = _doubtful_changes_without_sentence(reviewed)
    texts_of_doubtful = [change_text(change, difference) for change in doubtful]
    further_doubtful = _texts_not_above(texts_of_doubtful, texts_above)
    is_doubt_above = len(further_doubtful) < len(texts_of_doubtful)
    # A headline that names a doubtful change also says what all trims together show.
    fault_probability = None
    if not is_doubt_above:
        fault_probability = fault_probability_beside_doubtful_trims(reviewed, doubtful)
    return render_section(
        "difference_changes",
        changed=further_texts,
        are_all_listed=len(further_texts) == len(texts_of_changes),
        by_gains=texts_by_gains,
        axes=[axis for axis in AXES if axis in difference.axes_with_changed_loops],
        doubtful=further_doubtful,
        is_doubt_above=is_doubt_above,
        fault_rise=FAULT_RISE,
        fault_probability=fault_probability,
        excludes_weak_motor=motors.excludes_weak_motor,
        are_two_vehicles=reviewed.are_two_vehicles,
    )


def _texts_not_above(texts: Iterable[str], texts_above: str) -> list[str]:
    """Returns the texts that do not stand above already.

    Args:
        texts: texts on changes, such as "phase margin on roll 29 → 42°".
        texts_above: all that stands above, as one text.
    """
    return [text for text in texts if text not in texts_above]


def _doubtful_changes_without_sentence(reviewed: ReviewedDifference) -> list[QuantityChange]:
    """Returns the doubtful changes of which no other sentence speaks.

    The sentences on weak motors quote the changes that are evidence of them, and the result those by lean.

    Args:
        reviewed: comparison of two states, quantity by quantity.
    """
    stated_changes = [*reviewed.motors.evidence, *trims_explained_by_lean(reviewed)]
    doubtful = []
    for change in reviewed.difference.changes:
        if change.is_doubtful and change not in stated_changes:
            doubtful.append(change)
    return doubtful


def _chance_of_any(p_value: float | None, difference: VehicleDifference) -> float | None:
    """Returns the probability that at least one of so many independent quantities has such a p-value by chance.

    Args:
        p_value: the p-value of one quantity; None without one.
        difference: comparison of two states, whose tested quantities are counted.
    """
    if p_value is None:
        return None
    return 1.0 - (1.0 - p_value) ** len(difference.tested)


def sentences_without_change(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the sentences on the quantities of a vehicle that were compared and show no change.

    Uncertain quantities come first: their interval is so wide that it contains both "no change" and a change that
    matters. They are left out if another section names them, which holds for doubtful changes and for evidence of a
    weak motor. The quantities that are certainly the same in both states follow. If a trim of a motor was compared,
    the first sentence says what a trim is.

    Args:
        reviewed: comparison of two states of a vehicle, or of two vehicles, quantity by quantity.
    """
    difference = reviewed.difference
    uncertain_changes = []
    for change in difference.changes_with(QuantityOutcome.UNCERTAIN):
        is_named_elsewhere = change.is_doubtful or reviewed.motors.covers(change)
        if not is_named_elsewhere:
            uncertain_changes.append(change)
    uncertain_sentences = render_section(
        "difference_uncertain",
        uncertain=list(texts_of_equal_changes(uncertain_changes, difference)),
        are_two_vehicles=reviewed.are_two_vehicles,
        is_since_baseline=reviewed.is_since_baseline,
        has_trims=any(change.quantity.kind == SHARE for change in difference.changes),
    )
    unchanged_quantities = []
    for change in difference.changes_with(QuantityOutcome.SAME):
        # The mean over several flights may hide what the last one shows of a weak motor.
        if not reviewed.motors.covers(change):
            unchanged_quantities.append(change)
    return [*uncertain_sentences, *unchanged_quantity_sentences(unchanged_quantities)]


def explained_bounds(reviewed: ReviewedDifference) -> Blocks:
    """Returns a table of how large changes may have been missed, with a sentence on what its columns mean.

    Args:
        reviewed: comparison of two states, quantity by quantity.

    Returns:
        The table of :func:`undetected_change_table` and the sentence; empty without a table.
    """
    table = undetected_change_table(reviewed)
    if not table:
        return []
    return [*table, *render_section("difference_bounds")]


def undetected_change_table(reviewed: ReviewedDifference) -> list[Table]:
    """Returns a table of how large a change of the vehicle may have been missed, where the comparison found none.

    A row is about one kind of quantity, such as the phase margin, and has two limits: the largest change that the 90 %
    intervals of these quantities still contain, and the change that nine of ten such comparisons would find. Figures of
    a motor that is named as weak are left out. Trims without lean have a row if they are known better than with it.

    Args:
        reviewed: comparison of two states, quantity by quantity.

    Returns:
        A list with the table; empty if a tested quantity changed or is doubtful, or if nothing else was tested.
    """
    tested_changes = reviewed.difference.tested
    if not tested_changes:
        return []
    for change in tested_changes:
        if change.outcome is QuantityOutcome.CHANGED or change.is_doubtful:
            return []
    other_changes = [change for change in tested_changes if not reviewed.motors.covers(change)]
    changes_by_kind = group_by(other_changes, lambda change: change.quantity.kind)
    rows = []
    for kind, changes_of_kind in changes_by_kind.items():
        significance_level = significance_of_single_change(tested_changes, kind)
        rows.append(bound_row(kind, changes_of_kind, significance_level))
    limit_without_lean = _limit_of_trims_without_lean(other_changes)
    if limit_without_lean:
        rows.append(["relative trims without lean", f"±{limit_without_lean}", "not tested"])
    header = ["no change found in", "within (90 %)", "found from (9 of 10)"]
    return [Table(header, rows)] if rows else []


def unchanged_quantity_sentences(quantities: Sequence[QuantityChange]) -> list[Sentence]:
    """Returns the sentence that lists the quantities that did not change between two states of a vehicle.

    Args:
        quantities: the quantities, such as the phase margin of an axis, each compared with the result "no change".

    Returns:
        A list with the sentence, in which quantities of the same kind stand together; empty without quantities.
    """
    return render_section("difference_same", same=list(texts_by_kind(quantities)))
