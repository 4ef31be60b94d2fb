"""Analysis: all that a log says of one vehicle and axis, in one call."""

from mavdem.analysis.log_analysis import LogAnalysis, analyse

__all__ = ["LogAnalysis", "analyse"]
