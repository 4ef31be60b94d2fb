"""Trim of one flight, as a fact (a coded finding): the pattern by which its motors work unevenly.

The yaw controller alone balances a twisted arm or motor; roll and pitch balance a centre of gravity off the middle;
a weak motor has its own signature, all three in the ratio of its position. Steady wind leans the vehicle and asks for
torque in roll and pitch too. What the lean explains, by how the balance follows it in this flight, is removed, and what
it may explain widens the intervals.
"""

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.motors import TrimFact
from mavdem.ingest.motors import MotorGeometry, position_name
from mavdem.motors.balance import (
    BLOCK_SECONDS,
    MIN_BLOCKS,
    balance_of_steady_flight,
)
from mavdem.motors.change_hypotheses import FAULT_RISE, ChangeHypotheses, ChangeProbabilities
from mavdem.motors.deviation import (
    PRIOR_BALANCE_FREEDOM,
    PRIOR_BALANCE_SD,
    Deviation,
    deviations_of_motors,
    level_balances,
)
from mavdem.motors.flight_evidence import MIN_REPORTED_PROBABILITY
from mavdem.motors.health import MIN_NAMED_PROBABILITY
from mavdem.motors.motor_balance import MotorBalance
from mavdem.motors.signatures import motor_signatures
from mavdem.motors.thrust_loss import lost_thrust

UNEVEN_QUADROTORS = {"healthy": 0.0, "motor": 1.0, "load": 5.0, "yaw": 11.0, "other": 6.0}
"""Prior weight of each pattern of an uneven trim: its number among 23 real quadrotors with uneven motors."""

QUADROTOR_MOTORS = 4
"""Number of motors of a vehicle on which a weak motor changes its own command only."""

MIN_SUSPICION = 0.25
"""Probability of a weak motor from which suspects are given: one chance in four is worth a look; a choice."""

MAX_SUSPECTS = 2
"""Largest number of motors of which one is said to be weak: more are no help to one who inspects them. A choice."""

MAX_HIDDEN_LOSS = 0.5
"""Loss of a motor's thrust that an even trim may hide: one that may hide more is unknown, as of eight motors in wind.

A choice: without half of a motor's thrust a vehicle flies on, but hardly in gusts. Four motors hide at most 0.43.
"""

ALL_AXES = ("thrust", "roll", "pitch", "yaw")
"""Axes that a mixer must be known for before a pattern can be distinguished from others."""


def trim_of_signals(signals: Signals) -> Fact | None:
    """Judges how evenly the motors of a vehicle work in its steady flight; None without motor outputs."""
    motors = signals.motors
    if motors is None:
        return None
    return trim_pattern(balance_of_steady_flight(signals), motors.geometry)


