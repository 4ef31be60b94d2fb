"""Models of the JSON records about a vehicle that logs of any message rate have, used in several documents."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field, model_validator

from mavdem.containers import JsonValues
from mavdem.documents.document import (
    Document,
    Judged,
    OptionalFact,
    Sentence,
    SentenceAndFact,
    SentenceText,
    fact_field,
)
from mavdem.facts import Fact
from mavdem.facts.assessment import InShort
from mavdem.units import (
    Acceleration,
    Amperes,
    AngularRate,
    ArmLengths,
    Degrees,
    DegreesPerSecond,
    Hertz,
    InputValue,
    Number,
    Percent,
    PerHour,
    Radians,
    Seconds,
    UtcText,
    ValueInStatedUnit,
    Volts,
)
from mavdem.witnesses import SensorTrust


class Segment(Document):
    """A segment of settled flight."""

    boot: int
    """number of the vehicle's boot, from 0"""
    start: Seconds
    """on the boot clock"""
    end: Seconds
    """on the boot clock"""


class LongSegment(Segment):
    """A segment of settled flight with its duration."""

    duration: Seconds
    """from start to end"""


class Mixer(Document):
    """Channels and positions of the motors."""

    channels: list[int]
    """output channel of each motor, from 1"""
    positions: list[tuple[ArmLengths, ArmLengths]]
    """forward and right, of each motor"""
    basis: SentenceText
    """what the positions are known from"""
    channels_assumed: bool
    """whether the channels are assumed"""
    positions_assumed: bool
    """whether the positions are assumed"""
    spins: list[int]
    """+1 counter-clockwise seen from above, −1 clockwise, 0 not known"""


class Scale(Document):
    """Range of the inputs."""

    name: str
    """kind of output, such as PWM, or demand"""
    unit: str
    """unit of the inputs"""
    low: InputValue
    """value of no throttle"""
    high: InputValue
    """value of full throttle"""
    step: InputValue
    """quantisation step"""
    stop: Number
    """share of the range beyond which the autopilot sends no motor"""


class Hover(Document):
    """What each motor does in settled flight."""

    motors: list[str]
    """names of the motors; every list has one entry for each"""
    unit: str
    """unit of trim"""
    seconds: Seconds
    """duration of settled flight"""
    trim: list[InputValue]
    """mean output"""
    trim_of_range: list[float]
    """mean output as a share of the range"""
    trim_share: list[float]
    """trim_of_range over its mean of all motors"""
    headroom: list[float]
    """share of the range that is left at the 99th percentile of the output"""
    at_upper_limit: list[float]
    """share of the time at the upper limit"""
    at_lower_limit: list[float]
    """share of the time at the lower limit"""
    roll: Degrees
    """mean roll"""
    pitch: Degrees
    """mean pitch"""
    imbalance: list[Percent]
    """trim deviation: 100 (trim_share − 1)"""


class Steady(Document):
    """Steady command about one axis, as a share of the range of the motors."""

    mean: float
    """mean over settled flight"""
    interval: Number
    """half width of the 90 % interval of mean"""
    sd: float
    """standard deviation"""


class Lean(Document):
    """Mean roll or pitch."""

    mean: Radians
    """mean over settled flight"""
    interval: Radians
    """half width of the 90 % interval of mean"""
    sd: Radians
    """standard deviation"""


class Vibration(Document):
    """Vibration of the first IMU."""

    level: list[Acceleration]
    """mean vibration: x, y and z of ArduPilot, one level of PX4"""
    clips: int
    """times that an accelerometer was out of range"""


class Battery(Document):
    """Figures of one battery."""

    number: int
    """its number, from 1"""
    voltage_start: Volts
    """voltage at the start, median of 2 s"""
    voltage_end: Volts
    """voltage at the end, median of 2 s"""
    voltage_mean: Volts
    """mean voltage"""
    voltage_min: Volts
    """least voltage"""
    current_mean: Amperes
    """mean current"""
    current_max: Amperes
    """largest current"""


class Oscillation(Document):
    """A limit cycle of the vehicle."""

    axis: str
    """the axis that turns faster: roll or pitch"""
    frequency: Hertz
    """frequency; null where it may be an alias"""
    rate: DegreesPerSecond
    """standard deviation of the body rate"""
    at_limit: float
    """share of that time in which a motor is at a limit"""
    growing: bool
    """whether the amplitude grew"""
    seconds: Seconds
    """duration of the oscillation"""


