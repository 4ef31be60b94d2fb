"""Charts of one vehicle over its flights: motors, vibration, margins and parameters, flight by flight."""

from collections.abc import Collection, Iterator, Sequence
from datetime import timedelta
from itertools import pairwise
from math import degrees
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.axes import TILT_AXES
from mavdem.fleet.flights import AxisRows, log_row, worst_health
from mavdem.fleet.health_figures import measured_voltage
from mavdem.fleet.names import content_hash
from mavdem.fleet.trims_without_lean import trims_without_lean
from mavdem.report.blocks import truncated
from mavdem.report.charts.chart import Axis, Chart, Group, Line, LineStyle, Mark
from mavdem.report.flight_lines import file_name
from mavdem.report.numbers import TORQUE_UNIT, listed, without_remark
from mavdem.report.palette import BAD, GOOD, LIMITED, distinct

HEALTH_MARKS = {"fault": ("■", BAD), "drift": ("▲", LIMITED)}
"""Symbol and colour of the mark at a flight in which the motors had a fault or a drift, as in lists of flights."""

HEALTHY_MARK = ("✓", GOOD)
"""Symbol and colour of the mark at a flight with which the motors of the others are compared."""

HEALTHY_CAPTION = " ✓: the healthy flights with which the motors of the others are compared, {}."
"""What is added where such flights are marked; their names are filled in."""

PERCENT = 100
"""Percent of the whole."""


ERROR_RATIO_TITLE = "Error ratio of the model (1: as the mean)"
"""Title of the chart of how well the model of each flight predicts it."""

FLIGHTS_CAPTION = """\
Flights stand in order of time, evenly spaced. Points of one flight are drawn side by side, so that all are seen."""
"""What stands below the charts."""

GAPS_CAPTION = " Grey dashed lines: {} without a flight."
"""What is added where months without a flight are marked; their number is filled in, such as "4 months"."""

MIN_MARKED_PAUSE = timedelta(days=61)
"""Time between two flights that is marked: two months, in which batteries age and vehicles are rebuilt. A choice."""

DAYS_OF_MONTH = 30.4
"""Days of a month, on average."""

CLICK_CAPTION = " A click opens the flight."
"""What is added where flights have pages."""

ERROR_RATIO_CAPTION = """\
 Error ratio: mean squared error of the model's predictions, over that of the mean: 0 is perfect, 1 no better."""
"""What is added where that is drawn."""

TRIM_CAPTION = """\
Trim: a motor's output over the mean of all. One that works harder raises that mean too, and so rises by less here \
than over its own output in healthy flights."""
"""What stands below the charts of the motors where one is suspected, of which the text says how much harder it works.

In a quadrotor whose motor works 16 % harder the mean rises by 4 %, and that motor by 1.16 / 1.04 - 1 = 12 % over it.
"""


class AxisQuantity(NamedTuple):
    """A quantity of each flight that is drawn with a line for each axis."""

    title: str
    """Title of the chart, with the shown unit."""

    column: str
    """Field of ``FlightRow`` that has it."""

    scale: float
    """Factor from the unit of the field to the shown one."""

    is_per_input: bool = False
    """Whether it depends on the input that the model was learned from: motors or the mixer's demand."""


AXIS_QUANTITIES = (
    AxisQuantity("Phase margin (°)", "phase_margin", degrees(1)),
    AxisQuantity("Gain margin (dB)", "gain_margin", 1.0),
    AxisQuantity("Rate damping (1/s)", "damping", 1.0, is_per_input=True),
    AxisQuantity("Motor time constant (ms)", "lag", 1e3, is_per_input=True),
    AxisQuantity(f"Wind torque, sd ({TORQUE_UNIT.name})", "wind_torque_sd", TORQUE_UNIT.scale),
    AxisQuantity(ERROR_RATIO_TITLE, "error_ratio", 1.0),
)
"""The quantities that are drawn by axis, in the order of their charts."""

