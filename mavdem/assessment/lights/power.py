"""Status light of power, judged by facts (coded findings): voltage and charge of batteries, supply of the board."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.battery_levels import (
    ardupilot_charge_levels,
    batteries_worst_first,
    cell_count,
    is_measured,
    low_voltage_parameters,
    voltage_levels,
)
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flights import loss_onset
from mavdem.assessment.limits import LEVELS_BY_SEVERITY, Limits, worst_fact
from mavdem.assessment.repeated_reports import in_time_order
from mavdem.dataset import time_series
from mavdem.dataset.batteries import FIRST_BATTERY, Battery, battery_name
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.hardware import HardwarePart
from mavdem.facts.power import PowerLight
from mavdem.ingest.telemetry import Parameters, Telemetry

LOW_VOLTAGE_SECONDS = 10.0
"""Time, s, that a voltage must stay below a limit to count: the default of ArduPilot's BATT_LOW_TIMER."""

BOARD_VOLTAGE_LIMITS = Limits(4.8, 4.5)
"""Voltages, V, of the board below which PX4 warns, and refuses to arm (``powerCheck.cpp``). The first is also the least
voltage at which the makers of Pixhawk boards specify them to work."""

PRESENT_POWER_MODULE_PARAMETERS = {"ARDUPILOTMEGA": "BATT_MONITOR", "PX4": "BAT1_SOURCE"}
"""The parameter by which each autopilot's present version knows where its battery is measured."""

POWER_MODULE_PARAMETERS = (*PRESENT_POWER_MODULE_PARAMETERS.values(), "BAT_SOURCE")
"""These parameters, and the one of older versions of PX4, which knew one battery."""

POSSIBLE_BOARD_VOLTAGE = (3.0, 10.0)
"""Voltages, V, of the supply of a board that works: below, its regulators for 3.3 V fail. Others are not measured."""

MAX_BOARD_VOLTAGE_DROP = 0.3
"""Drop of the board's voltage below its median, V: twice what ArduPilot's page on power in logs calls normal."""

MAX_RESISTANCE_CORRELATION = -0.7
"""Correlation of voltage and current, about their means over 2 s, above which they show no internal resistance: at this
value the current explains half of the voltage's variance."""

MIN_HOVER_CURRENT = 1.0
"""Current, A, on which no multirotor hovers: a Crazyflie of 27 g draws nearly 2 A from one cell.

A vehicle with n cells in series draws as much only if it weighs less than about n · 80 g, since hovering takes at least
45 W/kg at the battery (momentum theory for a disc loading of 20 N/m² and 60 % efficiency); those that are so light draw
several times more, since their propellers are small.
"""

CURRENT_SCALE_PARAMETERS = ("BATT_AMP_PERVLT", "BAT1_A_PER_V", "BAT_A_PER_V")
"""Parameters of ArduPilot, of PX4 and of its older versions that calibrate the current sensor of the first battery."""

MIN_VOLTAGE_STEP = 1e-3
"""Least step between two voltages, s, that is used: a damaged log may have the same stamp throughout."""

MAX_SAG = 0.5
"""Largest fraction of a battery's voltage that its resistance takes; with more, most of the power heats it."""

PX4_LOW_CHARGE = 0.15
"""Fraction of the full charge below which PX4 warns: the default of BAT_LOW_THR."""

PX4_CRITICAL_CHARGE = 0.07
"""Fraction of the full charge below which PX4 acts on a critical battery: the default of BAT_CRIT_THR."""

CHARGED_CELL_VOLTAGE = 3.6
"""Voltage, V, of a cell under load from which on it is not empty: PX4's default of BAT1_V_EMPTY, that of an empty cell
at rest."""

SHORTEST_DISCHARGE = 36.0
"""Time, s, in which a full battery is emptied at the earliest: lithium polymer cells bear 100 times their capacity an
hour at most, by their makers."""

BATTERY_REPORTS = {
    ReportedEvent.BATTERY_WARNED,
    ReportedEvent.BATTERY_ALARMED,
    ReportedEvent.BATTERY_SPENT,
}
"""Reports of the autopilot on the state of a battery."""

POWER_REPORTS = {*BATTERY_REPORTS, ReportedEvent.BOARD_VOLTAGE_LOW}
"""Reports of the autopilot in flight that concern the power."""