class Condition(Document):
    """Figures of the vehicle that any rate shows."""

    duration: Seconds
    """duration of the log, over all boots"""
    armed: Seconds
    """time that the vehicle was armed"""
    settled: Seconds
    """duration of settled flight"""
    hover: Hover | None
    """what each motor does"""
    share_interval: list[Number]
    """half widths of the 90 % intervals of trim_share"""
    command: dict[str, Steady]
    """steady command about each axis, as a share of the motors' range"""
    lean: dict[str, Lean]
    """mean roll and pitch"""
    tilt_mean: Radians
    """mean angle from level"""
    tilt_sd: Radians
    """standard deviation of the angle from level"""
    tilt_max: Radians
    """largest angle from level"""
    vibration: Vibration | None
    """vibration of the first IMU"""
    battery: Battery | None
    """the emptiest battery"""
    batteries: list[Battery]
    """all, the emptiest first"""
    oscillation: Oscillation | None
    """a limit cycle; null where there is none"""
    collective: Number
    """mean output of all motors, as a share of their range"""


class Identity(Document):
    """Which vehicle it is."""

    name: str
    """name of the vehicle, the same in all its logs"""
    basis: SentenceText
    """what the name is made of: board, accelerometer, compass or system id"""
    system: int
    """MAVLink id"""
    autopilot: str
    """MAV_AUTOPILOT"""
    frame: str
    """MAV_TYPE"""
    firmware: str
    """version of the firmware, as logged"""
    hardware: str
    """kind of board, as its firmware calls it"""
    place: list[Degrees] | None
    """latitude and longitude of the first fix, to three decimals (about 100 m)"""
    date: UtcText | None
    """when the settled flight began"""


class MotorAlarm(Document):
    """A motor that lost or regained thrust in flight, or a lasting change of torque."""

    time: Seconds
    """when it was found, on the boot clock"""
    since: Seconds = Field(validation_alias="onset_time")
    """when it began, on the boot clock"""
    motor: int | None
    """number of the motor, from 1; null where no motor is named"""
    name: str
    """name of the motor; empty without one"""
    size: float
    """rise of the motor's own command, as a share of it"""
    probability: float
    """probability that this is the cause"""
    assumed: bool
    """whether the motors' places, and so the name, are assumed"""
    boot: int
    """number of the vehicle's boot, from 0"""
    loss: list[float]
    """90 % interval of the share of its thrust that the motor lost"""
    sentence: SentenceText = Field(validation_alias="event")
    """the alarm in words"""
    sentence_fact: OptionalFact = fact_field(
        "event", "sentence as a fact; null where there is none"
    )


class FalseAlarms(Document):
    """Rate of false alarms of lost thrust."""

    at_most: PerHour
    """upper bound with 95 % confidence"""
    basis: SentenceText
    """what the bound is from"""


class MotorHealth(Document):
    """Changes of motors that were detected in flight."""

    alarms: list[MotorAlarm]
    """motors that lost thrust in flight"""
    recoveries: list[MotorAlarm]
    """motors that gave their thrust again in flight"""
    torque_changes: list[MotorAlarm]
    """lasting changes of the torque in roll and pitch that name no motor"""
    false_alarms_per_hour: FalseAlarms
    """rate of false alarms"""


class NextTier(Document):
    """The next better tier."""

    tier: str
    """its letter"""
    needs: SentenceText
    """what the log must have for it"""
    remedy: SentenceText
    """what to change for it"""


class Tier(Document):
    """What can be learned from a log, by its rates and messages."""

    tier: str | None
    """what the log allows: a (full model), b (slow motion) or c (condition only)"""
    tier_reason: SentenceText
    """why the tier is no better"""
    allows: SentenceText
    """what this tier gives"""
    next_tier: NextTier | None
    """the next better tier"""


