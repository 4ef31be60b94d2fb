"""What a log shows of one vehicle and axis: the model and its grades, physical parameters, loops and responses."""

from mavdem.assessment.axis.analysis import analyse
from mavdem.assessment.axis.figures import AxisEstimates, LogAnalysis
from mavdem.assessment.axis.options import Options

__all__ = ["AxisEstimates", "LogAnalysis", "Options", "analyse"]
