"""The report on how the latest flight of a vehicle differs from its baseline, the earlier healthy flights."""

from pathlib import PurePath

from mavdem.facts.lights import Light
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.row import FlightRow
from mavdem.report.blocks import Blocks, Sentence
from mavdem.report.difference.changes import (
    change_sentences,
    changes_by_relevance,
    result_sentences,
    sentences_without_change,
)
from mavdem.report.difference.headline import with_evidence
from mavdem.report.difference.identity import identity_cautions
from mavdem.report.difference.motors import MotorVerdict, evidence_of_weak_motors
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.fleet import ANOMALOUS_HEALTHS
from mavdem.report.numbers import counted


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
    evidence = tuple(evidence_of_weak_motors(difference, weak_motors))
    motors = MotorVerdict(evidence, latest_row.fault_probability, is_weak=is_weak, differs=is_weak)
    reviewed = ReviewedDifference(difference, motors)
    if is_weak and latest_row.health_reason:
        sentence = Sentence(latest_row.health_reason, lead=f"{Light.MOTORS.capitalize()}:")
        blocks += with_evidence([sentence], motors, difference)
    changes = changes_by_relevance(difference, without=evidence)
    blocks += result_sentences(reviewed, changes)
    blocks += [*change_sentences(reviewed), *sentences_without_change(reviewed)]
    if has_identity_cautions:
        blocks += identity_cautions(reviewed)
    return blocks