MAX_DATED_FLIGHTS = 200
"""Flights up to which each has its date in the charts, of which each chart has a copy."""

MAX_FILE_LENGTH = 20
"""Letters of a file's name below a chart, about as wide as a date and time."""

TRIM_TITLE = "Trim deviation (%)"
TRIM_WITHOUT_LEAN_TITLE = "Trim without lean (%)"
TITLES_OF_DEVIATIONS = TRIM_TITLE, TRIM_WITHOUT_LEAN_TITLE
"""Titles of the charts of the motors, whose quantity is 0 of even motors."""

VIBRATION_TITLE = "Vibration, first IMU (m/s²)"
VIBRATION_LEVEL_TITLE = "Vibration level, first IMU (m/s²)"
IMU_VIBRATION_TITLE = "Vibration of each IMU, worst axis (m/s²)"
IMU_VIBRATION_LEVEL_TITLE = "Vibration level of each IMU (m/s²)"

TITLES_OF_VIBRATION_LEVELS = VIBRATION_LEVEL_TITLE, IMU_VIBRATION_LEVEL_TITLE
"""Titles of the charts of the one level that PX4 measures of an IMU."""

TITLES_OF_VIBRATIONS = VIBRATION_TITLE, IMU_VIBRATION_TITLE, *TITLES_OF_VIBRATION_LEVELS
"""Titles of the charts of vibration, which have a line at the limit."""

MAX_IMUS = 3
"""IMUs of an autopilot, at most."""

Estimates = dict[str, Array]
"""Estimates and half widths of their intervals (flights, 2) by name of the line; NaN where not known."""


def vehicle_groups(
    flights: Sequence[AxisRows],
    addresses: Sequence[str] = (),
    healthy_logs: Collection[str] = (),
) -> list[Group]:
    """Returns charts that show how the motors and other figures of one vehicle changed from flight to flight.

    The charts of the motors, by which their health is judged, are a group of their own, in the first row.

    Args:
        flights: rows of each flight in the fleet's table, one for each axis, in order of time; at least two flights.
        addresses: address of the page of each flight, which a click opens; empty for a flight without a page.
        healthy_logs: hashes of the contents of the logs with whose flights the motors of the others are compared.

    Returns:
        The charts in groups, the last of which has a caption; empty if no quantity is known.
    """
    if len(flights) > MAX_DATED_FLIGHTS:
        # Each chart has a copy of the addresses, as of the dates, so that those of many flights take too much space.
        addresses = ()
    charts = _charts_over_flights(flights, addresses, healthy_logs)
    if not charts:
        return []
    caption = _caption_of_flights(flights, healthy_logs, has_pages=any(addresses))
    if any(chart.title == ERROR_RATIO_TITLE for chart in charts):
        caption += ERROR_RATIO_CAPTION
    motor_charts = [chart for chart in charts if chart.title in TITLES_OF_DEVIATIONS]
    other_charts = [chart for chart in charts if chart not in motor_charts]
    if not motor_charts or not other_charts:
        return [Group.side_by_side(charts, caption)]
    trim_caption = TRIM_CAPTION if _suspect_motor(flights) else ""
    return [
        Group.side_by_side(motor_charts, trim_caption),
        Group.side_by_side(other_charts, caption).folded_by_title(),
    ]


def _caption_of_flights(
    flights: Sequence[AxisRows], healthy_logs: Collection[str], *, has_pages: bool
) -> str:
    """Returns the caption that explains the horizontal axis of charts over flights: pauses, clicks and healthy flights.

    Args:
        flights: rows of each flight in the fleet's table, in order of time.
        healthy_logs: hashes of the contents of the logs whose flights are healthy.
        has_pages: whether a click on a flight opens its page.
    """
    caption = FLIGHTS_CAPTION
    pauses = _long_pauses(flights)
    if pauses:
        months = [str(round(pause.duration.days / DAYS_OF_MONTH)) for pause in pauses]
        caption += GAPS_CAPTION.format(f"{listed(months)} months")
    if has_pages:
        caption += CLICK_CAPTION
    healthy_flights = [flight for flight in flights if _is_in_logs(flight, healthy_logs)]
    if healthy_flights:
        caption += HEALTHY_CAPTION.format(listed(map(file_name, healthy_flights)))
    return caption


