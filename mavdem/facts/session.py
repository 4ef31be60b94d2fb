"""What is found of a live session: its link, the vehicles on it, their messages and rates, and what waits."""

from enum import StrEnum, auto

from mavdem.facts.fact import Code


class LinkError(StrEnum):
    """Why a link cannot be opened, or is lost."""

    CLOSED = auto()  # by the other side
    FAILED = auto()  # as the system says
    NOT_OPEN = auto()
    IN_USE = auto()  # the port, by another program
    NOT_LOCAL = auto()  # the address is of another machine
    NO_HOST = auto()
    NO_PORT = auto()  # of a serial line
    NO_REPLY = auto()  # in time
    NOT_LISTENING = auto()
    NOT_PERMITTED = auto()
    NOT_SERIAL = auto()
    NO_POSIX = auto()
    NO_SPEED = auto()  # of a serial line


class LinkFact(Code):
    """What happens to a link, and to the recording of what it receives."""

    CANNOT_OPEN_LINK = auto()
    NOT_A_LINK = auto()
    LINK_PORT_TOO_HIGH = auto()
    FILE_IS_NO_LINK = auto()
    CONNECTION_LOST = auto()
    LINK_OPEN_AGAIN = auto()
    TWO_ADDRESSES = auto()
    STREAM_FILE_EXISTS = auto()
    STREAM_FILE_FAILED = auto()
    STREAM_RECORDING_ENDED = auto()


class VehicleFact(Code):
    """Which vehicles are on a link, and which of them is followed."""

    NO_VEHICLE_YET = auto()
    CHOOSE_VEHICLE = auto()
    VEHICLES_FOUND = auto()
    FOLLOWING_VEHICLE = auto()
    OTHER_VEHICLE = auto()
    NOT_A_MULTIROTOR = auto()
    VEHICLE_REBOOTED = auto()
    CLOCK_JUMPED = auto()


class Rows(Code):
    """What the rows of a live flight are made of, and why there are none."""

    RATES_BEING_MEASURED = auto()
    NO_LIVE_ATTITUDE = auto()
    ATTITUDE_ASKED = auto()
    NO_LIVE_MOTORS = auto()
    LIVE_RATES_TOO_LOW = auto()
    LIVE_RATES_ENOUGH = auto()
    MESSAGE_GAP = auto()
    RATE_CHANGED = auto()
    ROWS_BEGIN = auto()
    MOTOR_ORDER_ASSUMED = auto()
    MOTOR_ORDER_KNOWN = auto()
    INPUTS_CHANGED = auto()
    MESSAGES_RESUMED = auto()
    NOTHING_RECEIVED = auto()


class RateFact(Code):
    """What becomes of the message rates that a vehicle is asked for."""

    RATE_REFUSED = auto()
    RATES_ASKED_AGAIN = auto()
    RATE_BELOW_ASKED = auto()
    RATE_FELL = auto()
    RATES_CONTESTED = auto()
    RATES_NOT_RESTORED = auto()


class Task(StrEnum):
    """What waits where the computer is too slow."""

    PHYSICAL_FITS = auto()
    PLOTS = auto()
    REFITS = auto()
    ESTIMATES = auto()


class Missing(StrEnum):
    """What does not come over a link: anything, or attitude and motor outputs."""

    MESSAGES = auto()
    MOTION = auto()


class Session(Code):
    """What a live session learns, and what keeps it from learning."""

    ALARM = auto()
    NOT_FLYING = auto()
    FLIGHT_UNKNOWN = auto()
    NOT_SETTLED = auto()
    BEING_LEARNED = auto()
    SAMPLE_SKIPPED = auto()
    MOTION_UNEXPECTED = auto()
    GUST_FELT = auto()
    PRIOR_NOT_USED = auto()
    FORMER_MODEL_KEPT = auto()
    NO_LIVE_FLIGHT = auto()
    NOT_LEARNED_IN_TIME = auto()
    DISPLAY_FAILED = auto()
    ROW_NOT_DRAWN = auto()
    DASHBOARD_NOT_OPENED = auto()
    COMPUTER_BEHIND = auto()
    COMPUTER_KEEPS_UP = auto()
    ESTIMATES_LATE = auto()
    SECONDS_SPENT = auto()
    WIND_KNOWN = auto()
    WIND_SPEED = auto()
    WIND_FROM = auto()


class Spent(StrEnum):
    """What the seconds of a session were, the first that holds but for those learned from."""

    LEARNED = auto()
    UNSETTLED = auto()
    ON_GROUND = auto()
    WAITING = auto()
    SILENT = auto()
    LINK_LOST = auto()
    LEFT_OUT = auto()
    NO_VEHICLE = auto()
