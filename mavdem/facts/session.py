"""Facts about a live session: its link, the vehicles on it, their messages and rates, and what waits."""

from enum import StrEnum

from mavdem.facts.fact import Code


class LinkError(StrEnum):
    """Why a link cannot be opened, or is lost."""

    CLOSED = "closed"
    """The other side closed it."""
    FAILED = "failed"
    """The operating system reports an error."""
    NOT_OPEN = "not_open"
    """It is not open."""
    IN_USE = "in_use"
    """Another program uses the port."""
    NOT_LOCAL = "not_local"
    """The address is that of another machine."""
    NO_HOST = "no_host"
    """There is no such host."""
    NO_PORT = "no_port"
    """There is no such serial port."""
    NO_REPLY = "no_reply"
    """The other side did not reply in time."""
    NOT_LISTENING = "not_listening"
    """Nothing listens at the address."""
    NOT_PERMITTED = "not_permitted"
    """The user may not open it."""
    NOT_SERIAL = "not_serial"
    """The device is no serial port."""
    NO_PYSERIAL = "no_pyserial"
    """The package pyserial is not installed, which Windows needs."""
    NO_SPEED = "no_speed"
    """The serial port has no such speed."""


class LinkFact(Code):
    """What happens to a link, and to the recording of what it receives."""

    CANNOT_OPEN_LINK = "cannot_open_link"
    NOT_A_LINK = "not_a_link"
    LINK_PORT_TOO_HIGH = "link_port_too_high"
    FILE_IS_NO_LINK = "file_is_no_link"
    FOLDER_IS_NO_LINK = "folder_is_no_link"
    CONNECTION_LOST = "connection_lost"
    LOST_IN_FLIGHT = "lost_in_flight"
    WAS_LOST_IN_FLIGHT = "was_lost_in_flight"
    LINK_OPEN_AGAIN = "link_open_again"
    TWO_ADDRESSES = "two_addresses"
    STREAM_FILE_EXISTS = "stream_file_exists"
    STREAM_FILE_FAILED = "stream_file_failed"
    STREAM_RECORDING_ENDED = "stream_recording_ended"
    DATAGRAMS_LOST = "datagrams_lost"
    FLIGHT_SAVED = "flight_saved"


class VehicleFact(Code):
    """Which vehicles are on a link, and which of them is followed."""

    LISTENING = "listening"
    NO_VEHICLE_YET = "no_vehicle_yet"
    NO_MULTIROTOR_YET = "no_multirotor_yet"
    CHOOSE_VEHICLE = "choose_vehicle"
    VEHICLES_FOUND = "vehicles_found"
    FOLLOWING_VEHICLE = "following_vehicle"
    OTHER_VEHICLE = "other_vehicle"
    VEHICLE_SUCCEEDED = "vehicle_succeeded"
    TWO_VEHICLES_LIVE = "two_vehicles_live"
    NOT_A_MULTIROTOR = "not_a_multirotor"
    VEHICLE_REBOOTED = "vehicle_rebooted"
    CLOCK_JUMPED = "clock_jumped"
    CLOCK_WENT_BACK = "clock_went_back"


class RowsFact(Code):
    """What the rows of a live flight are made of, and why there are none."""

    RATES_BEING_MEASURED = "rates_being_measured"
    NO_LIVE_ATTITUDE = "no_live_attitude"
    ATTITUDE_ASKED = "attitude_asked"
    NO_LIVE_MOTORS = "no_live_motors"
    MOTORS_NOT_KNOWN = "motors_not_known"
    LIVE_RATES_TOO_LOW = "live_rates_too_low"
    LIVE_RATES_ENOUGH = "live_rates_enough"
    MESSAGE_GAP = "message_gap"
    RATE_CHANGED = "rate_changed"
    ROWS_BEGIN = "rows_begin"
    MOTOR_ORDER_ASSUMED = "motor_order_assumed"
    MOTOR_ORDER_KNOWN = "motor_order_known"
    INPUTS_CHANGED = "inputs_changed"
    MESSAGES_RESUMED = "messages_resumed"
    NOTHING_RECEIVED = "nothing_received"


