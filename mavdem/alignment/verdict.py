"""The verdict: can a model of one axis be learnt from a log; if not, why and what to change; if so, its cautions."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from typing import Any

import numpy as np

from mavdem.alignment import phases, quality
from mavdem.alignment.align import Segment, align, settled_segments
from mavdem.alignment.drive import (
    DEMAND_MESSAGE,
    FLY,
    MAX_BODY_RATE,
    TILT_AXES,
    Motors,
    Obstacle,
    motors_or_obstacle,
)
from mavdem.alignment.quality import CONSISTENCY_SPAN, QualityFigures
from mavdem.alignment.signals import MINIMUM_RATE, Attitude, Signals, usual_rate
from mavdem.flight import Flight
from mavdem.ingest import Component
from mavdem.ingest.motors import MULTIROTORS
from mavdem.ingest.telemetry import Telemetry

ADVICE: dict[str, str] = tomllib.loads(
    (files("mavdem.alignment") / "rate_advice.toml").read_text("utf-8")
)
"""Sentences by ``Telemetry.translated_from`` or else by autopilot."""
STREAMS_OFF = "`set streamrate -1`"  # of MAVProxy
REQUEST = "REQUEST_DATA_STREAM"
SET_MESSAGE_INTERVAL = 511
"""How ground stations ask a vehicle for rates: a message, and a command of MAV_CMD."""
STREAM_RATE = re.compile(r"(SR|MAV)\d+_(EXTRA1|RC_CHAN)$")
"""ArduPilot's parameters for the rates of attitude and motor outputs on each port; MAV from 4.7 on."""
RATE_LIMITS = {"LOG_FILE_RATEMAX": 1, "LOG_MAV_RATEMAX": 2, "LOG_BLK_RATEMAX": 4}
"""ArduPilot's limits of the rate of each message, Hz, 0 for none, and the bits of LOG_BACKEND_TYPE that use them."""
FIRMWARE_VERSION = re.compile(r"V(\d+)\.(\d+)")
DEMAND_SINCE = (3, 3)
"""Where ArduCopter's version is in what it calls itself, and the first that logs RATE; some builds of its development
did not."""


def ask_for_rate(
    telemetry: Telemetry, rate: int = 100, components: Sequence[Component] = ()
) -> str:
    """Returns how to get attitude and motors at ``rate`` Hz out of this autopilot, by the settings that its log shows.

    How to stop one of the ``components`` from asking for rates comes first: those hold whatever the settings.
    """
    kept = _kept_from_asking(telemetry, components)
    recorder = telemetry.translated_from
    if recorder in ("DataFlash", "ULog"):
        return kept + (_dataflash(telemetry) if recorder == "DataFlash" else _ulog(telemetry))
    advice = ADVICE.get(recorder or telemetry.autopilot) or ADVICE.get(
        telemetry.autopilot, ADVICE[""]
    )
    streams_off = "" if STREAMS_OFF in kept else f"{STREAMS_OFF}, "
    values = {
        "interval": round(1e6 / rate),
        "stream_rates": _stream_rates(telemetry, rate),
        "streams_off": streams_off,
    }
    return kept + advice.format(rate=rate, **values)


def _kept_from_asking(telemetry: Telemetry, components: Sequence[Component]) -> str:
    own = (telemetry.system, telemetry.component)
    others = (
        one for one in components if REQUEST in one.messages and (one.system, one.component) != own
    )
    if asking := ", ".join(f"{one.system}:{one.component}" for one in others):
        off = f"switch that off (in MAVProxy with {STREAMS_OFF})"
        return f"A ground station ({asking}) sets rates with {REQUEST}: {off}. "
    replies = telemetry.messages.get("COMMAND_ACK")
    if replies is None or not (np.asarray(replies["command"]) == SET_MESSAGE_INTERVAL).any():
        return ""
    acknowledged = (
        "Somebody asks for rates with SET_MESSAGE_INTERVAL, which the vehicle acknowledged"
    )
    return f"{acknowledged}: let them ask for more, or for none. "