def _is_in_logs(flight: AxisRows, logs: Collection[str]) -> bool:
    """Returns whether the log of a flight is one of the given ones.

    Args:
        flight: rows of the flight in the fleet's table.
        logs: hashes of the contents of the logs.
    """
    return content_hash(log_row(flight).key) in logs


def _charts_over_flights(
    flights: Sequence[AxisRows], addresses: Sequence[str], healthy_logs: Collection[str]
) -> list[Chart]:
    """Returns a chart over the flights for each quantity of motors and model, such as the trims, with 90 % intervals.

    All charts have the marks of :func:`_marks_of_flights`.

    Args:
        flights: rows of each flight in the fleet's table, one for each axis, in order of time.
        addresses: address of the page of each flight; empty for a flight without a page.
        healthy_logs: hashes of the contents of the logs whose flights are healthy.

    Returns:
        The charts; a quantity that is known of fewer than two flights has none, since it shows no change.
    """
    flight_axis = _flight_axis(flights)._replace(addresses=tuple(addresses))
    marks = _marks_of_flights(flights, healthy_logs)
    suspect_motor = _suspect_motor(flights)
    charts = []
    for title, estimates in _charted_quantities(flights):
        if _known_flight_count(estimates) < 2:
            continue
        lines = [*_lines_of_estimates(estimates, suspect_motor)]
        if title in TITLES_OF_VIBRATIONS:
            lines.append(_vibration_limit(title, len(flights)))
        # Motors that all work equally hard deviate by 0, where a horizontal line is drawn.
        levels = (0.0,) if title in TITLES_OF_DEVIATIONS else ()
        # The title has the unit, so that the vertical axis needs no name.
        unnamed_axis = Axis("")
        charts.append(
            Chart(title, flight_axis, unnamed_axis, tuple(lines), levels, marks=tuple(marks))
        )
    return charts


def _marks_of_flights(flights: Sequence[AxisRows], healthy_logs: Collection[str]) -> list[Mark]:
    """Returns marks of flights with a fault or a drift of the motors, of healthy flights, and of months without any.

    Args:
        flights: rows of each flight in the fleet's table, in order of time. The horizontal axis numbers them from 0.
        healthy_logs: hashes of the contents of the logs with whose flights the motors of the others are compared.
    """
    # The line of a pause is half-way between the flights before and after it.
    marks = [Mark(pause.next_flight - 0.5) for pause in _long_pauses(flights)]
    for number, flight in enumerate(flights):
        health = worst_health(flight)
        if health in HEALTH_MARKS:
            symbol, colour = HEALTH_MARKS[health]
            marks.append(Mark(float(number), symbol, colour))
        elif _is_in_logs(flight, healthy_logs):
            symbol, colour = HEALTHY_MARK
            marks.append(Mark(float(number), symbol, colour))
    return marks


class Pause(NamedTuple):
    """Months in which a vehicle did not fly."""

    next_flight: int
    """Index of the flight that ended it."""

    duration: timedelta
    """Time from the flight before to that flight."""


def _long_pauses(flights: Sequence[AxisRows]) -> list[Pause]:
    """Returns the times of at least ``MIN_MARKED_PAUSE`` between two flights in a row whose dates are known.

    Args:
        flights: rows of each flight in the fleet's table, one for each axis, in order of time.
    """
    # None for a log without a date, and for a date in the future, which is a wrong clock.
    dates = [log_row(flight).past_date for flight in flights]
    pauses = []
    # The second flight of the first pair has the index 1.
    for next_index, (date, next_date) in enumerate(pairwise(dates), start=1):
        if date is None or next_date is None:
            continue
        duration = next_date - date
        if duration >= MIN_MARKED_PAUSE:
            pauses.append(Pause(next_index, duration))
    return pauses


