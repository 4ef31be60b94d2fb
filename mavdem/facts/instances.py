"""Facts about each instance of a vehicle's batteries, estimators, sensors and outputs."""

from mavdem.facts.fact import Code


class InstanceState(Code):
    """Whether an instance measures, and whether it disagrees with others."""

    MEASURED = "instance_measured"
    CONSTANT = "instance_constant"
    REJECTED = "instance_rejected"
    WITHOUT_FIX = "instance_without_fix"
    STOOD_STILL = "instance_stood_still"
    COUNTED_ERRORS = "instance_counted_errors"
    DISAGREES = "instance_disagrees"
    GRAVITY_WRONG = "instance_gravity_wrong"
    CLIPPED = "instance_clipped"