def _stream_rates(telemetry: Telemetry, rate: int) -> str:
    asked = {name: value for name, value in telemetry.parameters.items() if STREAM_RATE.match(name)}
    old = "SRn_EXTRA1 and SRn_RC_CHAN"
    new = "MAVn_EXTRA1 and MAVn_RC_CHAN"
    named = new if all(name.startswith("MAV") for name in asked) else old
    named = named if asked else f"{old} ({new} from ArduPilot 4.7)"
    ports = {
        port: (f"{port}_EXTRA1", f"{port}_RC_CHAN")
        for port in sorted({name.partition("_")[0] for name in asked})
    }
    fast = [
        " and ".join(both)
        for both in ports.values()
        if min(asked.get(one, 0) for one in both) >= MINIMUM_RATE
    ]
    if not fast:
        return f"Set the telemetry port's {named} to {rate}"
    known = f"{', '.join(fast)} are {MINIMUM_RATE:.0f} or more already: if that is the port of this link, reboot, and "
    known += "raise its baud rate if that does not help."
    return f"{known} Otherwise set the {named} of this link's port to {rate}"


def _dataflash(telemetry: Telemetry) -> str:
    """How to log attitude and the demand fast with ArduPilot; ArduCopter logs motor outputs (RCOU) at 10 Hz."""
    bitmask = telemetry.parameters.get("LOG_BITMASK")
    firmware = telemetry.firmware
    is_set = bitmask is not None and bool(int(bitmask) & 1)
    already = "Bit 0 of LOG_BITMASK (fast attitude) is set already"
    found = FIRMWARE_VERSION.search(firmware)
    version = (int(found[1]), int(found[2])) if found else (0, 0)
    logs_demand = version > DEMAND_SINCE or (version == DEMAND_SINCE and "-dev" not in firmware)
    if DEMAND_MESSAGE not in telemetry.messages and (is_set or (found and not logs_demand)):
        missing = f"{already}, but there is no demand (RATE with ROut)"
        give = "give the log as the autopilot wrote it"
        if logs_demand:
            return f"{missing}, which {firmware} logs then: {give}, or fly anew."
        if not found:
            return f"{missing}: {give}, or fly anew with a firmware that logs it, such as ArduCopter from 3.3 on."
        bit = "; LOG_BITMASK has bit 0 (fast attitude) set already"
        anew = (
            f"and fly again{bit if is_set else ' with bit 0 of LOG_BITMASK (fast attitude) set'}."
        )
        since = f"install ArduCopter {'.'.join(map(str, DEMAND_SINCE))} or later, which APM 2 boards cannot run"
        return f"{firmware} did not log the controller's demand (RATE with ROut): {since}, {anew}"
    backends = int(telemetry.parameters.get("LOG_BACKEND_TYPE", 7))
    limits = {
        name: telemetry.parameters.get(name, 0.0)
        for name, backend in RATE_LIMITS.items()
        if backend & backends
    }
    low = [
        f"{name}, {limit:g} Hz in this log, to 0"
        for name, limit in limits.items()
        if 0 < limit < MINIMUM_RATE
    ]
    effect = f"{''.join(f', and {one}' for one in low)}, which logs attitude and the demand at 50 Hz or more; fly anew."
    if bitmask is None:
        return f"If it is not set (the log does not show it), set bit 0 of LOG_BITMASK (fast attitude){effect}"
    if not is_set:
        changed = f"set it to {int(bitmask) | 1}, with bit 0 (fast attitude)"
        return f"LOG_BITMASK is {int(bitmask)} in this log: {changed}{effect}"
    if low:
        return (
            f"{already}, but the rate of messages is limited: set {', and '.join(low)}; fly anew."
        )
    if telemetry.dropouts:
        card = "use a faster card, raise LOG_FILE_BUFSIZE or clear other bits of LOG_BITMASK; fly anew."
        return f"{already}, but the logger had no room for {telemetry.dropouts} messages: {card}"
    late = "fly anew if the bit was set after this flight began"
    load = "look at the load of the board (PM) and at what else the log was passed through"
    return f"{already}, and the log does not show why messages come no faster: {late}, and {load}."