def power_light(evidence: Evidence) -> Fact:
    """Judges the power in flight by the worst fact about it; unknown if no voltage and no charge was measured.

    Judged are the voltages of the batteries, their charge, the supply voltage of the board, and the autopilot's reports
    on them. If several batteries were measured, the fact (coded finding) names the one that it is about, and has the
    voltages of the others as the figure ``batteries``: a tuple of facts, the worst first.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown.
    """
    batteries = batteries_in_flight(evidence)
    voltage_facts = [judge_battery_voltage(evidence, battery) for battery in batteries]
    voltage_facts.sort(key=lambda fact: LEVELS_BY_SEVERITY.index(fact.level), reverse=True)
    # The first of equally bad facts is the light. So a spent battery comes before the other reports: it was critical
    # before it was spent.
    facts = [
        *voltage_facts,
        *_charge_facts(evidence, batteries),
        *_supply_facts(evidence),
        *evidence.warnings_in_flight((ReportedEvent.BATTERY_SPENT,)),
        *evidence.warnings_in_flight(POWER_REPORTS),
        *_uncalibrated_current_facts(evidence, batteries),
    ]
    if not facts:
        # Without a flight, a battery that the autopilot reports as empty becomes the headline, so that the light must
        # show it too.
        for event in evidence.events:
            if event.code in POWER_REPORTS and event.is_bad:
                facts.append(event)
    if not facts:
        return _unmeasured_power(evidence)
    light = worst_fact(facts)
    if len(evidence.signals.batteries) > 1:
        facts_of_others = [fact for fact in voltage_facts if fact is not light]
        facts_of_others += _unmeasured_batteries(evidence, batteries)
        light = light.replace(batteries=tuple(facts_of_others))
    return light


def further_power_warnings(evidence: Evidence, light: Fact) -> NamedFacts:
    """Returns the warnings about the board's supply and the current sensor that the status light of power leaves out.

    The light states only the worst fact about the power. If a battery is low, for example, it does not say that the
    current sensor is uncalibrated as well.

    Args:
        evidence: signals, events and measurements of the vehicle.
        light: the light of power, which is the worst fact.

    Returns:
        Facts (coded findings) that are to be watched or bad, by the name of the part of the hardware that they are
        about.
    """
    batteries = batteries_in_flight(evidence)
    facts_by_part = {
        HardwarePart.SUPPLY: _supply_facts(evidence),
        HardwarePart.CURRENT_SENSOR: _uncalibrated_current_facts(evidence, batteries),
    }
    warnings = {}
    for part, facts in facts_by_part.items():
        for fact in facts:
            is_stated_by_light = fact.code is light.code
            if fact.is_watch_or_bad and not is_stated_by_light:
                warnings[str(part)] = fact
    return warnings


def _unmeasured_power(evidence: Evidence) -> Fact:
    """Returns the fact that no power was measured in flight, with what was recorded nevertheless.

    Voltages that never change are not measured: the sensors are not connected.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact (coded finding) with these figures:

        - ``voltage``: the largest voltage of a battery, V; None without any battery.
        - ``is_constant``: whether the voltage of no battery changes.
        - ``voltage_usual``: the supply voltage of the board, V, if it is constant.
        - ``current``: the largest current of a battery, A; only if that of one changes.
        - ``parameter`` and ``recorder`` for the advice: which parameter chooses the power module, and what recorded the
          log.
    """
    voltages = [battery.voltage.values for battery in evidence.signals.batteries]
    unmeasured_fact = Fact(
        PowerLight.POWER_UNMEASURED,
        airborne=evidence.was_in_air,
        is_constant=all(voltage.min() == voltage.max() for voltage in voltages),
        voltage=max((voltage.max() for voltage in voltages), default=None),
        voltage_usual=_constant_board_voltage(evidence),
        parameter=_power_module_parameter(evidence.signals.telemetry),
        recorder=evidence.signals.telemetry.translated_from,
    )
    largest_currents = []
    for battery in evidence.signals.batteries:
        # A current that never changes is not measured, as the voltage of a sensor that is not connected.
        if battery.current is not None and np.ptp(battery.current.values) > 0:
            largest_currents.append(battery.current.values.max())
    if not largest_currents:
        return unmeasured_fact
    return unmeasured_fact.replace(current=max(largest_currents))


def mark_battery_reports_on_ground(evidence: Evidence) -> tuple[Fact, ...]:
    """Marks the reports on a battery that came before or without a flight by the figure ``is_on_ground``.

    Their usual advice, to land earlier, does not fit a vehicle that did not fly.

    Args:
        evidence: events of the vehicle, and when each of its flights began and ended.

    Returns:
        All events of the evidence, marked or not, in the same order.
    """
    marked_events = []
    for event in evidence.events:
        if event.code in BATTERY_REPORTS:
            flights = evidence.flights(event.figures["boot"])
            has_taken_off = any(take_off <= event.start_time for take_off, _ in flights)
            if not has_taken_off:
                event = event.replace(is_on_ground=True)
        marked_events.append(event)
    return tuple(marked_events)


