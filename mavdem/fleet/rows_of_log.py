"""The rows of one log in a fleet's table: its figures by vehicle and axis; and the pages of its flights."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_recording
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.axis.loop_decision import LoopDecision
from mavdem.assessment.axis.responses import LoopResponse
from mavdem.assessment.flown_flights import (
    flights_and_hops,
    flown_flights,
    largest_height,
    total_distance,
    total_time,
)
from mavdem.assessment.record import NoLoop
from mavdem.assessment.severity import severity_rank
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.dataset.signals import Signals
from mavdem.errors import Unreadable
from mavdem.facts import Fact, Level
from mavdem.facts.events import ReportedEvent
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.lights import Light
from mavdem.facts.motors import motor_number
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.fleet.workers import PAGES, LogRows, MakePage, reading_failure
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.loops.axis_loops import Loop
from mavdem.motors.balance import balance_of_steady_flight
from mavdem.wind_velocity.velocity import WindVelocity

REPORT = "report.json"
"""File with the figures of a flight, in the folder that ``mavdem learn`` writes."""

MODEL = "model.json"
"""File with the learned model, in the folder that ``mavdem learn`` writes."""

PAGE_KEY_LETTERS = 16
"""Letters of the hash of a log's content that name the pages of its flights: 64 bits, so that no two logs share one."""


def rows_of_log(path: Path, key: str = "", make_page: MakePage | None = None) -> LogRows:
    """Reads and judges a log.

    Each vehicle is assessed by itself. An error that concerns one of several vehicles becomes a row with its reason.

    Args:
        path: path of the log.
        key: hash and size of the log's content, by which its pages are named.
        make_page: function that makes the HTML of a flight's page from the log's name and its assessment; no pages
            unless given.

    Returns:
        A row for each vehicle and axis, and the HTML of pages by the name of the file. A vehicle without settled flight
        has one row, whose status says why.

    Raises:
        Unreadable: the log cannot be read.
    """
    log = read_log(path)
    rows = []
    pages = {}
    for telemetry in log.vehicles:
        try:
            assessment = assess_recording(log, Signals(telemetry)).with_axis("pitch")
            vehicle_rows = rows_of_assessment(assessment, str(path))
        # These errors concern the log as a whole.
        except (MemoryError, OSError, Unreadable):
            raise
        # Another error is of this vehicle only: the other vehicles of the log keep their rows.
        except Exception as error:
            if len(log.vehicles) == 1:
                raise
            rows.append(_row_of_failed_vehicle(path, telemetry, error))
            continue
        if make_page is not None and has_page(vehicle_rows):
            page_name = f"{key[:PAGE_KEY_LETTERS]}-{telemetry.system}-{telemetry.component}.html"
            pages[page_name] = make_page(path.name, assessment)
            vehicle_rows = [replace(row, page=f"{PAGES}/{page_name}") for row in vehicle_rows]
        rows += vehicle_rows
    if not rows:
        rows = [FlightRow.without_flight(str(path), Fact(ReadingFact.NO_VEHICLE))]
    return LogRows(rows, pages)


def has_page(rows: FlightRows) -> bool:
    """Returns whether a vehicle has a page: if it flew, or if it is no multirotor, of which some lights are judged.

    Args:
        rows: rows of the vehicle, all of the same flight.
    """
    return rows[0].has_flight or rows[0].status_code == NotLearnableReason.NO_MULTIROTOR


def _row_of_failed_vehicle(path: Path, telemetry: Telemetry, error: Exception) -> FlightRow:
    """Returns the row of one vehicle of a log whose assessment failed, with the error as its status.

    Args:
        path: path of the log.
        telemetry: messages of the vehicle, which give its MAVLink ids.
        error: the error that ended the assessment.
    """
    return FlightRow.without_flight(
        str(path),
        reading_failure(error),
        system=telemetry.system,
        component=telemetry.component,
    )


