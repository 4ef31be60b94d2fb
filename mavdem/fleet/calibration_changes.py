"""Which sensors were calibrated between two states of a vehicle, by the parameters that hold their calibrations.

A person starts a calibration, so that it is news beside what the autopilot counts or learns by itself.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from mavdem.containers import Names
from mavdem.fleet.parameter_changes import ParameterChange
from mavdem.ingest.vocabulary import CALIBRATED_OR_LEARNED_PARAMETERS, CALIBRATION_PARAMETERS


class CalibrationChanges(NamedTuple):
    """What was calibrated between two states of a vehicle, as far as changed parameters show it."""

    calibrated: Names
    """What a person calibrated, such as "accelerometers" and "radio"."""

    calibrated_count: int
    """Number of changed parameters that hold the calibration of these."""

    calibrated_or_learned: Names
    """What was either calibrated or learned in flight, such as the offsets of the compass."""

    calibrated_or_learned_count: int
    """Number of changed parameters of these."""

    other_count: int
    """Number of all other changed parameters: counters, and what the autopilot measures or learns by itself."""


def calibration_changes(changes: Iterable[ParameterChange]) -> CalibrationChanges:
    """Returns what was calibrated between two states, by the parameters that the autopilot itself set to other values.

    A sensor with a parameter that only a calibration sets was calibrated. With other parameters alone, such as the
    offsets of a compass, it may have been learned in flight instead.

    Args:
        changes: the changed parameters (``parameters_changed_by_autopilot``).
    """
    # Numbers of changed parameters, by what they calibrate.
    certain_counts = Counter[str]()
    possible_counts = Counter[str]()
    other_count = 0
    for change in changes:
        certain_subject = _subject_of(change.name, CALIBRATION_PARAMETERS)
        possible_subject = _subject_of(change.name, CALIBRATED_OR_LEARNED_PARAMETERS)
        if certain_subject:
            certain_counts[certain_subject] += 1
        elif possible_subject:
            possible_counts[possible_subject] += 1
        else:
            other_count += 1
    # What was calibrated for certain has its other parameters from that calibration, too.
    for subject in certain_counts:
        certain_counts[subject] += possible_counts.pop(subject, 0)
    return CalibrationChanges(
        calibrated=tuple(name for name in CALIBRATION_PARAMETERS if name in certain_counts),
        calibrated_count=certain_counts.total(),
        calibrated_or_learned=tuple(
            name for name in CALIBRATED_OR_LEARNED_PARAMETERS if name in possible_counts
        ),
        calibrated_or_learned_count=possible_counts.total(),
        other_count=other_count,
    )


def _subject_of(parameter_name: str, patterns: Mapping[str, re.Pattern[str]]) -> str:
    """Returns what a parameter calibrates, such as "compass"; empty if no pattern matches its name.

    Args:
        parameter_name: the autopilot's name of the parameter.
        patterns: patterns of the names of parameters, by what these calibrate.
    """
    for subject, pattern in patterns.items():
        if pattern.match(parameter_name):
            return subject
    return ""
