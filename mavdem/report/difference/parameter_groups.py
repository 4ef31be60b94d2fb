"""Changed parameters counted by what they set, such as the filters of the gyro: many of them have no room by name."""

import re
from collections.abc import Sequence

from mavdem.containers import group_by
from mavdem.dataset.axes import AXES
from mavdem.fleet.parameter_changes import ParameterChange, axes_of_parameter
from mavdem.ingest.vocabulary import (
    ATTITUDE_GAIN,
    AXIS_RATE_LOOP_PARAMETERS,
    OUTPUT_RANGE_PARAMETERS,
)
from mavdem.report.templates import render_section

RATE_LOOP = "rate loop"
ATTITUDE = "attitude"
OTHER = "other"
PARAMETER_GROUPS = {
    RATE_LOOP: AXIS_RATE_LOOP_PARAMETERS,
    ATTITUDE: ATTITUDE_GAIN,
    "integrator limits": re.compile(r"(ATC_RAT|RATE)_(RLL|PIT|YAW)_IMAX$|MC_[RPY]R_INT_LIM$"),
    "gyro filter": re.compile("INS_GYRO_FILTER$|IMU_D?GYRO_CUTOFF$|MC_DTERM_CUTOFF$"),
    "notch filters": re.compile(r"INS_(HNTC|NOTCH)|FILT\d_|IMU_GYRO_(NF|DNF_)"),
    "thrust curve": re.compile("MOT_THST_EXPO$|THR_MDL_FAC$"),
    "output range": OUTPUT_RANGE_PARAMETERS,
}
"""What the names of parameters begin with that set one thing, by that thing, in the order in which it is named."""


def parameter_group_texts(parameters: Sequence[ParameterChange]) -> list[str]:
    """Returns the changed parameters as texts by group, such as "13 more gains and filters (roll and pitch)".

    Args:
        parameters: changed parameters that are not named one by one.

    Returns:
        A text for each group; the last one counts the parameters of no group.
    """
    parameters_by_group = group_by(parameters, lambda parameter: _group_of(parameter.name))
    texts = []
    for group in (*PARAMETER_GROUPS, OTHER):
        members = parameters_by_group.get(group, [])
        axes = {axis for member in members for axis in axes_of_parameter(member.name)}
        sentences = render_section(
            "difference_parameter_group",
            group=group,
            count=len(members),
            axes=[axis for axis in AXES if axis in axes],
        )
        texts += [sentence.text for sentence in sentences]
    return texts


def _group_of(name: str) -> str:
    """Returns the group that a parameter of this name belongs to; ``OTHER`` if it is none of ``PARAMETER_GROUPS``."""
    for group, pattern in PARAMETER_GROUPS.items():
        if pattern.match(name):
            return group
    return OTHER