class RateFact(Code):
    """Results of requesting message rates from a vehicle."""

    RATE_REFUSED = "rate_refused"
    RATES_ASKED_AGAIN = "rates_asked_again"
    RATE_BELOW_ASKED = "rate_below_asked"
    MESSAGE_ABSENT = "message_absent"
    RATE_FELL = "rate_fell"
    RATES_CONTESTED = "rates_contested"
    RATES_NOT_RESTORED = "rates_not_restored"
    VEHICLE_CLOCK_SLOW = "vehicle_clock_slow"


class DelayedWork(StrEnum):
    """What waits where the computer is too slow."""

    PHYSICAL_FITS = "physical_fits"
    PLOTS = "plots"
    REFITS = "refits"
    ESTIMATES = "estimates"


class MissingMessages(StrEnum):
    """What does not come over a link: anything, or attitude and motor outputs."""

    MESSAGES = "messages"
    MOTION = "motion"


class RecordingState(StrEnum):
    """How far the recording of a flight that is over is on its way to be judged."""

    IN_SESSION = "in_session"
    """The session goes on, and is read once it is over."""
    BEING_READ = "being_read"
    """It waits to be read, or is being read."""
    READ_AT_NEXT_START = "read_at_next_start"
    """The server ends, and reads it once it runs again."""
    FAILED = "failed"
    """It could not be read."""


class SessionFact(Code):
    """What a live session learns, and what keeps it from learning."""

    ALARM = "alarm"
    NOT_FLYING = "not_flying"
    FLIGHT_OVER = "flight_over"
    FLIGHT_UNKNOWN = "flight_unknown"
    NOT_SETTLED = "not_settled"
    TOO_LITTLE_RECEIVED = "too_little_received"
    BEING_LEARNED = "being_learned"
    FIRST_MODEL = "first_model"
    PARAMETERS_KNOWN = "parameters_known"
    FLIGHT_LEARNED = "flight_learned"
    REPORTS_LEFT_OUT = "reports_left_out"
    FLIGHT_VERDICT = "flight_verdict"
    ENDED_IN_FLIGHT = "ended_in_flight"
    END_NOT_SEEN = "end_not_seen"
    FLIGHT_END_UNKNOWN = "flight_end_unknown"
    UNREPAIRED_FAULT = "unrepaired_fault"
    FLIGHT_OF_RECORDING = "flight_of_recording"
    FLIGHT_OF_HEADLINE = "flight_of_headline"
    VEHICLE_VERDICT = "vehicle_verdict"
    VEHICLE_OF_RECORDING = "vehicle_of_recording"
    SAMPLE_SKIPPED = "sample_skipped"
    MOTION_UNEXPECTED = "motion_unexpected"
    GUST_FELT = "gust_felt"
    PRIOR_NOT_USED = "prior_not_used"
    PRIOR_OF_OTHER_VEHICLE = "prior_of_other_vehicle"
    FORMER_MODEL_KEPT = "former_model_kept"
    NO_LIVE_FLIGHT = "no_live_flight"
    NOT_LEARNED_IN_TIME = "not_learned_in_time"
    DISPLAY_FAILED = "display_failed"
    ROW_NOT_DRAWN = "row_not_drawn"
    DASHBOARD_NOT_OPENED = "dashboard_not_opened"
    COMPUTER_BEHIND = "computer_behind"
    COMPUTER_KEEPS_UP = "computer_keeps_up"
    LINES_LOST = "lines_lost"
    ESTIMATES_LATE = "estimates_late"
    COMPUTER_TOO_SLOW = "computer_too_slow"
    TOO_SLOW_TO_JUDGE = "too_slow_to_judge"
    SETTLED_TOO_SHORT = "settled_too_short"
    FIT_UNFINISHED = "fit_unfinished"
    RECORDING_NOT_JUDGED = "recording_not_judged"
    RECORDING_JUDGED = "recording_judged"
    LIGHT_OF_RECORDING = "light_of_recording"
    GOOD_IN_FLIGHT_ALONE = "good_in_flight_alone"
    SECONDS_SPENT = "seconds_spent"
    WIND_KNOWN = "wind_known"
    WIND_SPEED = "wind_speed"
    WIND_FROM = "wind_from"


class TimeUse(StrEnum):
    """How each second of a session was used: learned from, or else the first of the other values that applies."""

    LEARNED = "learned"
    UNSETTLED = "unsettled"
    ON_GROUND = "on_ground"
    WAITING = "waiting"
    SILENT = "silent"
    LINK_LOST = "link_lost"
    LEFT_OUT = "left_out"
    NO_VEHICLE = "no_vehicle"
