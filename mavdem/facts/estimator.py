"""Facts about the estimator: its filter, GPS and the compass."""

from mavdem.facts.fact import Code


class EstimatorLight(Code):
    """How well the filter's estimate and its measurements agreed in flight, and how good GPS was."""

    FILTER_AGREED = "filter_agreed"
    FILTER_DOUBTED = "filter_doubted"
    SPARE_DOUBTED = "spare_doubted"
    FIX_POOR = "fix_poor"
    FIX_MISSING = "fix_missing"
    GPS_GLITCHED = "gps_glitched"
    GPS_DOUBTED = "gps_doubted"
    MOTION_IMPOSSIBLE = "motion_impossible"
    COMPASS_DISTURBED = "compass_disturbed"
    ACCELEROMETER_WRONG = "accelerometer_wrong"
    ESTIMATOR_UNMEASURED = "estimator_unmeasured"
