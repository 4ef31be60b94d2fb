"""The autopilot's parameters as they were during a flight: a pilot may have changed them before or after it."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf, isfinite
from typing import NamedTuple, Self

from mavdem.containers import Names
from mavdem.dataset.segments import Segment, Segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.immutable import ReadOnlyDict
from mavdem.ingest.mavlink.payloads import decoded_parameters
from mavdem.ingest.mavlink.vehicles import parameter_reports
from mavdem.ingest.telemetry import Parameters, Telemetry


class BootTime(NamedTuple):
    """A time of one boot; the earlier boot comes first in order."""

    boot: int
    """Number of the boot; -1 for what was set before the log."""
    time: float
    """Time on the boot clock, s."""


BEFORE_LOG = BootTime(-1, -inf)
"""The time of the values with which a log begins."""


class ParameterSetting(NamedTuple):
    """A value that a parameter had from a time on."""

    moment: BootTime
    """From when on."""
    value: float
    """The value, in the autopilot's unit."""


@dataclass(frozen=True)
class ParametersInFlight:
    """The parameters during one or several intervals of a log."""

    values: Parameters
    """Values by name, of the parameters that had one value all the time."""
    changed_names: Names
    """Names of the other parameters, in alphabetical order, which had several values meanwhile."""
    last_values: Parameters
    """Values by name at the end of the recording, which the vehicle still has."""

    @classmethod
    def unchanged(cls, parameters: Parameters) -> Self:
        """Returns parameters, by name, that have been the same all the time and still are."""
        return cls(parameters, (), parameters)

    @property
    def any_values(self) -> Parameters:
        """A value of each parameter by name: that in flight, or the present one of a parameter that had several."""
        return {**self.last_values, **self.values}


@dataclass(frozen=True)
class ParameterHistory:
    """The values of all parameters over a log.

    An autopilot reports a parameter when it is asked for it, and when it is set. A value holds until another one is
    reported, also in later boots, since autopilots store their parameters. The first one held before too.
    """

    last_values: Parameters
    """Values of all parameters at the end of the log, by name."""
    present_values: Parameters
    """The values that the vehicle still has, by name: others than the last ones if a later boot of the recording, which
    is not part of the log, reported them."""
    settings: ReadOnlyDict[str, tuple[ParameterSetting, ...]]
    """The settings of each parameter that changed, in the order of the log; the first is from ``BEFORE_LOG``."""

    def at(self, moment: BootTime) -> Parameters:
        """Returns the values of all parameters at a time of a boot, by name."""
        values = dict(self.last_values)
        for name, settings in self.settings.items():
            values[name] = _value_at(settings, moment)
        return values

    def during(self, segments: Segments) -> ParametersInFlight:
        """Returns the parameters during some segments of a log, and the names of those that changed meanwhile.

        Args:
            segments: the segments in which the vehicle was observed. Without any, the values are those of the end.
        """
        values = dict(self.last_values)
        changed_names = []
        for name, settings in self.settings.items():
            values_in_flight = set[float]()
            for segment in segments:
                values_in_flight.update(_values_in_segment(settings, segment))
            if len(values_in_flight) > 1:
                del values[name]
                changed_names.append(name)
            elif values_in_flight:
                values[name] = values_in_flight.pop()
        return ParametersInFlight(values, tuple(sorted(changed_names)), self.present_values)


@cached_per_vehicle()
def parameter_history(signals: Signals) -> ParameterHistory:
    """Returns the values of a vehicle's parameters over its log."""
    return parameter_history_of(signals.telemetry)


def parameter_history_of(telemetry: Telemetry) -> ParameterHistory:
    """Returns the values of a vehicle's parameters over its log.

    Args:
        telemetry: messages of the vehicle. If none of them is about parameters, the ``initial_parameters`` are taken
            for the values in all of the log: when they were changed is not known.
    """
    settings = dict[str, list[ParameterSetting]]()
    for name, value in telemetry.initial_parameters.items():
        settings[name] = [ParameterSetting(BEFORE_LOG, value)]
    if "PARAM_VALUE" in telemetry.messages:
        settings = _reported_settings(telemetry)
    settings_of_changed = {}
    for name, settings_of_parameter in settings.items():
        has_changed = settings_of_parameter[0].value != telemetry.parameters.get(name)
        if len(settings_of_parameter) > 1 or has_changed:
            settings_of_changed[name] = tuple(settings_of_parameter)
    return ParameterHistory(
        telemetry.parameters, telemetry.present_parameters, ReadOnlyDict(settings_of_changed)
    )


def _reported_settings(telemetry: Telemetry) -> dict[str, list[ParameterSetting]]:
    """Returns the settings that an autopilot has reported, by name and in the order of the log.

    Args:
        telemetry: messages of the vehicle, with PARAM_VALUE among them.

    Returns:
        At least one setting of each reported parameter, the first from ``BEFORE_LOG``. Reports that repeat a value
        give no further setting.
    """
    columns = parameter_reports(telemetry.messages, telemetry.autopilot)
    moments = map(BootTime, columns["boot"].tolist(), columns["time"].tolist())
    names_and_values = decoded_parameters(columns, telemetry.autopilot)
    settings = dict[str, list[ParameterSetting]]()
    for moment, (name, value) in zip(moments, names_and_values, strict=True):
        if not isfinite(value):
            continue
        if name not in settings:
            settings[name] = [ParameterSetting(BEFORE_LOG, value)]
        elif settings[name][-1].value != value:
            settings[name].append(ParameterSetting(moment, value))
    return settings


def _value_at(settings: Iterable[ParameterSetting], moment: BootTime) -> float:
    """Returns the value of a parameter at a time, by its settings from ``BEFORE_LOG`` on."""
    return [setting.value for setting in settings if setting.moment <= moment][-1]


def _values_in_segment(settings: Iterable[ParameterSetting], segment: Segment) -> set[float]:
    """Returns the values that a parameter had in a segment of a log, by its settings from ``BEFORE_LOG`` on."""
    start = BootTime(segment.boot, segment.start)
    end = BootTime(segment.boot, segment.end)
    values = {_value_at(settings, start)}
    for setting in settings:
        if start < setting.moment <= end:
            values.add(setting.value)
    return values