class Quality(Document):
    """Figures of a segment of settled flight that decide what can be learned from it."""

    armed: Seconds
    """time armed, over all boots"""
    airborne: Seconds
    """time in the air, over all boots"""
    segments: int
    """number of segments of settled flight"""
    duration: Seconds
    """duration of the segment"""
    samples: int | None
    """samples of the segment"""
    dt: Seconds
    """sampling step"""
    attitude_rate: Hertz
    """rate of the attitude's messages"""
    motor_rate: Hertz
    """rate of the motors' messages"""
    attitude_fresh: Hertz
    """rate of new values of attitude"""
    motor_fresh: Hertz
    """rate of new values of the motors"""
    attitude_gap: Seconds
    """longest step between messages of attitude"""
    motor_gap: Seconds
    """longest step between messages of the motors"""
    angle_sd: Radians
    """standard deviation of the angle"""
    rate_sd: AngularRate
    """standard deviation of the rate"""
    angle_step: Radians
    """quantisation step of the angle"""
    rate_step: AngularRate
    """quantisation step of the rate"""
    output_snr: Number
    """variance of the outputs' changes over that of rounding"""
    input_sd: InputValue
    """standard deviation of the motors' combination that turns the axis"""
    input_step: InputValue
    """quantisation step of the motor outputs"""
    input_snr: Number
    """variance of that combination over that of rounding"""
    saturation: Number
    """share of the samples with a motor at its limit"""
    consistency: Number
    """share of the angle's changes that the rates explain"""


class Verdict(Document):
    """Whether a full model can be learned."""

    axis: str
    """roll, pitch or yaw"""
    learnable: bool
    """whether a full model can be learned"""
    reason: SentenceAndFact
    """the figures that decided, one sentence"""
    remedy: SentenceText
    """what to change; empty where a model can be learned"""
    cautions: list[SentenceAndFact]
    """what makes a model less reliable, one sentence each"""
    segment: Segment | None
    """the segment to learn from, or the longest"""
    figures: Quality
    """what was measured on that segment"""


class Override(Document):
    """A reason why the flight itself is doubtful, such as an oscillation."""

    @model_validator(mode="before")
    @classmethod
    def _values_of_fact(cls, override: Fact) -> JsonValues:
        """Fills the record from a fact (coded finding) that makes a flight doubtful, such as an oscillation.

        Such a fact overrides the grades of the model and the usual headline of the flight. So the record has a short
        sentence as a headline, and the full sentence with the remedy. Pydantic calls this before it checks the keys.

        Args:
            override: the fact.

        Returns:
            Values by the keys of the record.
        """
        return {
            "kind": override.code,
            "headline": Fact(InShort.OVERRIDDEN, reason=override),
            "sentence": override,
            "remedy": override.remedy,
        }

    kind: str
    """oscillation, motors, saturation, trim or data"""
    headline: SentenceText
    """what is wrong, one plain sentence"""
    sentence: SentenceAndFact
    """what is wrong, with its figures"""
    remedy: SentenceText
    """what to do"""


class Finding(Document):
    """How good the model is for one purpose."""

    purpose: str
    """control effectiveness, damping and time constant, wind torque, prediction or residuals"""
    grade: str
    """GOOD, LIMITED or NOT IDENTIFIABLE"""
    reason: SentenceAndFact
    """the figures that decide, one sentence"""


class Findings(Judged):
    """What was found in a flight: events, doubts about the flight, and what the model is good for."""

    events: list[Sentence]
    """what happened, in order"""
    overrides: list[Override]
    """what makes the flight itself doubtful, the worst first"""
    findings: list[Finding] = Field(validation_alias="purposes")
    """what the model is good for"""
    warnings: list[SentenceAndFact]
    """what must be known before the model is used"""


class Instance(Document):
    """A battery, estimator, sensor or output of the vehicle."""

    kind: str
    """battery, estimator, sensor or output"""
    name: str
    """its name with its number"""
    quantity: str
    """what it measures"""
    unit: str
    """of low and high"""
    low: ValueInStatedUnit
    """lowest in flight"""
    high: ValueInStatedUnit
    """highest in flight"""
    used_share: float | None
    """share of the flight; null if unknown"""
    state: Sentence
    """what is known of it"""


class BootTrust(Document):
    """Which sensors can be trusted in one boot, by each other."""

    boot: int
    """number of the vehicle's boot, from 0"""
    flew: bool | None
    """null if undecided"""
    checks: list[Sentence]
    """of each sensor"""


def trust_documents(trust_of_boots: Sequence[SensorTrust]) -> list[BootTrust]:
    """Makes the record of what can be trusted in each boot."""
    return [BootTrust.from_results(trust) for trust in trust_of_boots]