def rows_of_assessment(assessment: Assessment, file: str) -> FlightRows:
    """Returns the rows of a fleet's table for one vehicle of a log: one for each axis that was analysed.

    Most columns are the same in all of them: balance of the motors, wind, positions of the motors. Model and stability
    margins belong to the axis. Without settled flight there is one row, of no axis, whose status says why.

    Args:
        assessment: assessment of a vehicle, with its evidence and analysis.
        file: path or URL of its log.

    Returns:
        The rows, in the order of the axes.
    """
    assert assessment.analysis is not None and assessment.evidence is not None
    judgement = assessment.judgement_values | {
        "headline": assessment.stated_headline,
        "headline_fact": assessment.headline,
    }
    _, headline_rank = severity_rank(assessment.headline)
    columns = {
        "file": file,
        "headline_rank": headline_rank,
        "component": assessment.evidence.signals.telemetry.component,
        "failed_motor": motor_of_light(assessment, Level.BAD),
        "watched_motor": motor_of_light(assessment, Level.WATCH),
        **_flown_columns(assessment),
    }
    if not assessment.has_settled_flight:
        return [_row_without_flight(assessment, judgement, columns)]
    # Columns on the motors do not depend on the axis, so that the signals of any one will do.
    any_axis = AXES[0]
    signals = assessment.evidence.signals.for_axis(any_axis, inputs="motors")
    columns |= _balance_columns(signals) | _geometry_columns(signals)
    vibration = assessment.analysis.condition.vibration
    if vibration is not None:
        columns["vibration_imus"] = vibration.imu_levels
    if assessment.wind is not None:
        columns |= wind_columns(assessment.wind)
    rows = []
    for axis, analysis in assessment.analyses.items():
        report = analysis.report_values | judgement
        columns_of_axis = _loop_columns(assessment, axis) | _mean_columns(analysis)
        rows.append(FlightRow.from_report(report, axis=axis, **columns, **columns_of_axis))
    return rows


def _flown_columns(assessment: Assessment) -> JsonValues:
    """Returns the columns on how a log was flown: how long and far, in which modes and with which control parameters.

    Args:
        assessment: assessment of a vehicle, with its evidence.

    Returns:
        Values by name of the column: the number of flights; time in the air (s), distance and height (m) of all of them
        together, None where not known; the modes; the control parameters as JSON; and whether the flight was simulated,
        0 or 1.
    """
    assert assessment.evidence is not None and assessment.recorded_signals is not None
    signals = assessment.evidence.signals
    # A dictionary keeps the order of the first use of each mode.
    modes = dict[str, None]()
    for event in assessment.events:
        if event.code is ReportedEvent.MODE_CHANGED:
            modes[event.subject] = None
    parameters = signals.telemetry.parameters
    gains = {name: value for name, value in parameters.items() if CONTROL_PARAMETERS.match(name)}
    flights = flown_flights(assessment.recorded_signals)
    return {
        "simulated": int(assessment.simulated is not None),
        "flight_count": len(flights),
        # The hops are part of the time in the air, as in that of a report.
        "flight_time": total_time(flights_and_hops(assessment.recorded_signals)),
        "distance": total_distance(flights),
        "height": largest_height(flights),
        "modes": tuple(modes),
        "control_parameters": json.dumps(gains),
    }


def _loop_columns(assessment: Assessment, axis: str) -> JsonValues:
    """Returns the columns of the control loops of an axis: margins, step response, and the decision on them.

    Args:
        assessment: all results on the vehicle: events, status lights, model, loops and wind.
        axis: "roll", "pitch" or "yaw".
    """
    columns: JsonValues = {}
    loop = assessment.loops[axis]
    # A column cannot say that its number is doubtful, so the margins of a doubtful loop are left out.
    is_doubtful = axis in assessment.axes_with_doubtful_loop
    if not isinstance(loop, NoLoop) and not is_doubtful:
        columns = margin_columns(loop)
    responses_of_axis = assessment.responses.get(axis, {})
    columns |= step_columns(responses_of_axis.get("rate"))
    columns |= decision_columns(assessment.loop_decisions.get(axis))
    return columns


def motor_of_light(assessment: Assessment, level: Level) -> int | None:
    """Returns the number, from 1, of the motor that the motors' status light of a log is about, if it has a level.

    A bad light blames the motor for a crash or a loss of thrust; a light with the level watch warns of it.

    Args:
        assessment: assessment of one vehicle of the log.
        level: the level that the light must have.

    Returns:
        The number; None if the light has another level, or is not about one motor.
    """
    # The status light is a fact with a level, whose subject is the motor that it is about.
    motors_light = assessment.lights[Light.MOTORS]
    if motors_light.level is not level:
        return None
    return motor_number(motors_light.subject)