def _ulog(telemetry: Telemetry) -> str:
    profile = telemetry.parameters.get("SDLOG_PROFILE")
    effect = "which logs attitude and the demand fast; reboot and fly anew."
    if profile is None:
        lacking = (
            "this PX4 has no such parameter: update it"
            if telemetry.parameters
            else "the log does not show it"
        )
        return f"Set SDLOG_PROFILE to 17 (default and high rate; {lacking}), {effect}"
    fast = int(profile) | 1 << 4  # the high rate
    if fast != int(profile):
        return f"SDLOG_PROFILE is {int(profile)} in this log: set it to {fast} (adds the high rate, bit 4), {effect}"
    already = f"SDLOG_PROFILE is {int(profile)}, so the high rate (bit 4) is set already"
    if telemetry.dropouts:
        return f"{already}, but the logger dropped out {telemetry.dropouts} times: use a faster card and fly anew."
    topics = "remove etc/logging/logger_topics.txt from the card if it is there, because it replaces the profile"
    return f"{already}: reboot if it was set after this boot, and {topics}; fly anew."


REFUSED_SNR = 1.0
DOUBTFUL_SNR = 20.0
"""Variance over that of its rounding, of the motors' command and of the outputs' changes. Rounding what something is
learnt from can shrink what is learnt to SNR/(1 + SNR) of the truth: to half at 1, by 5 % at 20."""
REFUSED_CONSISTENCY = 0.5
DOUBTFUL_CONSISTENCY = 0.8
"""Share of the angle's changes over ``CONSISTENCY_SPAN`` that the integrated rates explain. Both measure one motion;
where they disagree, the rate is an alias, noise, or in another unit: some of it, or most."""
STILL_RATE = np.radians(1.0)  # rad/s, standard deviation: twice the noise of a gyroscope in flight
DOUBTFUL_LOSS = 0.05  # Share of a stream's messages left out as damaged: the rest may be too
NEEDED = f"motion has frequencies of several Hz, which need {MINIMUM_RATE:.0f} Hz of attitude and of motor outputs or "
NEEDED += "demand, better 100"
IMPOSSIBLE = f"an angle beyond 2π or a rate beyond {MAX_BODY_RATE:.0f} rad/s"


def _measured(axis: str, between: str) -> str:
    """What a flight of ``axis`` has, in words: "roll angle or rate"."""
    return f"{axis} angle {between} rate" if axis in TILT_AXES else f"{axis} rate"


def _steps(axis: str, figures: QualityFigures) -> str:
    angle = f"{figures.angle_step:.2g} rad and " if axis in TILT_AXES else ""
    return f"{angle}{figures.rate_step:.2g} rad/s"


def cautions_of(signals: Signals, figures: QualityFigures) -> tuple[str, ...]:
    """Returns sentences on messages of attitude and inputs that were left out, and on a segment of ``figures``."""
    axis = signals.axis
    attitude = signals.attitude
    drive = signals.drive
    called = signals.telemetry.called
    assert attitude is not None and drive is not None
    cautions = []
    if attitude.impossible:
        what = f"{attitude.impossible} of {attitude.sent} {called(attitude.message)} messages"
        cautions.append(f"{what} were left out, for {IMPOSSIBLE}.")
    for stream in (attitude, drive):
        if stream.left_out > DOUBTFUL_LOSS * stream.sent:
            wrong = (
                "their time stamps are far off or those of others, or their numbers make no sense."
            )
            what = f"{stream.left_out} of {stream.sent} {called(stream.message)} messages"
            cautions.append(f"{what} were left out: {wrong}")
    layout = drive.layout
    if drive.message == DEMAND_MESSAGE:
        rate = 0.0 if signals.motors is None else usual_rate(signals.motors)
        slowly = f"come too slowly ({below(rate, MINIMUM_RATE)} Hz)" if rate else "are missing"
        lead = "The" if rate >= MINIMUM_RATE else f"Motor outputs {slowly}, so the"
        within = "the model includes the mixer, the motors' limits and the battery."
        cautions.append(f"{lead} input is the controller's {axis} demand, and {within}")
    if signals.telemetry.vehicle == "UNKNOWN":
        cautions.append("No heartbeat says what the vehicle is: a multirotor was assumed.")
    if layout.channels_assumed or layout.positions_assumed:
        cautions.append(f"Which motor is which was assumed: {layout.basis}.")
    if figures.output_snr is not None and figures.output_snr < DOUBTFUL_SNR:
        near = f"near the resolution of the stream (steps of {_steps(axis, figures)})"
        shrunk = f"what is learnt of the dynamics by {100 * min(1.0, 1 / (1 + figures.output_snr)):.0f} %."
        cautions.append(f"The {_measured(axis, 'or')} is {near}: rounding can shrink {shrunk}")
    if figures.consistency is not None and figures.consistency < DOUBTFUL_CONSISTENCY:
        cautions.append(
            f"The rate explains only {figures.consistency:.2f} of the angle's changes: noise, or an alias."
        )
    return tuple(cautions)