def with_low_supply(evidence: Evidence) -> tuple[Fact, ...]:
    """Adds the event that the supply voltage of the autopilot's board was low in flight, if it was.

    If the events have one already, by the message POWER_STATUS, none is added.

    Args:
        evidence: events of the vehicle, and its voltages in flight.

    Returns:
        All events of the evidence and the new one, if any, in the order of boot and time. It has the lowest average
        over 2 s as ``voltage``, and the ``voltage_limit`` that it was below, V.
    """
    if any(event.code is ReportedEvent.BOARD_VOLTAGE_LOW for event in evidence.events):
        return evidence.events
    events = list(evidence.events)
    for supply in _supply_facts(evidence):
        if supply.code is PowerLight.SUPPLY_LOW:
            low_supply = Fact(
                ReportedEvent.BOARD_VOLTAGE_LOW,
                time=supply.time,
                boot=supply.figures["boot"],
                voltage=supply.figures["voltage"],
                voltage_limit=supply.figures["voltage_limit"],
            )
            events.append(low_supply)
    return tuple(in_time_order(events))


def with_supply_as_suspect(evidence: Evidence) -> tuple[Fact, ...]:
    """Names a low supply of the board as the suspected reason why a log ends in the air.

    If the supply fails, the autopilot stops, and so does its log.

    Args:
        evidence: events of the vehicle, and its voltages in flight.

    Returns:
        All events of the evidence in the same order. The event that the log ends in the air has the fact (coded
        finding) about the supply as its figure ``suspect``, if the supply was low or fell.
    """
    events = []
    for event in evidence.events:
        if event.code is MotionEvent.LOG_ENDED_IN_AIR:
            for supply in _supply_facts(evidence):
                if supply.is_watch_or_bad:
                    event = event.replace(suspect=supply)
        events.append(event)
    return tuple(events)


def _unmeasured_batteries(
    evidence: Evidence, measured_batteries: Sequence[Battery]
) -> Iterator[Fact]:
    """Yields a fact for each battery that was recorded but not measured in flight: its sensor is not connected.

    Args:
        evidence: signals, events and measurements of the vehicle.
        measured_batteries: the batteries that were measured in flight, which are left out.

    Yields:
        Facts with the number of the ``battery`` and its largest ``voltage``, V; whether the vehicle has flown
        (``airborne``), and whether the voltage ``is_constant``, as without a sensor.
    """
    measured_numbers = {battery.number for battery in measured_batteries}
    for battery in evidence.signals.batteries:
        if battery.number in measured_numbers:
            continue
        voltage = battery.voltage.values
        yield Fact(
            PowerLight.POWER_UNMEASURED,
            subject=battery_name(battery.number),
            battery=battery.number,
            airborne=evidence.has_flown,
            is_constant=bool(voltage.min() == voltage.max()),
            voltage=voltage.max(),
            parameter=_power_module_parameter(evidence.signals.telemetry),
            recorder=evidence.signals.telemetry.translated_from,
        )


def _power_module_parameter(telemetry: Telemetry) -> str:
    """Returns the parameter that chooses where an autopilot measures its battery, for advice to set it.

    It depends on the autopilot and, for PX4, on the version.

    Args:
        telemetry: autopilot and parameters of the vehicle.

    Returns:
        Its name in the log, such as "BATT_MONITOR". If the log has no parameters at all, the name in the present
        version of the autopilot. Empty if it is not known.
    """
    if telemetry.parameters:
        return _parameter_in_log(telemetry, POWER_MODULE_PARAMETERS)
    return PRESENT_POWER_MODULE_PARAMETERS.get(telemetry.autopilot, "")


def _parameter_in_log(telemetry: Telemetry, names: Iterable[str]) -> str:
    """Returns which of some names of the same parameter the log of a vehicle has; empty if it has none.

    Args:
        telemetry: parameters of the vehicle.
        names: names in various autopilots and versions. If the log has several, the first one counts.
    """
    for name in names:
        if name in telemetry.parameters:
            return name
    return ""


def batteries_in_flight(evidence: Evidence) -> list[Battery]:
    """Selects the batteries whose voltage was measured in flight.

    A battery whose sensor is not connected shows a constant voltage, and is left out (``is_measured``).

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The batteries, the emptiest first.
    """
    batteries = []
    for battery in batteries_worst_first(evidence.signals):
        is_recorded_in_flight = len(evidence.averages_in_flight(battery.voltage)) > 0
        if is_recorded_in_flight and is_measured(evidence.flown_parameters, battery):
            batteries.append(battery)
    return batteries