def _vibration_limit(title: str, flight_count: int) -> Line:
    """Returns a line over all flights at the vibration, m/s², from which on a flight is judged as to be watched.

    Args:
        title: title of the chart: of the three axes that ArduPilot measures, or of the one level that PX4 measures.
        flight_count: number of flights in the chart.
    """
    # Imported here, since judgements take a second to import, for which the process that tracks flights does not wait.
    from mavdem.assessment.lights.vibration import ARDUPILOT_LEVELS, PX4_LEVELS

    limit = PX4_LEVELS.watch if title in TITLES_OF_VIBRATION_LEVELS else ARDUPILOT_LEVELS.watch
    flight_numbers = np.arange(flight_count, dtype=np.float64)
    return Line(f"watch above {limit:.3g}", LIMITED, flight_numbers, np.full(flight_count, limit))


def _known_flight_count(estimates: Estimates) -> int:
    """Returns in how many flights of a vehicle at least one of the charted quantities is known.

    Args:
        estimates: (flights, 2) estimates and half widths of their intervals by the name of the line, NaN where not
            known.
    """
    indices_of_known_flights: set[int] = set()
    for estimates_of_line in estimates.values():
        values, _ = estimates_of_line.T
        is_known = np.isfinite(values)
        indices_of_known_flights.update(np.flatnonzero(is_known).tolist())
    return len(indices_of_known_flights)


def _flight_axis(flights: Sequence[AxisRows]) -> Axis:
    """Returns the horizontal axis of the charts of a vehicle: the date of each flight, or its file where it has none.

    Below a chart there is room for few dates. Of more than ``MAX_DATED_FLIGHTS`` flights only the first and the last
    have theirs; a page shows the others under the cursor.

    Args:
        flights: rows of the fleet's table, a tuple for each flight with a row for each axis, in order of time.
    """
    first_and_last = (0, len(flights) - 1)
    has_room_for_all = len(flights) <= MAX_DATED_FLIGHTS
    labels = []
    for index, flight in enumerate(flights):
        # None for a log without a date, and for a date in the future, which is a wrong clock.
        date = log_row(flight).past_date
        if date is None:
            labels.append(truncated(file_name(flight), MAX_FILE_LENGTH))
        elif has_room_for_all or index in first_and_last:
            labels.append(f"{date:%Y-%m-%d %H:%M}")
        else:
            labels.append("")
    return Axis("flight (UTC)", names=tuple(labels))


def _suspect_motor(flights: Sequence[AxisRows]) -> str:
    """Returns the name of the motor that failed or is suspected, by the latest flight whose results name one.

    Args:
        flights: rows of each flight, one for each axis, in order of time.

    Returns:
        The name, such as "motor 2"; empty if no flight names a motor.
    """
    motors = _motor_names(flights)
    for flight in reversed(flights):
        for row in flight:
            number = row.failed_motor or row.suspect_motor
            if number is not None and number <= len(motors):
                return motors[number - 1]
    return ""


def _lines_of_estimates(estimates: Estimates, suspect_motor: str) -> Iterator[Line]:
    """Yields a line of dots with whiskers for each series of estimates over the flights of a vehicle.

    A dot is the estimate of one flight, and its whisker the 90 % interval. A line joins the dots, so that a motor that
    weakens from flight to flight can be followed. The abscissa is the number of the flight, from 0 on. Series without a
    finite value are left out, but keep their colours, so that a motor or an axis has the same colour in all charts.

    Args:
        estimates: (flights, 2) estimates and half widths of their intervals, by the name of the line.
        suspect_motor: name of the motor that is suspected of a fault, whose line gets a label; empty for none.
    """
    for number, (name, values_and_half_widths) in enumerate(estimates.items()):
        values, half_widths = values_and_half_widths.T
        if not np.isfinite(values).any():
            continue
        flight_numbers = np.arange(len(values), dtype=np.float64)
        # An unknown half width is NaN. A whisker of length 0 leaves just the dot.
        whiskers = np.nan_to_num(half_widths)
        colour = distinct(number)
        line = Line.with_band(name, colour, flight_numbers, values, whiskers, LineStyle.JOINED_DOTS)
        if name == suspect_motor:
            line = line._replace(remark=f"{name}, suspected")
        yield line