def below(value: float, limit: float) -> str:
    """Returns the value with as many decimals, at least one, as show that it is below the limit."""
    return next(
        (text for digits in range(1, 6) if float(text := f"{value:.{digits}f}") < limit),
        f"{value:.6g}",
    )


MINIMUM_DURATION = 5.0
"""Seconds: a few swings of an axis that moves at 1 Hz, and a few hundred samples for a few tens of parameters."""
REFUSED_IMPOSSIBLE = 0.01
"""Share of messages with an angle or a rate that cannot be: too many for odd ones, so they are in another unit."""
NO_ATTITUDE = {
    "": "There is no ATTITUDE or ATTITUDE_QUATERNION message.",
    "DataFlash": "There is no ATT or ANG message with the angles, or no RATE or IMU with the body rates.",
    "ULog": "There is no vehicle_attitude, or no vehicle_angular_velocity with the body rates.",
    "MAVROS": "There is no imu/data.",
}
"""A sentence on attitude that was not recorded, by ``Telemetry.translated_from``."""
NO_ATTITUDE["uXRCE-DDS"] = NO_ATTITUDE["ULog"]
MAX_STEP_RATIO = 1.25
"""Mean step of a segment's messages, over that of the longest segment, up to which both are sampled alike: a link that
loses a fifth of the messages makes it so, as in ``MINIMUM_RATE``."""


