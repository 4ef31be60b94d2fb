"""Analysis: all that a log says of one vehicle and axis, in one call."""

from mavdem.analysis.analysis import Options, analyse
from mavdem.analysis.figures import AxisFigures, LogAnalysis

__all__ = ["AxisFigures", "LogAnalysis", "Options", "analyse"]
