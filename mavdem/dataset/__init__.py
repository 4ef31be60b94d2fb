"""The aligned dataset: from one vehicle's Telemetry to a uniformly sampled Flight, or the reason why not."""