@dataclass(frozen=True)
class Verdict:
    """Whether a model of ``axis`` can be learnt."""

    axis: str
    learnable: bool  # yes or no
    reason: str  # one sentence with the figures that decided
    remedy: str  # what to change, with the command where there is one; empty when learnable
    cautions: tuple[str, ...]  # one sentence for each thing that makes a model less reliable
    # the one to learn from or, when refused, the longest; None when there is none
    segment: Segment | None
    figures: QualityFigures  # measured on it
    # the aligned segment, if there is one
    flight: Flight | None = field(default=None, repr=False, compare=False)
    # all of settled flight, the longest first
    segments: tuple[Segment, ...] = field(default=(), repr=False)

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values, without the flight and the other segments."""
        values = asdict(replace(self, flight=None, segments=()))
        return {name: value for name, value in values.items() if name not in ("flight", "segments")}


def verdict_of(
    signals: Signals, components: Sequence[Component] = (), least_rate: float = MINIMUM_RATE
) -> Verdict:
    """Returns the verdict: yes on the longest settled segment that can be learnt from, or no on the longest.

    The ``components`` of the log may ask for other rates; ``least_rate``, Hz, is what both streams need.
    """
    return next(segment_verdicts(signals, components, least_rate))


def segment_verdicts(
    signals: Signals, components: Sequence[Component] = (), least_rate: float = MINIMUM_RATE
) -> Iterator[Verdict]:
    """Yields the verdict of :func:`verdict_of` and, if that is yes, one on each other segment that is long enough.

    All flights have the sampling step of the first; a segment too slow for that (``MAX_STEP_RATIO``) is refused.
    """
    attitude = signals.attitude
    drive = signals.drive
    figures = QualityFigures()
    found: tuple[Segment, ...] = ()
    objection = _unusable(signals, components)
    if objection is None:
        assert attitude is not None and drive is not None
        found = settled_segments(signals)
        figures = quality.of_log(signals, len(found))
        log = _Evidence(signals, attitude, drive, components, figures, least_rate)
        if figures.armed == 0:
            objection = _NEVER_ARMED, FLY
        elif figures.airborne == 0:
            objection = _grounded(signals, figures)
        elif not found:
            objection = _too_slow(log, figures) or _slowed_down(log) or _too_short(log, figures)
    if objection is not None:
        yield Verdict(signals.axis, False, *objection, (), None, figures)
        return
    # Of the segments too short the longest only, if there is no other.
    long = [segment for segment in found if segment.duration >= MINIMUM_DURATION] or found[:1]
    judged: list[Verdict] = []
    for segment in long:
        judged.append(_of_segment(log, segment, found))
        if judged[-1].learnable:
            break
    first = judged[-1] if judged[-1].learnable else judged[0]
    yield first
    if first.learnable and first.flight is not None:
        yield from (
            _of_segment(log, other, found, first.flight.dt)
            for other in long
            if other != first.segment
        )


def _unusable(signals: Signals, components: Sequence[Component]) -> Obstacle | None:
    """Why no flight need be looked for in a log, if that is so."""
    telemetry = signals.telemetry
    attitude = signals.attitude
    drive = signals.drive
    if telemetry.vehicle not in (*MULTIROTORS, "UNKNOWN"):
        source = "The log" if telemetry.translated_from else "HEARTBEAT"
        reason = f"{source} reports the type {telemetry.vehicle}; mavdem learns multirotors only."
        other = next((each for each in components if each.kind in MULTIROTORS), None)
        named = (
            f", or name the {other.kind} of this log: `--vehicle {other.system}:{other.component}`"
            if other
            else ""
        )
        return reason, f"Give a multirotor's log{named}."
    if attitude is None:
        return NO_ATTITUDE.get(telemetry.translated_from, NO_ATTITUDE[""]), ask_for_rate(telemetry)
    if drive is None:
        never = signals.armed is not None and not signals.armed.values.any()
        return (_NEVER_ARMED, FLY) if never else _without_drive(signals)
    if attitude.impossible > REFUSED_IMPOSSIBLE * attitude.sent:
        messages = f"{attitude.impossible} of {attitude.sent} {telemetry.called(attitude.message)} messages"
        unit = "the unit of its format" if telemetry.names else "radians"
        remedy = "Check what wrote the log: MAVLink's attitude is in rad and rad/s, DataFlash's in degrees."
        return f"{messages} have {IMPOSSIBLE}: the attitude is not in {unit}.", remedy
    if not len(attitude.time):
        reason = f"{telemetry.called(attitude.message)} holds no finite {_measured(signals.axis, 'and')}."
        return reason, "Check the autopilot's estimator and what wrote the log."
    return None


def _of_segment(
    log: _Evidence, segment: Segment, found: tuple[Segment, ...], dt: float | None = None
) -> Verdict:
    signals = log.signals
    flight = align(signals, segment, dt)
    figures = quality.of_segment(signals, segment, flight, log.figures)
    objection = _objection(log, figures)
    slower = min(figures.attitude_rate or 0.0, figures.motor_rate or 0.0)
    if objection is None and slower * flight.dt * MAX_STEP_RATIO < 1:
        objection = (
            f"The segment's messages come at {slower:.1f} Hz and those of the longest at {1 / flight.dt:.1f} Hz.",
            ask_for_rate(signals.telemetry, components=log.components),
        )
    if objection is not None:
        return Verdict(signals.axis, False, *objection, (), segment, figures, flight, found)
    # Attitude may be interpolated at PX4's body rates, whose rate is then no attitude's.
    what = "body rates" if log.name(log.attitude) == "vehicle_angular_velocity" else "attitude"
    driven = "motor outputs" if log.drive.message != DEMAND_MESSAGE else log.drive.layout.names[0]
    rates = f"{what} at {figures.attitude_rate:.1f} Hz and {driven} at {figures.motor_rate:.1f} Hz."
    reason = f"{segment.duration:.1f} s of settled flight with {rates}"
    return Verdict(
        signals.axis,
        True,
        reason,
        "",
        cautions_of(signals, figures),
        segment,
        figures,
        flight,
        found,
    )


@dataclass(frozen=True, eq=False)
class _Evidence:
    """The evidence: signals, the streams among them that decide, and the figures of the whole log."""

    signals: Signals
    attitude: Attitude
    drive: Motors
    components: Sequence[Component]
    figures: QualityFigures
    least_rate: float  # Hz, that both streams need

    def name(self, stream: Attitude | Motors) -> str:
        return self.signals.telemetry.called(stream.message)


def _objection(log: _Evidence, figures: QualityFigures) -> Obstacle | None:
    axis = log.signals.axis
    short = (figures.duration or 0.0) < MINIMUM_DURATION
    # A short segment of a slow stream may be fast; it is still the rate of the stream that should change.
    slow = _too_slow(log, log.figures if short else figures)
    if slow or short:
        return slow or _slowed_down(log) or _too_short(log, figures)
    if held := _held(log, figures):
        return held
    if not figures.rate_sd or not (figures.angle_sd or axis not in TILT_AXES):
        return (
            f"The {_measured(axis, 'or')} never changes.",
            "Check that the stream is not a replay of one message.",
        )
    if figures.output_snr is not None and figures.output_snr < REFUSED_SNR:
        rounding = f"changes by no more than rounding to steps of {_steps(axis, figures)} makes."
        remedy = f"Record the attitude as the autopilot sends it, or excite {axis} with the stick."
        return f"Over {CONSISTENCY_SPAN} s the {_measured(axis, 'or')} {rounding}", remedy
    if figures.consistency is not None and figures.consistency < REFUSED_CONSISTENCY:
        if axis not in TILT_AXES:
            return (
                f"The {axis} rate and the heading contradict each other: integrated, the rate explains "
                f"{figures.consistency:.3g} of the heading's changes over {CONSISTENCY_SPAN} s. The vehicle hardly "
                "turns, and what the rate shows is mostly noise, an alias, or what the compass corrects.",
                f"Turn the vehicle with the {axis} stick in flight, a few times to each side.",
            )
        if figures.rate_sd < STILL_RATE:
            still = f"The vehicle hardly moves: the {axis} rate is mostly its sensor's noise, and does not explain the "
            remedy = f"Fly in wind, or excite {axis} with the stick."
            return f"{still}angle's changes over {CONSISTENCY_SPAN} s.", remedy
        return (
            f"The {axis} rate and angle contradict each other: integrated, the rate explains "
            f"{figures.consistency:.3g} of the angle's changes over {CONSISTENCY_SPAN} s, so it is mostly an alias of "
            "something faster, or noise.",
            ask_for_rate(log.signals.telemetry, rate=200),
        )
    if figures.input_snr is not None and figures.input_snr < REFUSED_SNR:
        command = f"{figures.input_sd:.2g} {log.drive.scale.unit}".rstrip()
        rounding = f"is no more than rounding to steps of {figures.input_step:.2g} makes."
        reason = f"The standard deviation of the motors' {axis} command, {command}, {rounding}"
        return reason, f"Fly in wind, or excite {axis} with the stick."
    return None


def _without_drive(signals: Signals) -> Obstacle:
    telemetry = signals.telemetry
    axis = signals.axis
    if signals.inputs == "demand":
        name = telemetry.called(DEMAND_MESSAGE)
        remedy = "Take the motors: `--inputs motors`."
        if DEMAND_MESSAGE in telemetry.messages:
            return f"The controller's {axis} demand in {name} never moves.", remedy
        other = (
            " (ATTITUDE_TARGET is the attitude that is wanted, not what turns the vehicle there)"
        )
        none = f"that is in {name}, of which there is none{'' if telemetry.translated_from else other}."
        return f"The controller's {axis} demand is not in it: {none}", remedy
    found = motors_or_obstacle(telemetry)
    reason, remedy = found if isinstance(found, tuple) else ("", "")
    return reason, remedy or ask_for_rate(telemetry)


def _too_slow(log: _Evidence, figures: QualityFigures) -> Obstacle | None:
    rates = {
        log.name(log.attitude): figures.attitude_rate or 0.0,
        log.name(log.drive): figures.motor_rate or 0.0,
    }
    reason = too_slow(rates, log.signals.axis, log.least_rate)
    return (
        None
        if reason is None
        else (reason, _for_faster(log, rates[log.name(log.attitude)] >= MINIMUM_RATE))
    )


def _slowed_down(log: _Evidence) -> Obstacle | None:
    """Whether a stream that comes fast elsewhere comes too slowly in most of the air: somebody asked for less."""
    if log.least_rate < MINIMUM_RATE:
        return None
    found = {}
    # Attitude before motors: rates that hardly differ would choose by chance.
    for stream in (log.attitude, log.drive):
        slow, rate = quality.slow_in_air(log.signals, stream)
        if (seconds := sum(part.duration for part in slow)) > log.figures.airborne / 2:
            found[log.name(stream)] = slow[0], rate, seconds
    if not found:
        return None
    name, (start, rate, seconds) = next(iter(found.items()))
    reason = (
        f"In the air {name} comes at {below(rate, MINIMUM_RATE)} Hz from {start.start:.1f} s"
        f"{f' of boot {start.boot + 1}' if start.boot else ' after boot'} on, for {seconds:.0f} of "
        f"{log.figures.airborne:.0f} s, though faster elsewhere; {log.signals.axis} {NEEDED}."
    )
    return reason, _for_faster(log, log.name(log.attitude) not in found)


def _for_faster(log: _Evidence, attitude_is_fast: bool) -> str:
    """What makes streams come faster that come too slowly, or do without."""
    signals = log.signals
    demand = signals.demand if signals.inputs == "motors" and attitude_is_fast else None
    if demand is not None and (rate := usual_rate(demand)) >= MINIMUM_RATE:
        return f"Leave out `--inputs motors`: the {signals.axis} demand comes at {rate:.1f} Hz and is then the input."
    return ask_for_rate(signals.telemetry, components=log.components)


def too_slow(rates: Mapping[str, float], axis: str, least: float = MINIMUM_RATE) -> str | None:
    """Returns a sentence on all messages slower than ``least``, of ``rates`` in Hz by name; None if none is."""
    slow = [(name, below(rate, least)) for name, rate in rates.items() if rate < least]
    if not slow:
        return None
    named = (
        f"{name} {'at' if place else 'comes at'} {rate} Hz"
        for place, (name, rate) in enumerate(slow)
    )
    return f"{' and '.join(named)}; {axis} {NEEDED}."


def _held(log: _Evidence, figures: QualityFigures) -> Obstacle | None:
    """Whether a stream repeats old values under new stamps."""
    attitude = (log.name(log.attitude), figures.attitude_rate or 0.0, figures.attitude_fresh or 0.0)
    drive = (log.name(log.drive), figures.motor_rate or 0.0, figures.motor_fresh or 0.0)
    held = [stream for stream in (attitude, drive) if stream[2] < log.least_rate]
    if not held:
        return None
    name, rate, new = held[0]
    return (
        f"{name} changes only at {below(new, log.least_rate)} Hz, though it is sent at {rate:.3g} Hz; "
        f"{log.signals.axis} dynamics need {MINIMUM_RATE:.0f} Hz of new values.",
        f"Find what repeats old values between the autopilot and the log. {ask_for_rate(log.signals.telemetry)}",
    )


def _too_short(log: _Evidence, figures: QualityFigures) -> Obstacle:
    duration = (
        "less than 1" if figures.duration is None else below(figures.duration, MINIMUM_DURATION)
    )
    recorder = (
        "logger" if log.signals.telemetry.translated_from in ("DataFlash", "ULog") else "link"
    )
    return (
        f"The longest settled flight without gaps lasts {duration} s of the {MINIMUM_DURATION:.0f} s needed, out of "
        f"{figures.airborne:.0f} s in the air; settled is upright, after the climb and before the landing.",
        f"Hover for half a minute between take-off and landing, with a {recorder} that does not drop out.",
    )


def _grounded(signals: Signals, figures: QualityFigures) -> Obstacle:
    """On a vehicle that was armed and did not fly: what shows that, if anything does."""
    state = signals.telemetry.called("EXTENDED_SYS_STATE")
    shown = f"by {state}"
    boots = () if signals.attitude is None else np.unique(signals.attitude.boot)
    if any(phases.flying(signals, int(boot)) for boot in boots):
        shown = f"it did not rise by {phases.LEAST_CLIMB} m/s, or the ground held it, whatever else shows a flight"
    elif signals.landed_state is None:
        if signals.collective is None:
            reason = f"Nothing shows when the vehicle flew: no {state}, motor outputs or thrust."
            return reason, ask_for_rate(signals.telemetry)
        most = int(100 * phases.highest_collective(signals))
        least = phases.airborne_collective(signals.telemetry.parameters)
        shown = f"its motors ran at {most} % of their range at most, and flight takes {100 * least:.0f} %"
    return (
        f"The vehicle was armed for {figures.armed:.0f} s and never left the ground: {shown}.",
        FLY,
    )


_NEVER_ARMED = "The vehicle was never armed."
