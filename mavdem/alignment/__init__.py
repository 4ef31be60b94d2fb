"""Alignment: from one vehicle's Telemetry to a uniformly sampled Flight, or the reason why not."""

from mavdem.alignment.read import read_flight, read_segments
from mavdem.alignment.trim import HoverFigures, hover, hover_figures

__all__ = ["HoverFigures", "hover", "hover_figures", "read_flight", "read_segments"]