def judge_battery_voltage(evidence: Evidence, battery: Battery) -> Fact:
    """Judges whether the voltage of a battery stayed above its limits in flight.

    The samples are averaged over 2 s and sorted. The voltage below which they were for ``LOW_VOLTAGE_SECONDS`` in total
    is compared with the limits, so that a short sag under a burst of thrust has no effect.

    If the flight was lost, the voltage is judged until the loss, and the fact (coded finding) ends there. If the
    voltage was too low, the fact has the time at which the average first was below the limit.

    Args:
        evidence: signals, events and measurements of the vehicle.
        battery: the battery, which was measured in flight.

    Returns:
        A fact with the lowest average ``voltage`` and the ``voltage_limit`` that was used, V, the number of ``cells``,
        the largest ``current``, A, and the internal ``resistance``, ohm, each None if it is not known. If there are
        several batteries, or the battery is not the first, the fact also has its number as ``battery``. If the number
        of cells is missing, ``parameter`` names the autopilot's parameters by which the voltage could be judged.
    """
    parameters = evidence.flown_parameters
    averages = np.sort(evidence.averages_in_flight(battery.voltage))
    cells = cell_count(parameters, battery)
    lasting_voltage = _lasting_voltage(battery.voltage, averages)
    limits = voltage_levels(parameters, battery.number, cells or 0)
    # None is the usual level of a code.
    level = None
    voltage_limit = limits.watch
    start = _StartBelow()
    optional_figures = dict[str, Any]()
    if lasting_voltage < limits.watch:
        code = PowerLight.BATTERY_LOW
        if lasting_voltage < limits.bad:
            level = Level.BAD
            voltage_limit = limits.bad
        start = _start_below(evidence, battery.voltage, voltage_limit)
    elif limits.watch > 0:
        code = PowerLight.BATTERY_HELD
    else:
        # The limit is 0: neither parameters nor the number of cells are known, and the voltage cannot be judged.
        code = PowerLight.CELLS_UNKNOWN
        optional_figures["parameter"] = low_voltage_parameters(
            evidence.signals.telemetry, battery.number
        )
    load = _calibrated_load(evidence, battery)
    ending = evidence.ending
    return Fact(
        code,
        level,
        time=start.time,
        **start.optional_figures,
        **optional_figures,
        end_time=None if ending is None else loss_onset(ending),
        **_figures_naming_battery(evidence, battery),
        voltage=averages[0],
        cells=cells,
        current=load.max_current,
        resistance=load.resistance,
        voltage_limit=voltage_limit,
    )


def _figures_naming_battery(evidence: Evidence, battery: Battery) -> dict[str, Any]:
    """Returns the figures by which a finding about a battery says which battery it means, such as "battery 2".

    The only battery of a vehicle needs no name, so that its figures are empty, unless its number is unusual.

    Args:
        evidence: signals of the vehicle, with all its batteries.
        battery: the battery that the finding is about.

    Returns:
        The ``subject`` of the finding's sentence, which is the battery's name, and the number of the ``battery``.
    """
    if len(evidence.signals.batteries) > 1 or battery.number != FIRST_BATTERY:
        return {"subject": battery_name(battery.number), "battery": battery.number}
    return {}


def _lasting_voltage(voltage: TimeSeries, sorted_averages: Array) -> float:
    """Returns the voltage, V, below which a battery was for ``LOW_VOLTAGE_SECONDS`` of the flight in total.

    It is an order statistic. For example, if that time is 10 s and the battery is measured once a second, it is the
    eleventh lowest sample, since ten are below it. In a flight that is shorter it is the highest one.

    Args:
        voltage: (N,) the measured voltage, V, of which only the times are used. The median of the steps between samples
            tells how many samples last ``LOW_VOLTAGE_SECONDS``.
        sorted_averages: (M,) averages of the voltage in flight, V, one for each sample, the lowest first.
    """
    is_same_boot = np.diff(voltage.boot) == 0
    steps = np.diff(voltage.time)[is_same_boot]
    count_of_lower_samples = 0
    if len(steps):
        sample_seconds = max(np.median(steps), MIN_VOLTAGE_STEP)
        count_of_lower_samples = round(LOW_VOLTAGE_SECONDS / sample_seconds)
    # The sample with this index is the first above those, since indices begin with 0.
    index = min(count_of_lower_samples, len(sorted_averages) - 1)
    return float(sorted_averages[index])