def _charted_quantities(flights: Sequence[AxisRows]) -> Iterator[tuple[str, Estimates]]:
    """Yields the quantities that are drawn over the flights of a vehicle: the title of each chart, and its lines.

    The first chart has the deviation of each motor's output from the mean of all, as it would be without lean, so that
    flights in different winds can be compared. If the positions of the motors are not known in any flight, it has the
    deviations as they were. Charts of the vibration, the battery and the motors' load follow, and of
    ``AXIS_QUANTITIES`` with a line for each axis.

    Args:
        flights: rows of the vehicle's flights, one for each axis, in the order of date.

    Yields:
        Title with the unit, and the estimates of each line by its name.
    """
    yield _motor_deviations(flights)
    yield from _vibrations(flights)
    # How far the voltage falls in a flight shows how the battery ages.
    (voltage_at_start,) = _estimates_of_column(flights, "voltage_start", 1)
    (voltage_at_end,) = _estimates_of_column(flights, "voltage_end", 1)
    yield "Battery (V)", {"start": voltage_at_start, "end": voltage_at_end}
    yield _motor_output(flights)
    yield "Least headroom of a motor (%)", {"headroom": PERCENT * _least_headrooms(flights)}
    # The units of the models' inputs, such as the outputs of the motors or the demand of the controller.
    input_units = set[str]()
    for flight in flights:
        input_units.update(row.per_input for row in flight if row.damping)
    for quantity in AXIS_QUANTITIES:
        # A time constant includes the mixer if the input is the demand: such flights have a chart of their own.
        if quantity.is_per_input and len(input_units) > 1:
            for unit in sorted(input_units):
                title = f"{quantity.title}, per {unit}" if unit else quantity.title
                yield title, _estimates_by_axis(flights, quantity, unit)
        else:
            yield quantity.title, _estimates_by_axis(flights, quantity)


def _vibrations(flights: Sequence[AxisRows]) -> Iterator[tuple[str, Estimates]]:
    """Yields the vibration that is drawn over the flights of a vehicle: the title of each chart, and its lines.

    If a log has several IMUs, the lines are the IMUs, so that one that shakes loose is seen. Otherwise they are what
    the first IMU measured: three axes in logs of ArduPilot, one level of all axes in those of PX4. Both are not
    comparable, and so have a chart each.

    Args:
        flights: rows of the vehicle's flights, one for each axis, in the order of date.

    Yields:
        Title with the unit, and the estimates of each line by its name.
    """
    has_several_imus = any(len(log_row(flight).vibration_imus or ()) > 1 for flight in flights)
    if has_several_imus:
        yield _vibration_of_imus(flights)
        return
    axes = _estimates_of_column(flights, "vibration", 3)
    yield VIBRATION_TITLE, dict(zip("xyz", axes, strict=True))
    (level,) = _estimates_of_column(flights, "vibration", 1)
    yield VIBRATION_LEVEL_TITLE, {"level": level}


