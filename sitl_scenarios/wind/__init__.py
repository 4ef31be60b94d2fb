"""Wind: what moves past the vehicle, one file a model, summed by ``Weather``."""

from sitl_scenarios.wind.weather import Weather

__all__ = ["Weather"]