class _StartBelow(NamedTuple):
    """When the average of a voltage over 2 s was first below a limit in flight."""

    time: float | None = None
    """The time, s since boot; None if it was never below."""

    is_start_of_flight: bool = False
    """Whether it was below already when the flight began, so that nothing in the flight made it so low."""

    boot: int | None = None
    """Number of the boot on whose clock the time is; None if it was never below."""

    @property
    def optional_figures(self) -> dict[str, Any]:
        """The figure by which a fact (coded finding) says that it was low from the start; empty if it fell later."""
        return {"is_low_from_start": True} if self.is_start_of_flight else {}


def _start_below(evidence: Evidence, voltage: TimeSeries, limit: float) -> _StartBelow:
    """Returns when the average of a voltage over 2 s was first below a limit in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.
        voltage: (N,) samples of the voltage, V.
        limit: the limit, V.
    """
    for flight in evidence.in_flight(voltage):
        is_below = time_series.moving_average(flight) < limit
        if is_below.any():
            times_below = flight.time[is_below]
            return _StartBelow(float(times_below[0]), bool(is_below[0]), int(flight.boot[0]))
    return _StartBelow()


def _charge_facts(evidence: Evidence, batteries: Sequence[Battery]) -> list[Fact]:
    """Returns a fact (coded finding) for each battery whose charge fell to the autopilot's limits in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.
        batteries: batteries that were measured in flight, the emptiest first.
    """
    facts = []
    for battery in batteries:
        fact = _charge_fact(evidence, battery)
        if fact is not None:
            facts.append(fact)
    return facts


def _charge_fact(evidence: Evidence, battery: Battery) -> Fact | None:
    """Returns the fact that a battery's charge fell to a limit of the autopilot or to 0 in flight; None if it did not.

    The charge is the autopilot's estimate, averaged over 2 s. It is judged in two ways:

    - At the autopilot's limit of a low battery (PX4: BAT_LOW_THR) or below, the level is "watch"; at that of a critical
      one (BAT_CRIT_THR), it is "bad".
    - ArduPilot has no limits unless they are set, but counts the charge down from the set capacity. At 0 % the battery
      is empty, so the level is "bad". If its cells still have the voltage of a charged battery, the capacity is set too
      small instead, and the level is "watch".

    Args:
        evidence: signals, events and measurements of the vehicle.
        battery: a battery that was measured in flight.

    Returns:
        A fact (coded finding) with these figures:

        - ``share``: the lowest charge, as a fraction of the full one.
        - ``share_limit``: the limit that it fell to, as such a fraction; None if it is empty without a limit.
        - ``cell_voltage``: the lowest voltage of a cell, V, if that shows that the battery was not empty.
        - ``share_before``: the charge before it fell to 0, if that was faster than a battery can be emptied.
    """
    lowest_fraction = _lowest_charge(evidence, battery)
    limits = _charge_limits(evidence, battery)
    # A limit of 0 means that the autopilot does not act. PX4 rounds the percentage up, so that it has warned already
    # where the reported charge equals its limit.
    is_critical = limits.bad > 0 and lowest_fraction <= limits.bad
    is_below_low_limit = limits.watch > 0 and lowest_fraction <= limits.watch
    is_low = is_below_low_limit or is_critical
    is_ardupilot = evidence.signals.telemetry.autopilot == "ARDUPILOTMEGA"
    is_counted_empty = is_ardupilot and lowest_fraction <= 0
    if not is_low and not is_counted_empty:
        return None
    optional_figures = {}
    if is_counted_empty:
        # Below the critical limit the level is "bad" whatever the voltage is.
        charged_cell_voltage = None if is_critical else _charged_cell_voltage(evidence, battery)
        if charged_cell_voltage is not None:
            optional_figures["cell_voltage"] = charged_cell_voltage
        fraction_before_fall = _fraction_before_sudden_fall(evidence, battery)
        if fraction_before_fall is not None:
            optional_figures["share_before"] = fraction_before_fall
    is_empty = is_counted_empty and "cell_voltage" not in optional_figures
    share_limit = None
    if is_low:
        share_limit = limits.bad if is_critical else limits.watch
    has_several_batteries = len(evidence.signals.batteries) > 1
    return Fact(
        PowerLight.CHARGE_LOW,
        # Without a level here, the fact has that of its code, "watch".
        Level.BAD if is_critical or is_empty else None,
        subject=battery_name(battery.number) if has_several_batteries else "",
        share=lowest_fraction,
        share_limit=share_limit,
        **optional_figures,
    )


