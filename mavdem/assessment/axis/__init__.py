"""What a log shows of one vehicle and axis: the model and its grades, physical parameters, loops and responses."""

from mavdem.assessment.axis.analysis import Options, analyse
from mavdem.assessment.axis.figures import AxisFigures, LogAnalysis

__all__ = ["AxisFigures", "LogAnalysis", "Options", "analyse"]
