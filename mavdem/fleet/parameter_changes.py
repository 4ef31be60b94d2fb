"""Autopilot parameters that a person, not the autopilot itself, changed between two states of a vehicle."""

import re
from collections.abc import Iterable
from math import isclose
from typing import NamedTuple

from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import (
    ATTITUDE_GAIN,
    AUTOPILOT_SET_PARAMETERS,
    AXIS_RATE_LOOP_PARAMETERS,
    CONTROL_PARAMETERS,
    RATE_GAIN,
)

RELATIVE_ROUNDING = 1e-6
"""Relative difference of two values up to which they are equal: logs and parameter files round float32 differently."""

PARAMETER_NAMES_OF_AXES = {
    "roll": re.compile("RLL|ROLL"),
    "pitch": re.compile("PIT"),
    "yaw": re.compile("YAW"),
}
"""What names of ArduPilot's and PX4's parameters contain that belong to one axis."""


class ParameterChange(NamedTuple):
    """A parameter of the autopilot that was set to another value."""

    name: str
    """The autopilot's name of the parameter."""

    before: float
    """Value in the first state."""

    after: float
    """Value in the second state."""


class RenamedGain(NamedTuple):
    """The proportional gain of the roll rate in two states of which each has another name for it.

    Versions of ArduPilot, and ArduPilot and PX4, name and scale the gains of the rate controllers differently.
    """

    name_before: str
    """Its name in the first state."""

    before: float
    """Value in the first state."""

    name_after: str
    """Its name in the second state."""

    after: float
    """Value in the second state."""


def changed_parameters(before: Parameters, after: Parameters) -> list[ParameterChange]:
    """Returns the autopilot parameters that somebody set to other values between two states.

    Parameters that the autopilot itself sets, such as statistics, are left out. So are parameters that only one of the
    states has, since logs need not hold all parameters.

    Args:
        before: values by the autopilot's name, in the first state.
        after: values in the second state.

    Returns:
        The changes: parameters of control first, each part in the order of names.
    """
    changes = _changes_of(compared_parameters(before, after), before, after)

    def control_first(change: ParameterChange) -> tuple[bool, str]:
        """Returns the key by which changes are sorted: parameters of control first, then by name."""
        is_of_control = CONTROL_PARAMETERS.match(change.name) is not None
        return not is_of_control, change.name

    return sorted(changes, key=control_first)


def parameters_changed_by_autopilot(before: Parameters, after: Parameters) -> list[ParameterChange]:
    """Returns the parameters that the autopilot itself set to other values, such as the learned throttle of hover.

    Args:
        before: values by the autopilot's name, in the first state.
        after: values in the second state.

    Returns:
        The changes, in the order of names.
    """
    common_names = before.keys() & after.keys()
    set_by_autopilot = [name for name in common_names if AUTOPILOT_SET_PARAMETERS.search(name)]
    return sorted(_changes_of(set_by_autopilot, before, after))


def _changes_of(
    names: Iterable[str], before: Parameters, after: Parameters
) -> list[ParameterChange]:
    """Returns those of the named parameters, which both states have, that have different values, in the given order."""
    changes = []
    for name in names:
        if not isclose(before[name], after[name], rel_tol=RELATIVE_ROUNDING):
            changes.append(ParameterChange(name, before[name], after[name]))
    return changes


def compared_parameters(before: Parameters, after: Parameters) -> list[str]:
    """Returns the names of the parameters that both states have, without those that the autopilot itself sets.

    Args:
        before: values by the autopilot's name, in the first state.
        after: values in the second state.
    """
    common_names = before.keys() & after.keys()
    return [name for name in common_names if not AUTOPILOT_SET_PARAMETERS.search(name)]


def axes_of_parameter(name: str) -> list[str]:
    """Returns the axes that a parameter's name contains; none where it belongs to all, such as a filter's."""
    return [axis for axis, pattern in PARAMETER_NAMES_OF_AXES.items() if pattern.search(name)]


def axes_with_other_gains(parameters: Iterable[ParameterChange]) -> Names:
    """Returns the axes whose rate loop has other gains or filters after a change of parameters.

    Args:
        parameters: parameters of the autopilot that changed.

    Returns:
        "roll", "pitch" and "yaw", in this order, as far as they are concerned. A parameter of control that names no
        axis, such as a filter of the gyro, concerns all. Limits, such as the limit of the integrator or of the
        commanded rate, and gains of the attitude controller concern no rate loop.
    """
    axes: set[str] = set()
    for parameter in parameters:
        if not CONTROL_PARAMETERS.match(parameter.name):
            continue
        named_axes = axes_of_parameter(parameter.name)
        if not named_axes:
            axes.update(AXES)
        elif AXIS_RATE_LOOP_PARAMETERS.match(parameter.name):
            axes.update(named_axes)
    return tuple(axis for axis in AXES if axis in axes)


def axes_with_other_attitude_gains(parameters: Iterable[ParameterChange]) -> Names:
    """Returns the axes whose gain from attitude to rate changed, "roll", "pitch" and "yaw" in this order.

    Args:
        parameters: parameters of the autopilot that changed.
    """
    axes: set[str] = set()
    for parameter in parameters:
        if ATTITUDE_GAIN.match(parameter.name):
            axes.update(axes_of_parameter(parameter.name))
    return tuple(axis for axis in AXES if axis in axes)


def renamed_gain(before: Parameters, after: Parameters) -> RenamedGain | None:
    """Returns the proportional gain of the roll rate if each of two states has another name for it, otherwise None.

    The gains of the rate controllers then cannot be compared, since their units differ, too: ArduCopter 3.4 renamed
    ``RATE_RLL_P`` to ``ATC_RAT_RLL_P`` and changed its scale.

    Args:
        before: values by the autopilot's name, in the first state.
        after: values in the second state.

    Returns:
        Name and value of the gain in both states. None if they have a name in common, or if one lacks the gain.
    """
    names_before = [name for name in before if RATE_GAIN.match(name)]
    names_after = [name for name in after if RATE_GAIN.match(name)]
    has_common_name = not set(names_before).isdisjoint(names_after)
    if not names_before or not names_after or has_common_name:
        return None
    name_before, name_after = names_before[0], names_after[0]
    return RenamedGain(name_before, before[name_before], name_after, after[name_after])


def states_without_gains(before: Parameters, after: Parameters) -> Names:
    """Returns the names of the states whose parameters have no gain of rate control.

    Logs need not hold all parameters. Whether the gains changed between the states is then not known.

    Args:
        before: values by the autopilot's name, in the first state, called "A".
        after: values in the second state, called "B".

    Returns:
        "A", "B", both or none.
    """
    names_without_gains = []
    for state_name, parameters in zip(STATE_NAMES, (before, after), strict=True):
        has_gains = any(RATE_GAIN.match(name) for name in parameters)
        if not has_gains:
            names_without_gains.append(state_name)
    return tuple(names_without_gains)
