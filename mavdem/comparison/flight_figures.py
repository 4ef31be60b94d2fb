"""FlightFigures: what is compared and shown of one flight and axis, wherever its figures come from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import Protocol, TypeVar


class FlightFigures(Protocol):
    """The figures of one flight of a vehicle about one axis; ``None`` is what is not known. SI units, rad.

    Lists have an entry a motor; intervals are half widths, 90 %. ``status`` is "ok", or why there are no figures.
    """

    # ruff: noqa: D102
    @property
    def file(self) -> str: ...
    @property
    def key(self) -> str: ...
    @property
    def vehicle(self) -> str: ...
    @property
    def vehicle_basis(self) -> str | None: ...
    @property
    def system(self) -> int | None: ...
    @property
    def component(self) -> int | None: ...
    @property
    def autopilot(self) -> str | None: ...
    @property
    def frame(self) -> str | None: ...
    @property
    def firmware(self) -> str | None: ...
    @property
    def date(self) -> datetime | None: ...
    @property
    def axis(self) -> str | None: ...
    @property
    def tier(self) -> str | None: ...
    @property
    def duration(self) -> float | None: ...
    @property
    def voltage_mean(self) -> float | None: ...
    @property
    def collective(self) -> float | None: ...
    @property
    def lean_roll(self) -> float | None: ...
    @property
    def lean_pitch(self) -> float | None: ...
    @property
    def tilt_sd(self) -> float | None: ...
    @property
    def motors(self) -> Sequence[str] | None: ...
    @property
    def trim_unit(self) -> str | None: ...
    @property
    def inputs(self) -> str | None: ...
    @property
    def input_unit(self) -> str | None: ...
    @property
    def trim_share(self) -> Sequence[float] | None: ...
    @property
    def trim_share_interval(self) -> Sequence[float | None] | None: ...
    @property
    def effect(self) -> Sequence[float] | None: ...
    @property
    def effect_interval(self) -> Sequence[float | None] | None: ...
    @property
    def effect_status(self) -> str | None: ...
    @property
    def damping(self) -> float | None: ...
    @property
    def damping_interval(self) -> float | None: ...
    @property
    def damping_status(self) -> str | None: ...
    @property
    def lag(self) -> float | None: ...
    @property
    def lag_interval(self) -> float | None: ...
    @property
    def lag_status(self) -> str | None: ...
    @property
    def wind_torque_sd(self) -> float | None: ...
    @property
    def wind_torque_mean(self) -> float | None: ...
    @property
    def wind_torque_interval(self) -> float | None: ...
    @property
    def residual_mean(self) -> float | None: ...
    @property
    def residual_mean_interval(self) -> float | None: ...
    @property
    def error_ratio(self) -> float | None: ...
    @property
    def health(self) -> str | None: ...
    @property
    def fault_probability(self) -> float | None: ...
    @property
    def suspect_motor(self) -> int | None: ...
    @property
    def health_reason(self) -> str | None: ...
    @property
    def warnings(self) -> Sequence[str] | None: ...
    @property
    def status(self) -> str: ...
    @property
    def page(self) -> str | None: ...


NAMELESS = "unknown"  # the vehicle of logs that do not say whose they are
SHARED = "system id"  # the basis of a name that several vehicles may have
OK = "ok"  # the status of a flight with figures
Row = TypeVar("Row", bound=FlightFigures)


def flights_of(rows: Iterable[Row]) -> list[list[Row]]:
    """The rows of each flight together, its axes in order, the flights in order of date, then of file.

    What has no date comes after what has one.
    """
    together: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        together.setdefault((row.key, row.file, row.vehicle, row.system, row.component), []).append(row)
    return sorted(
        (
            sorted(flight, key=lambda row: AXIS_ORDER.get(row.axis or "", len(AXIS_ORDER)))
            for flight in together.values()
        ),
        key=lambda flight: (*_when(flight[0].date), flight[0].file, flight[0].key, flight[0].vehicle, *_ids(flight[0])),
    )


AXIS_ORDER = {"roll": 0, "pitch": 1, "yaw": 2}


def _when(date: datetime | None) -> tuple[bool, float]:
    return date is None, 0.0 if date is None else date.timestamp()


def _ids(row: FlightFigures) -> tuple[int, int]:
    return row.system or 0, row.component or 0


def vehicles_of(rows: Iterable[Row]) -> dict[str, list[list[Row]]]:
    """The flights with figures of each vehicle, as :func:`flights_of` has them, by its name in order."""
    named: dict[str, list[list[Row]]] = {}
    for flight in flights_of(row for row in rows if row.status == OK):
        named.setdefault(flight[0].vehicle, []).append(flight)
    return dict(sorted(named.items()))


def is_shared(flights: Iterable[Iterable[FlightFigures]]) -> bool:
    """Whether the name of these flights' vehicle is one that several vehicles may have."""
    return any(row.vehicle_basis == SHARED for flight in flights for row in flight)


def flown_once(flights: Sequence[list[Row]]) -> list[list[Row]]:
    """Flights of one vehicle, each once where several logs have it, by its best tier: those at the same time are one.

    The flights are in order of date, as :func:`vehicles_of` has them.
    """
    once: list[list[Row]] = []
    for flight in flights:
        if once and _at_once(once[-1][0], flight[0]):
            once[-1] = min(once[-1], flight, key=_best_tier)
        else:
            once.append(flight)
    return once


def _at_once(one: FlightFigures, next_one: FlightFigures) -> bool:
    if one.date is None or next_one.date is None:
        return False
    return (next_one.date - one.date).total_seconds() < (one.duration or 0.0)


def _best_tier(flight: Sequence[FlightFigures]) -> str:
    return min((row.tier for row in flight if row.tier), default="z")
