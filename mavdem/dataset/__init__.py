"""The aligned dataset: from one vehicle's Telemetry to a uniformly sampled Flight, or the reason why not."""

from mavdem.dataset.flights import read_flight, read_segments

__all__ = ["read_flight", "read_segments"]