def trim_pattern(balance: MotorBalance | None, geometry: MotorGeometry) -> Fact:
    """Judges whether motors work unevenly in one flight, and by which pattern: one motor, yaw or centre of gravity.

    They work unevenly where the 90 % interval of some motor's deviation from the mean lies beyond ``FAULT_RISE``; of a
    quadrotor also where one motor leads alone (:func:`_leading_motor`).

    There is no healthy flight to compare with here: the flight is judged against a vehicle that is trimmed evenly. An
    even trim is claimed only if no deviation is estimated beyond ``FAULT_RISE``, no interval is wider than ± that, and
    no loss beyond ``MAX_HIDDEN_LOSS`` may hide in it.

    A loss hides where the vehicle's own trim, up to ``FAULT_RISE``, is opposite to it, and where the deviation is
    measured too small. The two are added, although they are independent: with trims of 22 real quadrotors and a weak
    motor in 300,000 draws, the loss was beyond the sum under 2 to 4 % of the even trims of four and six motors and 6 %
    of those of eight; beyond the root of their sum of squares under 4 to 6 and 7 %.

    Args:
        balance: Balance of the motors in one flight; None if it is not known.
        geometry: Positions and spins of the motors.

    Returns:
        A fact (``TrimFact``): the pattern; or that the trim is even; or why neither is known.
    """
    signatures = motor_signatures(geometry)
    if len(signatures.axes) < len(ALL_AXES):
        return Fact(TrimFact.TRIM_OF_UNKNOWN_PLACES)
    if balance is None:
        return Fact(TrimFact.TRIM_UNKNOWN, least_duration=MIN_BLOCKS * BLOCK_SECONDS)
    level = level_balances([balance])
    level_balance = level.balances[0]
    variance = level.variances[0]
    (deviations,), (half_widths,) = deviations_of_motors(level, signatures)
    # What each deviation is at least, within its interval.
    least_deviations = abs(deviations) - half_widths
    is_uneven = bool(least_deviations.max() > FAULT_RISE)
    worst_motor = int(np.argmax(least_deviations if is_uneven else abs(deviations)))
    least_rises = deviations - half_widths
    if least_rises.max() > FAULT_RISE:
        # Opposite motors of a hexarotor deviate alike: a weak one works harder, and its opposite less.
        worst_motor = int(np.argmax(least_rises))
    figures: JsonValues = {
        "shift": level_balance,
        "worst": geometry.names[worst_motor],
        "deviation": deviations[worst_motor],
        "half": half_widths[worst_motor],
        "assumed": geometry.positions_assumed,
    }
    if not is_uneven:
        if half_widths.max() > FAULT_RISE:
            figures["half"] = half_widths.max()
            return Fact(TrimFact.TRIM_UNSURE, **figures)
        leading_motor = _leading_motor(deviations, half_widths)
        if leading_motor is not None:
            return Fact(
                TrimFact.TRIM_OF_LEADING_MOTOR, subject=geometry.names[leading_motor], **figures
            )
        # A trim of the vehicle in the opposite direction may have hidden a loss. The deviation of the weak motor rises
        # by less than its command, since the mean command rises too.
        own_deviation_ratios = np.diag(signatures.torque_allocation @ signatures.mixer_rows[1:])
        hidden_deviations = FAULT_RISE + deviations + half_widths
        own_rise_ratios = signatures.own_rise_ratios
        hidden_rises = hidden_deviations * own_rise_ratios / own_deviation_ratios
        figures["most_loss"] = float(lost_thrust(hidden_rises, own_rise_ratios).max())
        if abs(deviations[worst_motor]) > FAULT_RISE:
            return Fact(TrimFact.TRIM_NEAR_LIMIT, limit=FAULT_RISE, **figures)
        if figures["most_loss"] > MAX_HIDDEN_LOSS:
            figures["half"] = half_widths.max()
            return Fact(TrimFact.TRIM_UNSURE, **figures)
        return Fact(TrimFact.TRIM_EVEN, **figures)
    scale = np.sqrt(PRIOR_BALANCE_SD**2 + variance)
    lean = float(np.linalg.norm(balance.lean))
    deviation = Deviation(level_balance, scale, PRIOR_BALANCE_FREEDOM, lean)
    hypotheses = ChangeHypotheses(signatures, _prior_weights(len(geometry.names)))
    return _uneven_trim(hypotheses, deviation, geometry, figures)


def _prior_weights(motor_count: int) -> dict[str, float]:
    """Returns the prior weight of each pattern of an uneven trim for a vehicle with that many motors.

    Each motor is as likely to be weak as one of a quadrotor, so that more motors make a weak one more likely.
    """
    motor_weight = UNEVEN_QUADROTORS["motor"] * motor_count / QUADROTOR_MOTORS
    return UNEVEN_QUADROTORS | {"motor": motor_weight}


def _leading_motor(deviations: Array, half_widths: Array) -> int | None:
    """Returns the motor of a quadrotor that works harder than the mean while every other works less.

    A weak motor or propeller causes this, but also a load on the side of the motor; a twisted arm makes two motors work
    harder. So the pattern is reported only if the estimate exceeds ``FAULT_RISE``, which makes a fault more probable
    than not, and if the lower end of its interval exceeds half of that.

    Args:
        deviations: (k,) deviation of each motor's command from the mean, as a fraction of it.
        half_widths: (k,) half widths of their 90 % intervals.

    Returns:
        Index of the motor; None if no motor leads alone, or the vehicle is no quadrotor.
    """
    if len(deviations) != QUADROTOR_MOTORS:
        return None
    leading_motor = int(np.argmax(deviations))
    leads_alone = bool((np.delete(deviations, leading_motor) < 0).all())
    lead = deviations[leading_motor]
    least_lead = lead - half_widths[leading_motor]
    is_fault_probable = lead > FAULT_RISE
    is_lead_certain = least_lead > FAULT_RISE / 2
    if leads_alone and is_fault_probable and is_lead_certain:
        return leading_motor
    return None


