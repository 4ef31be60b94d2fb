"""A log that ends while the vehicle is in the air, as a fact (a coded finding)."""

from collections.abc import Sequence
from math import inf

from mavdem.assessment.flight_losses import CONTACTS
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT, grounded_intervals
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.ingest.vocabulary import OFF_GROUND
from mavdem.witnesses.boot_sensors import BootSensors


def end_in_air(
    signals: Signals,
    boot: int,
    flight_interval: TimeInterval,
    end_time: float,
    events: Sequence[Fact],
) -> Fact | None:
    """Returns the event that a log ends while the vehicle is in the air, and does not show why.

    Then either the recorder failed, or the vehicle crashed and the crash was not recorded. There is no such event after
    a landing, or if another event explains the end (:func:`_explains_end`). There is none either if the vehicle may
    stand on the ground (:func:`_may_stand_on_ground`), or if its last height is unknown.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot: the time from one start of the autopilot to the next.
        flight_interval: start and end of the boot's last flight, s since boot; the end is infinite without a recorded
            landing.
        end_time: time of the last attitude sample of the boot, s since boot.
        events: events of this flight.

    Returns:
        The event, or None. Its figure ``is_after_loss`` is True if the attitude was lost just before the end.
    """
    # The recording of an earlier boot ended with the restart of the autopilot, not with a failure in the air.
    is_last_boot = boot == signals.tilts[0].boot[-1]
    flight_start, landing_time = flight_interval
    has_landed = landing_time != inf
    if has_landed or not is_last_boot or signals.telemetry.is_ended_on_purpose:
        return None
    if any(_explains_end(event, end_time) for event in events):
        return None
    sensors = BootSensors(signals, boot, flight_start)
    last_height = sensors.height_at(end_time)
    if last_height is None:
        return None
    if last_height <= MAX_GROUND_HEIGHT and _may_stand_on_ground(signals, boot, end_time):
        return None
    event = Fact(
        MotionEvent.LOG_ENDED_IN_AIR,
        time=end_time,
        height=last_height,
        height_source=sensors.height_source,
        boot=boot,
        witnesses=sensors.height_facts(MAX_GROUND_HEIGHT, end_time),
        # A received stream may also end because somebody stopped its recording.
        is_received=not signals.telemetry.translated_from,
    )
    has_lost_attitude = any(event.code is MotionEvent.ATTITUDE_LOST for event in events)
    return event.replace(is_after_loss=True) if has_lost_attitude else event


def _may_stand_on_ground(signals: Signals, boot: int, end_time: float) -> bool:
    """Returns whether a vehicle that is as low as the ground at the end of a log may stand on it.

    It flies if its land detector reports so until the end of a log, and the ground neither carries nor holds it by its
    motors (:func:`mavdem.dataset.grounded.grounded_intervals`). A received stream does not show that: a live session
    judges a flight at its landing, when the latest report is still one of flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot, whose last flight has no recorded landing.
        end_time: time of the last attitude sample of the boot, s since boot.
    """
    is_received = not signals.telemetry.translated_from
    reports = series_of_boot(signals.landed_state, boot)
    has_motor_outputs = series_of_boot(signals.collective, boot) is not None
    if is_received or reports is None or not has_motor_outputs:
        return True
    if reports.values[-1] not in OFF_GROUND:
        return True
    return bool(in_intervals(end_time, grounded_intervals(signals, boot)))


def _explains_end(event: Fact, end_time: float) -> bool:
    """Returns whether an event of a flight explains why a log ends without a landing.

    There are three such events: a contact with the ground; attitudes that are not numbers until the end; and a loss of
    attitude at least ``RECOVERY_SECONDS`` before the end, after which the vehicle is on the ground.

    Args:
        event: the event.
        end_time: time of the last attitude sample of the log, s since boot.
    """
    if event.code in CONTACTS:
        return True
    if event.code is MotionEvent.ATTITUDE_INVALID:
        lasts_until_end = event.end_time is None
        return lasts_until_end
    if event.code is MotionEvent.ATTITUDE_LOST and event.time:
        seconds_after_loss = end_time - event.time
        return seconds_after_loss >= RECOVERY_SECONDS
    # Other events explain nothing, nor does a loss whose time is not known: it counts as one at the end.
    return False
