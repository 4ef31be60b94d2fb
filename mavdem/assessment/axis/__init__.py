"""Analysis: all that a log says of one vehicle and axis, in one call."""

from mavdem.assessment.axis.analysis import Options, analyse
from mavdem.assessment.axis.figures import AxisFigures, LogAnalysis

__all__ = ["AxisFigures", "LogAnalysis", "Options", "analyse"]
