"""What changed between two states of a vehicle, what is the same, and what cannot be said."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import PurePath

from mavdem.containers import Names, group_by
from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet import difference
from mavdem.fleet.difference import (
    SD_BETWEEN_FLIGHTS,
    ParameterChange,
    QuantityChange,
    VehicleDifference,
)
from mavdem.fleet.row import UNKNOWN, FlightRow
from mavdem.report.blocks import Blocks, Sentence, caution
from mavdem.report.numbers import counted, listed, plus_minus, rounded, without_remark
from mavdem.report.templates import render_section

QUANTITIES = {  # what a kind of quantity is called, and the scale and unit that it is shown in
    difference.SHARE: ("share", 100.0, "%"),
    difference.EFFECT: ("control effectiveness", 100.0, "%"),
    difference.MEAN_EFFECT: ("mean control effectiveness", 100.0, "%"),
    difference.DAMPING: ("rate damping", 1.0, "1/s"),
    difference.LAG: ("motor time constant", 1e3, "ms"),
}


def difference_blocks(
    of_vehicle: VehicleDifference,
    parameters: Sequence[ParameterChange] = (),
    lacking: Names = (),
) -> Blocks:
    """Returns in sentences what changed of two vehicles or one, and how sure that is.

    Which vehicles come first, then ``parameters`` that were set anew and sides whose gains are ``lacking``, what
    changed, is the same, uncertain or not comparable, and the conditions.
    """
    missing = [
        Sentence(f"{listed(missing.quantity for missing in lacking)}: {reason}", "Not compared:")
        for reason, lacking in group_by(
            of_vehicle.incomparable, lambda missing: missing.reason
        ).items()
    ]
    conditions, *sure = render_section("difference", of_vehicle, between=SD_BETWEEN_FLIGHTS)
    anew = render_section(
        "difference_parameters", of_vehicle, parameters=parameters, lacking=lacking
    )
    return [*_vehicles(of_vehicle), *anew, *_changes(of_vehicle), *missing, conditions, *sure]


def headline_blocks(headlines: Mapping[str, str | None]) -> Blocks:
    """Returns the ``headlines`` that there are, of each side by itself."""
    return [
        Sentence(said, f"{name.upper()} by itself:") for name, said in headlines.items() if said
    ]


def baseline_blocks(latest: FlightRow, difference: VehicleDifference | None) -> Blocks:
    """Returns what differs between a vehicle's ``latest`` flight and its flights of the baseline."""
    lead = "Since the baseline:"
    if difference is None:
        return [Sentence("the baseline has no flight of this vehicle.", lead)]
    when = "" if latest.date is None else f" ({latest.date:%Y-%m-%d})"
    text = f"the latest flight, {PurePath(latest.file).name}{when}, beside {counted(difference.flights[0], 'flight')}."
    return [Sentence(text, lead), *_changes(difference), *_vehicles(difference)]


def _changes(difference: VehicleDifference) -> Blocks:
    """What changed, what is the same, and what was compared without a result."""
    changed, unknown = (
        [_change(change, difference) for change in difference.of(kind)]
        for kind in (QuantityOutcome.CHANGED, QuantityOutcome.UNCERTAIN)
    )
    same = [*_grouped(difference.of(QuantityOutcome.SAME))]
    return [*render_section("difference_changes", changed=changed, same=same, unknown=unknown)]


def surest_change(difference: VehicleDifference) -> str:
    """Returns what changed most surely; empty where nothing did."""
    changes = sorted(difference.of(QuantityOutcome.CHANGED), key=lambda change: change.p)
    return _change(changes[0], difference) if changes else ""


def next_blocks(difference: VehicleDifference) -> list[Sentence]:
    """Returns the part to check where something changed: of motors that seem weaker the surest; of one vehicle."""
    changes = difference.of(QuantityOutcome.CHANGED)
    if not changes or len({*chain(*difference.vehicles)} - {UNKNOWN}) > 1:
        return []
    change = min(changes, key=lambda change: (not _is_weaker(change), change.p))
    motor = _motor(change, difference) if change.quantity.motor else ""
    return render_section("difference_next", motor=motor, is_weaker=_is_weaker(change))


def _is_weaker(change: QuantityChange) -> bool:
    """Whether a motor works harder, or its work has less effect."""
    (kind, motor, _) = change.quantity
    return motor > 0 and (kind == difference.SHARE) == (change.difference > 0)


def _motor(change: QuantityChange, difference: VehicleDifference) -> str:
    """The name of its motor, where it is of one."""
    motors = difference.motors
    motor = change.quantity.motor
    return without_remark(motors[motor - 1]) if motor <= len(motors) else f"motor {motor}"


def _change(change: QuantityChange, difference: VehicleDifference) -> str:
    """As in "motor 3's share −18 % ± 6 %"."""
    (kind, motor, axis) = change.quantity
    noun, scale, unit = QUANTITIES[kind]
    name = f"{_motor(change, difference)}'s {noun}" if motor else f"{noun} on {axis}"
    more = scale * change.difference
    half = scale * change.half_width
    if change.before is None or change.after is None:
        decimals = 0 if half >= 3 else 1
        return f"{name} {_signed(f'{more:z.{decimals}f}')} % ± {half:.{decimals}f} %"
    values = f"{rounded(scale * change.before)} → {rounded(scale * change.after)} {unit}"
    return f"{name} {values} ({_signed(plus_minus(more, half))})"


def _grouped(changes: Sequence[QuantityChange]) -> Iterator[str]:
    """Names with the widest half width, as in "share of motor 1 and motor 2 (± 2 %)"."""
    for kind, ours in group_by(changes, lambda change: change.quantity.kind).items():
        noun, scale, unit = QUANTITIES[kind]
        names = (
            f"motor {motor}" if motor else axis
            for _, motor, axis in (change.quantity for change in ours)
        )
        widest = scale * max(change.half_width for change in ours)
        yield f"{noun} of {listed(names)} (± {rounded(widest)} {unit})"


def _signed(number: str) -> str:
    return number.replace("-", "−") if number.startswith(("-", "(-")) else f"+{number}"


def _vehicles(difference: VehicleDifference) -> Blocks:
    before, after = difference.vehicles
    if UNKNOWN in (*before, *after):
        return [*render_section("difference_unnamed")]
    others = before and after and set(before) != set(after)
    doubts = render_section(
        "difference_vehicles", before=before, after=after, others=others, found=difference
    )
    return [caution(doubt.text) for doubt in doubts]