def _charge_limits(evidence: Evidence, battery: Battery) -> Limits:
    """Returns the charges at which the autopilot acts on a low and on a critical battery, as fractions of the full one.

    Args:
        evidence: signals of the vehicle, with its autopilot and parameters.
        battery: the battery; ArduPilot has parameters for each.

    Returns:
        The limits; 0 where the autopilot does not act.
    """
    autopilot = evidence.signals.telemetry.autopilot
    if autopilot == "ARDUPILOTMEGA":
        return ardupilot_charge_levels(evidence.flown_parameters, battery.number)
    return _px4_charge_levels(autopilot, evidence.flown_parameters)


def _lowest_charge(evidence: Evidence, battery: Battery) -> float:
    """Returns the lowest charge of a battery in flight, averaged over 2 s, as a fraction of the full one.

    A charge that is not known is sent as -1 or as 0. Only after a larger charge does 0 mean that the battery is empty.

    Args:
        evidence: signals, events and measurements of the vehicle.
        battery: battery whose charge the autopilot estimates, in percent.

    Returns:
        The fraction; 1 if the charge is not known.
    """
    percent = evidence.averages_in_flight(battery.charge)
    # True from the first positive charge on.
    was_charged = np.maximum.accumulate(percent) > 0
    is_known = was_charged & (percent >= 0)
    charge_fractions = percent[is_known] / 100
    return float(charge_fractions.min(initial=1.0))


def _px4_charge_levels(autopilot: str, parameters: Parameters) -> Limits:
    """Returns the charges, as fractions of the full one, below which PX4's parameters call a battery low or critical.

    Args:
        autopilot: the MAV_AUTOPILOT without its prefix.
        parameters: the autopilot's parameters in flight, by name.

    Returns:
        The limits. Without the parameters these are the defaults of PX4, or 0 for any other autopilot: no limit.
    """
    default_low, default_critical = 0.0, 0.0
    if autopilot == "PX4":
        default_low, default_critical = PX4_LOW_CHARGE, PX4_CRITICAL_CHARGE
    return Limits(
        watch=parameters.get("BAT_LOW_THR", default_low),
        bad=parameters.get("BAT_CRIT_THR", default_critical),
    )


def _fraction_before_sudden_fall(evidence: Evidence, battery: Battery) -> float | None:
    """Returns the charge of a battery before it fell to nothing, faster than any vehicle can use it.

    Then the charge was not measured: the autopilot's estimate was wrong, or the sensor failed.

    Args:
        evidence: signals, events and measurements of the vehicle.
        battery: battery whose charge, in percent, fell to nothing in flight.

    Returns:
        The last charge before it was nothing, as a fraction of the full one; None if the battery can be emptied as fast
        as it fell.
    """
    for flight in evidence.in_flight(battery.charge):
        empty_samples = np.flatnonzero(flight.values == 0)
        if not len(empty_samples):
            continue
        first_empty = empty_samples[0]
        if first_empty == 0:
            # The charge was 0 from the beginning of the flight on, and did not fall in it.
            continue
        last_charged = first_empty - 1
        last_fraction = float(flight.values[last_charged]) / 100
        seconds = float(flight.time[first_empty] - flight.time[last_charged])
        # The charge is sent in whole percent, so that it may be 0.01 more than it seems.
        largest_possible_fall = 0.01 + seconds / SHORTEST_DISCHARGE
        if last_fraction > largest_possible_fall:
            return last_fraction
    return None


def _uncalibrated_current_facts(evidence: Evidence, batteries: Sequence[Battery]) -> Iterator[Fact]:
    """Yields the fact (coded finding) that the current sensor is uncalibrated: no vehicle hovers on so small a current.

    Args:
        evidence: signals, events and measurements of the vehicle.
        batteries: batteries that were measured in flight.

    Yields:
        At most one fact, since a vehicle with several batteries is not judged (:func:`_uncalibrated_current`). It has
        the median ``current`` in flight and the ``least_current`` of a hover, A, the lowest average ``voltage`` over 2
        s, V, and the ``parameter`` that calibrates the current sensor; empty if the log has none.
    """
    for battery in batteries:
        current = _uncalibrated_current(evidence, battery)
        if current is not None:
            yield Fact(
                PowerLight.CURRENT_UNCALIBRATED,
                current=current,
                least_current=MIN_HOVER_CURRENT,
                voltage=evidence.averages_in_flight(battery.voltage).min(),
                parameter=_parameter_in_log(evidence.signals.telemetry, CURRENT_SCALE_PARAMETERS),
            )


