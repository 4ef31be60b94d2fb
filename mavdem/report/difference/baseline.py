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
        latest_row: row of the latest flight in the fleet's table: its date, its file, and the health of its motors.
        difference: comparison of the baseline (state A) with the latest flight (state B), quantity by quantity.
        has_identity_cautions: whether the reader is warned if the flights may be of several vehicles of the same name.

    Returns:
        Sentences: which flights are compared, what is wrong with the motors, whether anything else changed, all
        changes, what stayed the same or is uncertain, and cautions.
    """
    motors = _motor_verdict(latest_row, difference)
    reviewed = ReviewedDifference(difference, motors, is_since_baseline=True)
    # The sentence on a weak motor names the changes that are evidence for it, so that they are not repeated below.
    other_changes = changes_by_relevance(difference, without=motors.evidence)
    blocks: Blocks = [_sentence_on_compared_flights(latest_row, difference)]
    blocks += _sentences_on_weak_motor(latest_row, motors, difference)
    result = result_sentences(reviewed, other_changes)
    blocks += [*result, *change_sentences(reviewed, result)]
    blocks += sentences_without_change(reviewed)
    if has_identity_cautions:
        blocks += identity_cautions(reviewed)
    return blocks


def _motor_verdict(latest_row: FlightRow, difference: VehicleDifference) -> MotorVerdict:
    """Returns what is known of the motors from the health of the latest flight in the fleet's table.

    With a fault or a drift, the suspected motor counts as weak. Changes of its quantities that agree with this, such as
    a larger trim, are then evidence for the weakness and no separate findings.

    Args:
        latest_row: row of the latest flight: health of its motors, number of the suspected one, fault probability.
        difference: comparison of the baseline (state A) with the latest flight (state B).
    """
    is_weak = latest_row.health in ANOMALOUS_HEALTHS
    _, side_of_latest_flight = STATE_NAMES
    weak_motors = {}
    if is_weak:
        weak_motors[side_of_latest_flight] = latest_row.suspect_motor
    return MotorVerdict(
        evidence=tuple(evidence_of_weak_motors(difference, weak_motors)),
        fault_probability=latest_row.fault_probability,
        is_weak=is_weak,
        # All flights of the baseline are healthy: the states are judged differently if the latest flight is not.
        differs=is_weak,
        suspects=tuple(number for number in weak_motors.values() if number is not None),
    )


def _sentence_on_compared_flights(latest_row: FlightRow, difference: VehicleDifference) -> Sentence:
    """Returns the first sentence, such as "the latest flight, a.ulg (2024-05-01), compared with 6 flights.".

    Args:
        latest_row: row of the latest flight in the fleet's table, with its file and, if it is known, its date.
        difference: comparison of the baseline with the latest flight, with the number of logs in the baseline.
    """
    latest_log = PurePath(latest_row.file).name
    if latest_row.date is not None:
        latest_log += f" ({latest_row.date:%Y-%m-%d})"
    baseline_logs = counted(difference.flights.before, "log")
    text = f"the latest log, {latest_log}, compared with {baseline_logs}."
    return Sentence(text, lead="Since the baseline:")


def _sentences_on_weak_motor(
    latest_row: FlightRow, motors: MotorVerdict, difference: VehicleDifference
) -> list[Sentence]:
    """Returns the sentence on how the motors differ from the motors in healthy flights, and the changes that show it.

    Args:
        latest_row: row of the latest flight in the fleet's table, with the reason for the health of its motors.
        motors: what is known of the motors of the latest flight.
        difference: comparison of the baseline with the latest flight, with the names of the motors.

    Returns:
        A list with the sentence; empty if the motors are not weak, or if the table has no reason.
    """
    if not motors.is_weak or not latest_row.health_reason:
        return []
    sentence = Sentence(latest_row.health_reason, lead=f"{Light.MOTORS.capitalize()}:")
    return with_evidence([sentence], motors, difference)