def _row_without_flight(
    assessment: Assessment, judgement: JsonValues, columns: JsonValues
) -> FlightRow:
    """Creates the row of a vehicle that flew too briefly for figures, or whose log lacks messages.

    Args:
        assessment: assessment of the vehicle, with an analysis. The reason for the missing figures becomes the status
            of the row.
        judgement: headline and lights, by name.
        columns: values of columns that do not depend on a flight, such as the file.

    Returns:
        The row, with the columns of a model and of an axis empty.
    """
    assert assessment.analysis is not None
    reason = assessment.analysis.reason or assessment.headline
    return FlightRow.from_report(
        assessment.analysis.report_values | judgement,
        status=reason.sentence_and_remedy,
        status_code=reason.code,
        warnings=(),
        warning_codes=(),
        axis=None,
        tier=None,
        tier_reason=None,
        attitude_rate=None,
        **columns,
    )


def _balance_columns(signals: Signals) -> JsonValues:
    """Returns the columns of the motors' balance in steady flight: which steady commands keep the vehicle level.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        By name of the column, with standard errors in columns ``…_error``; empty if the balance is not known:

        - ``balance``: mean commands in roll, pitch and yaw (3,), as fractions of the mean command of all motors;
        - ``balance_lean``: mean roll and pitch (2,), rad;
        - ``lean_effect``: change of each of the three commands with roll and with pitch, 1/rad (six numbers: roll
          command by roll, roll command by pitch, pitch command by roll, …).
    """
    balance = balance_of_steady_flight(signals)
    if balance is None:
        return {}
    return {
        "balance": balance.mean,
        "balance_error": balance.error,
        "balance_lean": balance.lean,
        # A column of the table is flat, so that the rows of the array (3, 2) follow each other.
        "lean_effect": balance.lean_effect.ravel(),
        "lean_effect_error": balance.lean_effect_error.ravel(),
    }


def _geometry_columns(signals: Signals) -> JsonValues:
    """Returns the columns with the positions and directions of rotation of the motors; empty without motor outputs.

    Args:
        signals: logged time series of the vehicle, with its motor outputs.
    """
    if signals.motors is None:
        return {}
    geometry = signals.motors.geometry
    # A geometry that is not known is empty, and its columns None.
    return {"positions": geometry.positions or None, "spins": geometry.spins or None}


def wind_columns(wind: WindVelocity) -> JsonValues:
    """Returns the columns of wind and drag.

    Args:
        wind: estimate of the wind, its direction in degrees.

    Returns:
        By name of the column:

        - ``wind_speed``, m/s, with both ends of its 90 % interval (:func:`_wind_speed_columns`);
        - ``wind_direction``, rad, with the half width of its interval, if the direction is identifiable;
        - ``drag``, four coefficients with the half widths of their intervals: linear along body x and y, 1/s, then
          quadratic, 1/m.
    """
    columns = _wind_speed_columns(wind)
    if wind.direction_identifiable:
        columns["wind_direction"] = np.radians(wind.direction)
        columns["wind_direction_interval"] = np.radians(wind.direction_interval)
    drag = wind.drag
    columns["drag"] = (*drag.linear, *drag.quadratic)
    # An interval is given by its two ends, whose difference is twice the half width.
    linear_half_widths = np.ptp(drag.interval("linear"), axis=0) / 2
    quadratic_half_widths = np.ptp(drag.interval("quadratic"), axis=0) / 2
    columns["drag_interval"] = np.ravel([linear_half_widths, quadratic_half_widths])
    return columns


def _wind_speed_columns(wind: WindVelocity) -> JsonValues:
    """Returns the columns of the mean wind speed and of both ends of its 90 % interval, m/s.

    In calm air, where the velocity may have been 0, the speed is None, and the interval is that of the speed of the
    mean wind vector. If the speed is not identifiable, it is None too, and the interval has the bounds that the fact
    about it states.

    Args:
        wind: estimate of the wind.
    """
    speed = None
    if not wind.speed_identifiable:
        bounds = wind.reasons["speed"].figures
        interval = (bounds["low"], bounds["high"])
    elif wind.calm:
        interval = wind.speed_interval
    else:
        speed = wind.mean_speed
        interval = wind.mean_speed_interval
    return {"wind_speed": speed, "wind_speed_interval": interval}