def _uneven_trim(
    hypotheses: ChangeHypotheses,
    deviation: Deviation,
    geometry: MotorGeometry,
    figures: JsonValues,
) -> Fact:
    """Returns the fact about the most probable pattern of an uneven trim.

    A single motor must have a probability of at least ``MIN_NAMED_PROBABILITY``; yaw, or the centre of gravity, one of
    at least ``MIN_REPORTED_PROBABILITY``. Otherwise the trim may have several causes; motors of which one is the most
    probable cause are then given as suspects.

    Args:
        hypotheses: The patterns and their prior weights.
        deviation: The level balance, as a deviation from an even trim.
        geometry: Positions and names of the motors.
        figures: Values that the fact has for every pattern.
    """
    change = hypotheses.cause_probabilities(deviation)
    motor = change.motor_probabilities.argmax()
    if change.motor_probabilities[motor] >= MIN_NAMED_PROBABILITY:
        rise = change.rises[:, motor]
        return Fact(
            TrimFact.TRIM_OF_ONE_MOTOR,
            subject=geometry.names[motor],
            probability=change.motor_probabilities[motor],
            rise=rise,
            loss=lost_thrust(rise, hypotheses.signatures.own_rise_ratios[motor]),
            **figures,
        )
    roll, pitch, yaw = deviation.change.tolist()
    yaw_probability = change.group_probabilities["yaw"]
    load_probability = change.group_probabilities["load"]
    if yaw_probability >= MIN_REPORTED_PROBABILITY:
        return Fact(TrimFact.TRIM_OF_YAW, share=yaw, probability=yaw_probability, **figures)
    if load_probability >= MIN_REPORTED_PROBABILITY:
        return Fact(
            TrimFact.TRIM_OF_CENTRE,
            # A centre of gravity in front requires a torque that raises the nose (positive pitch); one on the right
            # requires a torque that rolls to the left (negative roll).
            place=position_name((pitch, -roll)),
            share=np.hypot(roll, pitch),
            probability=load_probability,
            **figures,
        )
    return Fact(
        TrimFact.TRIM_OF_SEVERAL,
        names=tuple(geometry.names[suspect] for suspect in _suspect_motors(change)),
        probability=change.group_probabilities["motor"],
        **figures,
    )


def _suspect_motors(change: ChangeProbabilities) -> list[int]:
    """Returns the motors of which one may be weak, if no other single cause of an uneven trim is more probable.

    They are the fewest motors that together have the probability ``MIN_NAMED_PROBABILITY``, given that one motor is
    weak. Two motors that explain the trim equally well are suspects both.

    Args:
        change: Posterior probability of each cause of a change: a weak motor by motor, a shifted load, and others.

    Returns:
        Indices of the motors, the most probable first; empty if a weak motor is less probable than ``MIN_SUSPICION`` or
        than another cause, or if they would be more than ``MAX_SUSPECTS``.
    """
    probability_of_cause = change.group_probabilities
    probability_of_weak_motor = probability_of_cause["motor"]
    is_other_cause_likelier = (
        probability_of_weak_motor < probability_of_cause["load"]
        or probability_of_weak_motor < probability_of_cause["yaw"]
    )
    if probability_of_weak_motor < MIN_SUSPICION or is_other_cause_likelier:
        return []
    most_probable_first = np.argsort(-change.motor_probabilities)
    # Given that one motor is weak, the probabilities of all motors add up to 1.
    conditional_probabilities = (
        change.motor_probabilities[most_probable_first] / probability_of_weak_motor
    )
    probability_of_first_motors = np.cumsum(conditional_probabilities)
    suspect_count = 1 + int(np.searchsorted(probability_of_first_motors, MIN_NAMED_PROBABILITY))
    if suspect_count > MAX_SUSPECTS:
        return []
    return most_probable_first[:suspect_count].tolist()