def _vibration_of_imus(flights: Sequence[AxisRows]) -> tuple[str, Estimates]:
    """Returns the title of the chart of the vibration of several IMUs, m/s², and its line for each IMU over F flights.

    Args:
        flights: rows of the vehicle's flights, one for each axis, in the order of date.

    Returns:
        Title with the unit; and by the name of each IMU (F, 2) its vibration in each flight, with NaN as the half
        width of its interval, which is not known. NaN where a flight's log lacks the IMU.
    """
    # Logs of PX4 have one level of all axes of an IMU, those of ArduPilot the axis that vibrates most.
    is_of_px4 = any(len(log_row(flight).vibration or ()) == 1 for flight in flights)
    title = IMU_VIBRATION_LEVEL_TITLE if is_of_px4 else IMU_VIBRATION_TITLE
    estimates = np.full((MAX_IMUS, len(flights), 2), np.nan)
    for flight_index, flight in enumerate(flights):
        imu_levels = (log_row(flight).vibration_imus or ())[:MAX_IMUS]
        estimates[: len(imu_levels), flight_index, 0] = imu_levels
    return title, {f"IMU {number}": line for number, line in enumerate(estimates, start=1)}


def _motor_output(flights: Sequence[AxisRows]) -> tuple[str, Estimates]:
    """Returns the title of the chart of the mean motor output, and its line: the output of each flight.

    The output rises as the battery sags. So it is drawn at equal voltage, relative to the first flight, as the motors
    are judged by it: weaker motors or a load raise it. If fewer than two flights have a voltage, it is drawn as it was
    measured.

    Args:
        flights: rows of the vehicle's flights, one for each axis, in the order of date.

    Returns:
        The title with the unit, and the line by its name (flights, 2): output, %, and half width of its interval.
    """
    (mean_output,) = _estimates_of_column(flights, "collective", 1)
    voltages = [measured_voltage(log_row(flight)) for flight in flights]
    voltage = np.array([np.nan if value is None else value for value in voltages])
    # The first column has the outputs, the second the half widths of their intervals.
    efforts = mean_output[:, 0] * voltage
    known_efforts = efforts[np.isfinite(efforts)]
    if len(known_efforts) < 2:
        return "Mean motor output (%)", {"output": PERCENT * mean_output}
    relative_efforts = PERCENT * efforts / known_efforts[0]
    unknown_half_widths = np.full(len(flights), np.nan)
    lines = {"output × voltage": np.column_stack([relative_efforts, unknown_half_widths])}
    return "Output at equal voltage (% of the first)", lines


def _least_headrooms(flights: Sequence[AxisRows]) -> Array:
    """Returns the headroom of the motor that has least of it in hover, as a fraction of the range, in each flight.

    Args:
        flights: rows of the vehicle's flights, one for each axis, in the order of date.

    Returns:
        (flights, 2) like other estimates, with a half width in the second column, which is NaN here since it is not
        known. The headroom is NaN for a flight of which no motor's headroom is known.
    """
    least_headrooms = np.full(len(flights), np.nan)
    for flight_index, flight in enumerate(flights):
        headrooms_of_motors = log_row(flight).headroom or ()
        known_headrooms = [headroom for headroom in headrooms_of_motors if headroom is not None]
        if known_headrooms:
            least_headrooms[flight_index] = min(known_headrooms)
    unknown_half_widths = np.full(len(flights), np.nan)
    return np.column_stack([least_headrooms, unknown_half_widths])


def _motor_deviations(flights: Sequence[AxisRows]) -> tuple[str, Estimates]:
    """Returns the title and the lines of the chart of how much each motor's output deviates from the mean of all, %.

    In wind a vehicle leans, for which its motors must differ. Where the effect of lean is known, it is subtracted
    (:func:`trims_without_lean`), so that flights in different winds can be compared. If it is known of no flight, the
    chart has the deviations that were measured.

    Args:
        flights: rows of the vehicle's flights, one for each axis, in the order of date.

    Returns:
        Title of the chart, which says whether the effect of lean was subtracted; and the deviation of each motor with
        the half width of its 90 % interval.
    """
    known_trims = trims_without_lean(flights)
    if known_trims is None:
        return TRIM_TITLE, _measured_trims(flights)
    # The axes of the array are the motor, the flight, and the pair of estimate and half width.
    trims = np.full((len(known_trims.motors), len(flights), 2), np.nan)
    trims[:, known_trims.flight_indices, 0] = PERCENT * known_trims.estimates.T
    trims[:, known_trims.flight_indices, 1] = PERCENT * known_trims.half_widths.T
    names = [without_remark(motor) for motor in known_trims.motors]
    return TRIM_WITHOUT_LEAN_TITLE, dict(zip(names, trims, strict=True))