def decision_columns(decision: LoopDecision | None) -> JsonValues:
    """Returns the columns with the decision on the loops of an axis: what is wrong with them, and the advised action.

    Args:
        decision: decision on the loops of one axis; None without identified loops.

    Returns:
        ``loop_verdict``, the value of the diagnosis, such as "oscillates"; and ``loop_action``, the advice in
        sentences, None if nothing is to be done. Empty without a decision.
    """
    if decision is None:
        return {}
    action = None if decision.action is None else decision.action.sentence_and_remedy
    return {"loop_verdict": str(decision.diagnosis), "loop_action": action}


def margin_columns(loop: Loop) -> JsonValues:
    """Returns the columns of the stability margins of an axis, with half widths of their 90 % intervals.

    Args:
        loop: the identified loops, with their margins in degrees and dB and both ends of their intervals.

    Returns:
        Phase margins, rad, and gain margins, dB, of the rate and the attitude loop, and the maximum sensitivity Ms of
        the rate loop, by the names of their columns.
    """
    attitude = loop.attitude
    return {
        "phase_margin": np.radians(loop.phase_margin),
        "phase_margin_interval": np.radians(np.ptp(loop.phase_margin_interval)) / 2,
        "gain_margin": loop.gain_margin,
        "gain_margin_interval": np.ptp(loop.gain_margin_interval) / 2,
        "ms": loop.ms,
        "ms_interval": np.ptp(loop.ms_interval) / 2,
        "attitude_phase_margin": np.radians(attitude.phase_margin),
        "attitude_phase_margin_interval": np.radians(np.ptp(attitude.phase_margin_interval)) / 2,
        "attitude_gain_margin": attitude.gain_margin,
        "attitude_gain_margin_interval": np.ptp(attitude.gain_margin_interval) / 2,
    }


def step_columns(response: LoopResponse | None) -> JsonValues:
    """Returns the columns of overshoot and rise time of a rate loop's step response.

    Args:
        response: response of the rate loop of an axis, with its measured step response where there is one.

    Returns:
        The source of the step response, and overshoot and rise time (s) with half widths of their 90 % intervals, by
        the names of their columns. Empty without a response, or if it was not measurable, or is doubtful.
    """
    if response is None or isinstance(response.measured, Fact):
        return {}
    step_response = response.measured
    if step_response.is_doubtful:
        return {}
    source = "identified_loop" if step_response.is_identified else "measured"
    columns: JsonValues = {"rate_step_source": source}
    # Each is the estimate with both ends of its 90 % interval.
    estimates = {
        "rate_overshoot": step_response.overshoot,
        "rate_rise": step_response.rise_time,
    }
    for name, (estimate, low, high) in estimates.items():
        columns[name] = estimate
        half_width = (high - low) / 2
        columns[f"{name}_interval"] = half_width
    return columns


def _mean_columns(analysis: LogAnalysis) -> JsonValues:
    """Returns the columns with the means of inputs (r,) and outputs (m,) over the training data of a model.

    The model of a healthy flight predicts other flights of the vehicle by the change of these means
    (``mavdem.fleet.tracking.residual_mean``).

    Args:
        analysis: analysis of one axis of the log, with the model if one was learned.

    Returns:
        ``mean_inputs`` (r,) and ``mean_outputs`` (m,) in the units of the data; empty without a model.
    """
    if analysis.learned is None:
        return {}
    inputs = np.concatenate([flight.inputs for flight in analysis.flights])
    outputs = np.concatenate([flight.outputs for flight in analysis.flights])
    return {"mean_inputs": inputs.mean(axis=0), "mean_outputs": outputs.mean(axis=0)}


def file_text(path: Path) -> str:
    """Returns the text of a file.

    Args:
        path: the file.

    Raises:
        OSError: it cannot be read, or it is a pipe or a device, which may never end.
    """
    if path.is_fifo() or path.is_char_device():
        raise OSError(errno.ESPIPE, os.strerror(errno.ESPIPE))
    return path.read_text(encoding="utf-8")