def _uncalibrated_current(evidence: Evidence, battery: Battery) -> float | None:
    """Returns the median current of a battery in flight, A, if it is too small to hover on; None if it is plausible.

    Args:
        evidence: signals, events and measurements of the vehicle.
        battery: battery that was measured in flight.

    Returns:
        The median of the averages over 2 s if it is below ``MIN_HOVER_CURRENT``. None also if the current was measured
        for less than ``LOW_VOLTAGE_SECONDS`` of flight, and for a vehicle with several batteries: one of them may
        supply only the autopilot.
    """
    has_several_batteries = len(evidence.signals.batteries) > 1
    if battery.current is None or has_several_batteries:
        return None
    averages = evidence.averages_in_flight(battery.current)
    flight_seconds = sum(np.ptp(flight.time) for flight in evidence.in_flight(battery.current))
    # A sensor that is not connected shows 0, or a constant.
    is_sensor_connected = len(averages) > 0 and averages.max() > 0 and np.ptp(averages) > 0
    if flight_seconds < LOW_VOLTAGE_SECONDS or not is_sensor_connected:
        return None
    median_current = float(np.median(averages))
    return median_current if median_current < MIN_HOVER_CURRENT else None


def _charged_cell_voltage(evidence: Evidence, battery: Battery) -> float | None:
    """Returns the lowest voltage of a battery's cell in flight, V, if it shows that the battery was not empty.

    Args:
        evidence: signals, events and measurements of the vehicle.
        battery: battery that was measured in flight.

    Returns:
        The voltage, averaged over 2 s, if it is at least ``CHARGED_CELL_VOLTAGE``; None if it is lower, or the number
        of cells is not known.
    """
    cells = cell_count(evidence.flown_parameters, battery)
    if cells is None:
        return None
    cell_voltage = float(evidence.averages_in_flight(battery.voltage).min()) / cells
    return cell_voltage if cell_voltage >= CHARGED_CELL_VOLTAGE else None


def _supply_facts(evidence: Evidence) -> Iterator[Fact]:
    """Judges the supply voltage of the autopilot's board in flight; yields nothing if it was not measured.

    If the supply falls too far, the autopilot may reset in the air. The first of these cases applies:

    1. The supply is low: its lowest value is below ``BOARD_VOLTAGE_LIMITS``.
    2. It fell: its lowest value is more than ``MAX_BOARD_VOLTAGE_DROP`` below its median.
    3. It held.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Yields:
        At most one fact (coded finding), with the lowest average over 2 s as ``voltage``, the median as
        ``voltage_usual``, and the limit, all in V. In the first two cases it has the time at which the average first
        was so low, and ``is_low_from_start`` if that was when the flight began. For the advice to measure a battery it
        has the ``parameter`` that chooses the power module.
    """
    measured_voltage = _measured_board_voltage(evidence)
    averages = evidence.averages_in_flight(measured_voltage)
    if measured_voltage is None or not len(averages):
        return
    lowest_voltage = averages.min()
    usual_voltage = np.median(averages)
    least_usual_voltage = usual_voltage - MAX_BOARD_VOLTAGE_DROP
    # A fact with None as its level has the usual level of its code.
    level = None
    voltage_limit = BOARD_VOLTAGE_LIMITS.watch
    if lowest_voltage < BOARD_VOLTAGE_LIMITS.watch:
        code = PowerLight.SUPPLY_LOW
        if lowest_voltage < BOARD_VOLTAGE_LIMITS.bad:
            level = Level.BAD
            voltage_limit = BOARD_VOLTAGE_LIMITS.bad
        start = _start_below(evidence, measured_voltage, voltage_limit)
    elif lowest_voltage < least_usual_voltage:
        code = PowerLight.SUPPLY_FELL
        start = _start_below(evidence, measured_voltage, least_usual_voltage)
    else:
        code = PowerLight.SUPPLY_HELD
        start = _StartBelow()
    yield Fact(
        code,
        level,
        time=start.time,
        **start.optional_figures,
        boot=start.boot,
        voltage=lowest_voltage,
        voltage_usual=usual_voltage,
        voltage_limit=voltage_limit,
        parameter=_power_module_parameter(evidence.signals.telemetry),
    )