def _measured_trims(flights: Sequence[AxisRows]) -> Estimates:
    """Returns how much the mean output of each motor in hover deviates from the mean of all motors, %.

    Args:
        flights: rows of the vehicle's flights, one for each axis, in the order of date.

    Returns:
        Deviation and half width of its 90 % interval (flights, 2) by the name of the motor, NaN where not known.
    """
    motors = _motor_names(flights)
    # (motors, flights, 2): output of each motor in hover, divided by the mean of all motors, and its half width.
    relative_outputs = _estimates_of_column(flights, "trim_share", len(motors))
    trims: Estimates = {}
    for motor, estimates in zip(motors, relative_outputs, strict=True):
        relative_output, half_width = estimates.T
        deviation = relative_output - 1.0
        trims[motor] = PERCENT * np.column_stack([deviation, half_width])
    return trims


def _motor_names(flights: Sequence[AxisRows]) -> list[str]:
    """Returns the names of a vehicle's motors, such as "motor 1", from the latest flight whose rows have them.

    Args:
        flights: rows of each flight in the fleet's table, one for each axis, in order of time.

    Returns:
        The names without the positions in brackets; none if no flight has names.
    """
    for flight in reversed(flights):
        for row in flight:
            if row.motors:
                return [without_remark(name) for name in row.motors]
    return []


def _estimates_by_axis(
    flights: Sequence[AxisRows], quantity: AxisQuantity, input_unit: str = ""
) -> Estimates:
    """Returns a quantity of roll and pitch, such as the rate damping, over the flights of a vehicle, in the shown unit.

    Args:
        flights: rows of each flight in the fleet's table, one for each axis.
        quantity: quantity to read from the rows.
        input_unit: only rows of models with inputs of this unit are used, if the quantity depends on it; empty: all.

    Returns:
        Estimate and half width of its 90 % interval (flights, 2) by axis; NaN where not known.
    """
    estimates = {}
    for axis in TILT_AXES:
        (estimates_of_axis,) = _estimates_of_column(flights, quantity.column, 1, axis, input_unit)
        estimates[axis] = quantity.scale * estimates_of_axis
    return estimates


def _estimates_of_column(
    flights: Sequence[AxisRows], column: str, count: int, axis: str = "", input_unit: str = ""
) -> Array:
    """Reads the estimates in one column of the fleet's table for each flight, with the half widths of their intervals.

    Args:
        flights: the rows of each flight, one for each axis.
        column: name of a field of ``FlightRow`` with a number or a list of numbers. If there is a field of this name
            with "_interval" appended, it has the half widths.
        count: how many numbers a row must have to be used.
        axis: axis of the row to use; empty for the first row with a value.
        input_unit: the row's unit of the input (``per_input``); empty for any.

    Returns:
        (count, flights, 2): the estimate, then its half width; NaN where not known.
    """
    estimates = np.full((count, len(flights), 2), np.nan)
    for flight_index, flight in enumerate(flights):
        for row in flight:
            value = getattr(row, column)
            is_requested_row = axis in ("", row.axis) and input_unit in ("", row.per_input)
            is_usable = value is not None and np.size(value) == count
            if is_requested_row and is_usable:
                half_width = getattr(row, f"{column}_interval", None)
                estimates[:, flight_index, 0] = value
                estimates[:, flight_index, 1] = np.nan if half_width is None else half_width
                # The first such row stands for the flight.
                break
    return estimates
