"""Parameters to load after tuning: one set for each of the next flights, and the parameter files of each set."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from mavdem.assessment.axis.lowered_gains import NO_GAINS
from mavdem.ingest.parameter_file import parameter_files
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.loops.advice import Advice, Gain
from mavdem.loops.gain_design import Stage

STAGE_HEADINGS = {
    Stage.RATE: "Stage 1, rate P, I and D: load, hover one minute, fly ten doublets, mavdem tune --axis all",
    Stage.ANGLE: "Stage 2, angle P: load, hover one minute, fly ten doublets, mavdem tune --axis all",
}
"""First line of the parameter files of each stage that is the next to be loaded."""

WAITING_HEADING = (
    "Stage 2, angle P: load after a flight with stage 1, if its log advises them again"
)
"""First line of the parameter files of the second stage, if those of the first are to be flown before."""

LOWERED_GAINS_HEADING = "Gains to lower before the next flight"
"""First line of the parameter files of gains to lower, if no other gains are set with them."""

LOWERED_GAINS_SUFFIX = ".lower"
"""End of the name of these files, before the ending."""

NOTCH_HEADING = "Notch filter, with the gains of the log"
"""First line of the parameter files of a notch filter alone."""

PRESENT_HEADING = "The values of the log, to go back to"
"""First line of the parameter files with the values that advised ones replace."""

OSCILLATING_HEADING = (
    "The values of the log, with which the vehicle oscillated: do not fly with them"
)
"""The same where these values made the vehicle oscillate."""

PRESENT_SUFFIX = ".before"
"""End of the name of these files, before the ending."""


class ParameterSet(NamedTuple):
    """Parameters that are loaded together, before one flight."""

    parameters: Parameters
    """Their values, by the autopilot's names."""
    heading: str
    """First line of their parameter files."""
    suffix: str
    """End of the name of their files, before the ending."""
    stage: Stage | None = None
    """The stage of tuning that they belong to; None for gains to lower, or for a notch filter, alone."""


def parameter_sets(
    advice_on_loops: Sequence[Advice],
    notch_parameters: Parameters,
    gains_to_lower: Mapping[str, Gain] = NO_GAINS,
) -> list[ParameterSet]:
    """Returns the parameters that may be loaded, as one set for each flight, in the order of the flights.

    Computed gains are flown stage by stage. Gains to lower and a notch filter are set with the first of them, or alone
    if no others are to be loaded. Gains that another flight is to confirm first are in no set (``Advice.is_sound``).

    Args:
        advice_on_loops: the advice on each axis whose loops are known.
        notch_parameters: parameters that set a notch filter; empty without one.
        gains_to_lower: gains of axes for which none can be computed, by the autopilot's names (:func:`lowered_gains`).
    """
    sets = list[ParameterSet]()
    # A third less of a float32 has many digits; tables and sentences show four.
    parameters_of_first_set = {
        name: float(f"{gain.set:.4g}") for name, gain in gains_to_lower.items()
    }
    parameters_of_first_set |= notch_parameters
    for stage, heading in STAGE_HEADINGS.items():
        parameters_of_stage = dict[str, float]()
        for advice in advice_on_loops:
            if advice.stage is stage and advice.is_sound:
                parameters_of_stage |= advice.parameters
        if parameters_of_stage:
            parameters_of_stage |= parameters_of_first_set
            parameters_of_first_set = {}
            # Gains of the second stage wait only if there are some of the first.
            heading_of_set = WAITING_HEADING if sets else heading
            suffix = f".stage{stage:d}"
            sets.append(ParameterSet(parameters_of_stage, heading_of_set, suffix, stage))
    if parameters_of_first_set and gains_to_lower:
        sets.append(
            ParameterSet(parameters_of_first_set, LOWERED_GAINS_HEADING, LOWERED_GAINS_SUFFIX)
        )
    elif parameters_of_first_set:
        sets.append(ParameterSet(parameters_of_first_set, NOTCH_HEADING, ".notch"))
    return sets


def stage_to_load(advice_on_loops: Sequence[Advice]) -> Stage | None:
    """Returns the stage of tuning whose gains are loaded before the next flight, which all axes fly together.

    Args:
        advice_on_loops: the advice on each axis whose loops are known.

    Returns:
        The earliest stage of all axes: that of the rate gains before that of the angle gain; None if no gains are to be
        loaded.
    """
    sets = parameter_sets(advice_on_loops, notch_parameters={})
    return sets[0].stage if sets else None


def waits_for_stage(advice: Advice, first_stage: Stage | None) -> bool:
    """Returns whether the new gains of an axis wait for the flight with the gains of an earlier stage.

    Args:
        advice: the advice on the loops of the axis.
        first_stage: the stage whose gains are loaded before the next flight (:func:`stage_to_load`).
    """
    if first_stage is None or advice.stage is None or not advice.is_sound:
        return False
    return advice.stage > first_stage


def present_parameter_files(
    names: Iterable[str], vehicle: Telemetry, *, oscillates: bool = False
) -> dict[str, str]:
    """Returns the contents of the files with the present values of some parameters, to go back from new values to them.

    Args:
        names: names of the parameters that get new values.
        vehicle: the vehicle, with the values of its parameters at the end of the recording.
        oscillates: whether the vehicle oscillates with these values, of which the files then warn.

    Returns:
        The text of each file by the ending of its name, such as ``.before.params``; empty if the log has none of the
        parameters.
    """
    recorded_values = vehicle.present_parameters
    present_values = {}
    for name in names:
        if name in recorded_values:
            present_values[name] = recorded_values[name]
    if not present_values:
        return {}
    heading = OSCILLATING_HEADING if oscillates else PRESENT_HEADING
    text_by_format = parameter_files(present_values, vehicle, heading)
    return {f"{PRESENT_SUFFIX}{ending}": text for ending, text in text_by_format.items()}