def _measured_board_voltage(evidence: Evidence) -> TimeSeries | None:
    """Returns the first supply voltage of the board that varies, (N,) V: a constant one was not measured.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    for volts in _board_voltages(evidence):
        if np.ptp(volts.values) > 0:
            return volts
    return None


def _board_voltages(evidence: Evidence) -> Iterator[TimeSeries]:
    """Yields the supply voltages (N,) of the autopilot's board, V, for each message that has plausible ones.

    Args:
        evidence: signals, events and measurements of the vehicle.
    """
    lowest_possible, highest_possible = POSSIBLE_BOARD_VOLTAGE
    for message in ("POWER_STATUS", "HWSTATUS"):
        millivolts = recorded_series(evidence.signals.telemetry, message, "Vcc")
        if millivolts is None:
            continue
        all_volts = TimeSeries(millivolts.time, millivolts.boot, millivolts.values / 1000)
        plausible_volts = all_volts.select(
            (all_volts.values >= lowest_possible) & (all_volts.values <= highest_possible)
        )
        if len(plausible_volts.time):
            yield plausible_volts


def _constant_board_voltage(evidence: Evidence) -> float | None:
    """Returns the voltage of the board's supply, V, if it is the same throughout the log; None otherwise."""
    for volts in _board_voltages(evidence):
        if np.ptp(volts.values) == 0:
            return float(volts.values[0])
    return None


class _BatteryLoad(NamedTuple):
    """What voltage and current of a battery show of its load."""

    resistance: float | None = None
    """Internal resistance, ohm; None if the voltage does not fall as the current rises."""
    max_current: float | None = None
    """Largest mean current over 2 s, A; None if no current was measured."""


def _calibrated_load(evidence: Evidence, battery: Battery) -> _BatteryLoad:
    """Returns the load on a battery in flight, without figures if its current sensor is uncalibrated.

    A current that is wrong by a factor gives neither a true largest current nor a true resistance.

    Args:
        evidence: signals, events and measurements of the vehicle.
        battery: battery that was measured in flight.
    """
    if _uncalibrated_current(evidence, battery) is not None:
        return _BatteryLoad()
    return _battery_load([*evidence.in_flight(battery.load)])


def _battery_load(flights: Sequence[TimeSeries]) -> _BatteryLoad:
    """Estimates the internal resistance R of a battery by linear regression, from voltage U and current I.

    In U = U₀ − R I the open-circuit voltage U₀ falls slowly as the battery discharges. To remove that, moving means
    over 2 s are subtracted from voltage and current. The deviations u and i that remain give R = −Σ u i / Σ i². The
    result is used only if u and i are clearly anticorrelated.

    Args:
        flights: one series (N, 2) for each flight: voltage, V, and current, A.

    Returns:
        Resistance, Ω, and largest moving mean of the current, A. The resistance is None if voltage and current do not
        show it, and both are None if the current was not measured.
    """
    deviations: list[Array] = []
    max_current = 0.0
    max_voltage = 0.0
    for flight in flights:
        # A current of 0 or less was not measured.
        measured_flight = flight.select(flight.values[:, 1] > 0)
        volts, amperes = measured_flight.values.T
        mean_volts = time_series.moving_average(replace(measured_flight, values=volts))
        mean_amperes = time_series.moving_average(replace(measured_flight, values=amperes))
        deviations.append(measured_flight.values.T - [mean_volts, mean_amperes])
        max_current = max(max_current, mean_amperes.max(initial=0.0))
        max_voltage = max(max_voltage, mean_volts.max(initial=0.0))
    if not max_current:
        return _BatteryLoad()
    volt_deviations, ampere_deviations = np.hstack(deviations)
    resistance = _resistance(volt_deviations, ampere_deviations)
    # A drop of the voltage above ``MAX_SAG`` by the resistance alone is not plausible: the voltage fell for another
    # reason while the current rose.
    if resistance is None or resistance * max_current > MAX_SAG * max_voltage:
        return _BatteryLoad(max_current=max_current)
    return _BatteryLoad(resistance, max_current)


def _resistance(volt_deviations: Array, ampere_deviations: Array) -> float | None:
    """Returns minus the slope of the voltage over the current, by linear regression through 0.

    Args:
        volt_deviations: (N,) deviations of the voltage from its moving mean, V.
        ampere_deviations: (N,) deviations of the current from its moving mean, A.

    Returns:
        The resistance, Ω; None if the correlation is above ``MAX_RESISTANCE_CORRELATION``, or one of the two is
        constant.
    """
    volt_squares = volt_deviations @ volt_deviations
    ampere_squares = ampere_deviations @ ampere_deviations
    products = volt_deviations @ ampere_deviations
    # The correlation is ``products`` over this largest possible product (Cauchy-Schwarz inequality).
    largest_product = (volt_squares * ampere_squares) ** 0.5
    if largest_product == 0 or products > MAX_RESISTANCE_CORRELATION * largest_product:
        return None
    return float(-products / ampere_squares)
