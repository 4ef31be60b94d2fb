"""Figures: what a result looks like, drawn with matplotlib without ``pyplot``; ``learned.plot`` has them as methods."""

from mavdem.report.figures.series import Plots

__all__ = ["Plots"]
