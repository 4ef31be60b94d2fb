"""The headline is the worst that was found, and the next step fits its reason."""

from hover import Hover
from made_up_analysis import measured_vibration
from partial_records import partial_record
from pytest import mark
from refusals import prose

from mavdem.assessment.condition import Condition
from mavdem.assessment.event_lights import LIGHT_OF_EVENT, lights_with_event
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.faults_before_gains import faults_before_gains
from mavdem.assessment.headline import headline_by_lights, headline_of
from mavdem.assessment.next_step import choose_next_step
from mavdem.dataset.quality import QualityFigures
from mavdem.dataset.segment_learnability import Learnability
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.learnability import NotLearnableReason
from mavdem.facts.lights import Light
from mavdem.facts.loops import LoopAction
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorsLight, MotorWatchFact, TrimFact
from mavdem.facts.power import PowerLight
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.facts.witnesses import SensorFact
from mavdem.motors.motor_changes import MotorChange, thrust_losses

GROUNDED = Fact(NotLearnableReason.NEVER_ARMED)
RECORDED = Signals(Hover().telemetry(1.0, 1.0))
CRASH = prose("Lost control.").replace(Level.BAD)


def lights(**levels):
    """Facts of all lights, good but for these."""
    return {
        light: prose(f"The {light}.").replace(Level(levels.get(light, "good"))) for light in Light
    }


def headline(known, ending=None, events=(), airborne=60.0, oscillation=None, signals=RECORDED):
    learnability = Learnability("roll", False, GROUNDED, figures=QualityFigures(airborne=airborne))
    evidence = partial_record(
        Evidence,
        ending=ending,
        events=events,
        warnings_in_flight=lambda self, codes: events,
        learnability=learnability,
        condition=Condition(60.0, oscillation=oscillation),
        other_vehicle=None,
        signals=signals,
    )
    return headline_of(evidence, known)


@mark.parametrize("message", ["SERVO_OUTPUT_RAW", "HEARTBEAT", ""])
def test_a_warning_counts_where_nothing_shows_whether_the_vehicle_flew(message):
    silent = {"SERVO_OUTPUT_RAW", "HEARTBEAT"} - {message}
    signals = Signals(Hover().telemetry(1.0, 1.0, without=silent))
    lost = Fact(ReportedEvent.RADIO_LOST, time=1.0, boot=0)
    found = headline(lights(), events=(lost,), airborne=0.0, signals=signals)
    assert found is (GROUNDED if message else lost)


def test_a_larger_loss_that_recovered_is_not_hidden_by_a_smaller_that_lasts():
    large = MotorChange(10, 10, 2, "motor 2", 0.5, 1, loss=(0.3, 0.5))
    small = large._replace(motor=4, name="motor 4", size=0.1)
    losses = thrust_losses([large, large._replace(onset_time=30.0, size=0.0), small])
    assert headline(lights(), events=losses[::-1]).remedy.startswith(
        "Do not fly before motor 2 and motor 4"
    )


ALARM = prose("An alarm.").replace(Level.BAD)
WARNING = prose("A warning.").replace(Level.WATCH)


@mark.parametrize(
    "levels, more, said",
    [
        ({"motors": "bad"}, {"ending": CRASH, "events": (ALARM,)}, "Lost control."),
        ({"motors": "bad"}, {"events": (WARNING, ALARM)}, "An alarm."),
        ({"motors": "bad", "margins": "bad"}, {"events": (WARNING,)}, "The motors."),
        ({"motors": "bad", "margins": "bad"}, {"oscillation": 5.0}, "The margins."),
        ({"motors": "watch", "power": "bad"}, {}, "The power."),
        ({"motors": "bad", "power": "bad"}, {}, "The motors."),
        ({"log": "bad", "estimator": "watch"}, {}, "The log."),
        ({"power": "bad"}, {"airborne": 0.0}, "The power."),
        ({"vibration": "watch", "log": "watch"}, {}, "The vibration."),
        ({}, {"events": (WARNING,)}, "A warning."),
        # An attitude more than 45° from its setpoint, though it came back.
        ({"motors": Level.WATCH}, {"events": (WARNING.replace(angle=0.78),)}, "The motors."),
        ({"motors": Level.WATCH}, {"events": (WARNING.replace(angle=0.79),)}, "A warning."),
    ],
)
def test_the_headline_is_the_worst_that_was_found(levels, more, said):
    """The headline names the worst of a loss, an alarm, lights, an oscillation and warnings.

    The next step follows from it.
    """
    status_lights = lights(**levels)
    worst = headline(status_lights, **more)
    assert worst.sentence == said
    following = choose_next_step(worst, status_lights)
    assert following.code is NextStep.DO_AS_ADVISED
    assert following.figures["reason"] == worst
    if status_lights[Light.POWER] in following.figures["also"]:
        assert Light.POWER in levels
    else:
        assert Light.POWER not in levels


def test_small_margins_come_before_motors_that_only_fast_commands_take_to_their_limits():
    """Noise that the loop amplifies takes part of the range; a hover that takes it is no matter of the gains."""
    headroom = Fact(
        MotorsLight.HEADROOM_LITTLE, names=("motor 4",), share=0.095, trim=0.71, excess=None
    )
    by_commands = headroom.replace(is_by_commands=True)
    for motors, margins, is_margins_first in (
        (by_commands, "watch", True),
        (by_commands, "good", False),
        (headroom, "watch", False),
    ):
        status_lights = lights(margins=margins) | {Light.MOTORS: motors}
        first = status_lights[Light.MARGINS if is_margins_first else Light.MOTORS]
        assert headline(status_lights) == headline_by_lights(status_lights) == first


def test_what_is_mended_before_gains_is_in_the_next_step_of_review_and_tuning():
    """An empty battery changes the loops, and comes first. Fast commands become smaller by the new gains themselves."""
    tune = Fact(LoopAction.LOAD_ADVISED_GAINS, arguments=("a.bin",))
    empty = Fact(PowerLight.CHARGE_LOW, Level.WATCH, subject="", share=0.146, share_limit=0.15)
    by_commands = Fact(
        MotorsLight.HEADROOM_LITTLE,
        names=("motor 4",),
        share=0.08,
        trim=0.69,
        excess=None,
        is_by_commands=True,
    )
    status_lights = lights() | {Light.MOTORS: by_commands}
    worst = Fact(MarginsLight.LOOP_MARGINS, Level.BAD, reason=None, action=tune)
    status_lights[Light.MARGINS] = worst
    load = "oad the gains that `mavdem tune a.bin --axis all` advises."
    assert str(choose_next_step(worst, status_lights)) == f"L{load}"
    assert faults_before_gains(worst, status_lights) == ()
    status_lights[Light.POWER] = empty
    assert faults_before_gains(worst, status_lights) == (empty,)
    assert str(choose_next_step(worst, status_lights)) == f"{empty.remedy} Then l{load}"


def test_a_bad_battery_does_not_hide_the_advice_on_bad_vibration():
    status_lights = lights(power="bad", vibration="bad")
    following = choose_next_step(status_lights[Light.POWER], status_lights)
    assert status_lights[Light.VIBRATION] in following.figures["also"]


def test_the_advice_on_a_low_battery_follows_that_of_another_headline_but_not_of_a_loss():
    low = Fact(PowerLight.CHARGE_LOW, Level.WATCH, subject="", share=0.146, share_limit=0.15)
    status_lights = lights(motors="watch") | {Light.POWER: low}
    following = choose_next_step(status_lights[Light.MOTORS], status_lights)
    assert str(following).endswith(low.remedy)
    lost = Fact(Ending.CONTROL_LOST, Level.BAD, time=1.0, height=None, cause=None)
    assert choose_next_step(lost, status_lights).figures["also"] == ()


def test_the_next_step_after_a_report_of_a_battery_names_the_one_that_was_measured():
    reported = Fact(ReportedEvent.BATTERY_ALARMED, time=40.0, text="Critical battery level!")
    empty = Fact(PowerLight.CHARGE_LOW, Level.BAD, subject="battery 2", share=0.0, share_limit=0.07)
    step = choose_next_step(reported, lights() | {Light.POWER: empty})
    assert str(step) == "Check battery 2 before the next flight, and land earlier."
    supply = Fact(PowerLight.SUPPLY_LOW, Level.BAD, voltage=4.3, voltage_limit=4.5)
    step = choose_next_step(reported, lights() | {Light.POWER: supply})
    assert str(step).startswith("Check the battery and its cells") and "power module" in str(step)


BAD_VIBRATION = measured_vibration(Level.BAD)


def test_the_next_step_says_do_not_fly_once():
    limited = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 2", share=0.1)
    saturated = Fact(
        MotorWatchFact.MOTOR_SATURATED, Level.BAD, subject="motor 3", excess=0.3, time=10.0
    )
    step = Fact(NextStep.DO_AS_ADVISED, reason=limited, also=(BAD_VIBRATION, saturated))
    assert str(step).count("Do not fly") == 1
    assert " Also check and balance the propellers and mount the autopilot softly. " in str(step)
    assert " Nor fly before motor 3," in str(step)


def test_the_next_step_begins_with_do_not_fly_and_then_the_headline():
    toppled = Fact(Ending.TOPPLED_AT_LANDING, time=9.0, height=0.0, cause=None, word=None)
    assert "Do not fly" not in toppled.remedy
    limited = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 2", share=0.1)
    step = str(Fact(NextStep.DO_AS_ADVISED, reason=toppled, also=(BAD_VIBRATION, limited)))
    # What to do follows the order of the headline.
    assert step.startswith(f"Do not fly. {toppled.remedy} Also check and balance the propellers")
    assert step.count("Do not fly") == 1 and " Nor fly before motor 2 " in step


@mark.parametrize("code", [Ending.CONTROL_LOST, Ending.CRASHED])
def test_after_a_loss_each_bad_light_is_in_the_next_step_and_a_bad_motor_first(code):
    status_lights = lights(vibration="bad")
    status_lights[Light.MOTORS] = Fact(
        MotorsLight.MOTOR_LIMITED, subject="motor 2 (left)", share=0.1
    )
    lost = Fact(code, time=9.0, height=2.0, cause=None, word=None)
    following = choose_next_step(lost, status_lights)
    # The advice of the headline names the motor already.
    assert following.figures["also"] == (status_lights[Light.VIBRATION],)
    assert "motor 2 first" in str(following) and str(following).count("motor 2") == 1


@mark.parametrize(
    "cause_subject, is_added", [("", True), ("motor 3", True), ("motor 2 (left)", False)]
)
def test_the_headline_of_a_crash_has_a_motor_that_was_weak_before(cause_subject, is_added):
    """A motor worked 10 % harder before a crash.

    The headline adds this unless the cause of the crash is that same motor.
    """
    status_lights = lights()
    # A trim is only to be watched, and no bad light.
    status_lights[Light.MOTORS] = Fact(
        TrimFact.TRIM_OF_LEADING_MOTOR,
        subject="motor 2 (left)",
        deviation=0.1,
        half=0.04,
        assumed=False,
    )
    cause = Fact(FailedFirst.LIMIT_FIRST, subject=cause_subject) if cause_subject else None
    crash = Fact(Ending.CRASHED, time=9.0, height=2.0, cause=cause, word=None)
    worst = headline(status_lights, ending=crash)
    clause = "; before that, motor 2 works 10 ± 4 % harder than the mean without lean"
    assert (clause in str(worst)) is is_added
    if cause is None:
        assert "motor 2 first" in str(choose_next_step(worst, status_lights))


def test_a_light_that_only_repeats_what_to_do_first_is_not_in_the_next_step():
    status_lights = lights(vibration="bad")
    lost = Fact(Ending.CRASHED, time=9.0, height=2.0, cause=None, word=None)
    first = Fact(LoopAction.DO_FIRST, reason=lost)
    status_lights[Light.MARGINS] = (
        prose("Too little margin.").replace(Level.BAD).replace(action=first)
    )
    following = choose_next_step(lost, status_lights)
    assert following.figures["also"] == (status_lights[Light.VIBRATION],)


def test_an_unknown_light_without_a_remedy_is_no_step():
    """That the margins are not known is no step; what is to be watched always is one."""
    unknown = lights(margins="unknown")
    assert not unknown[Light.MARGINS].remedy
    sound = headline(unknown)
    assert choose_next_step(sound, unknown).code is NextStep.KEEP_LOG
    watched = lights(margins="unknown", log="watch")
    step = choose_next_step(sound, watched)
    assert step.figures["reason"] == watched[Light.LOG]


def test_without_a_flight_headline_and_next_step_have_the_reason():
    status_lights = lights(motors="watch")
    assert headline(status_lights, airborne=0.0) == GROUNDED
    assert choose_next_step(GROUNDED, status_lights).figures["reason"] == GROUNDED


def test_nothing_wrong_is_said_of_what_was_checked_only():
    """No light is bad, but some could not be judged.

    The headline lists what was checked, and is unknown if that is too little.
    """
    status_lights = lights(margins="unknown", log="watch", wind="watch")
    status_lights["motors"] = status_lights["motors"].replace(most_loss=0.36)
    sound = headline(status_lights)
    assert "found: motors (losses over 36 %), tracking" in sound.sentence
    assert (sound.code, sound.level) == (Headline.NOTHING_WRONG, "good")
    assert sound.figures["missing"] == (Light.MARGINS,)
    assert choose_next_step(sound, status_lights).figures["reason"] == status_lights[Light.LOG]
    dark = dict.fromkeys(Light, "unknown")
    little = headline(lights(**dark | {"tracking": "good"}))
    assert (little.code, little.level) == (Headline.NOTHING_WRONG, "unknown")
    # Three good lights of six, the motors among them, are too little as well: as many are unknown.
    status_lights = dark | {"motors": "good", "margins": "good", "tracking": "good"}
    assert headline(lights(**status_lights)).level == "unknown"
    assert headline(lights(**status_lights | {"power": "good"})).level == "good"
    nothing = headline(lights(**dark | {"log": "good"}))
    assert nothing.code is Headline.NOTHING_CHECKED
    assert nothing.figures["reason"].level == "unknown"
    assert str(nothing).startswith("The vehicle could not be judged: ")


def test_what_a_check_has_shown_is_no_reason_why_nothing_was_judged():
    unknown = lights(**dict.fromkeys(Light, "unknown") | {"log": "good"})
    reason = Fact(SessionFact.NOT_SETTLED)
    unknown["motors"] = Fact(WatchFact.NO_MOTOR_AT_LIMIT, reason=reason)
    assert headline(unknown).figures["reason"] == reason


def test_the_log_of_a_sound_vehicle_is_kept_whatever_its_model_is_worth():
    """A live flight is judged without a learned model, and has the same next step as its log."""
    status_lights = lights()
    sound = headline(status_lights)
    assert choose_next_step(sound, status_lights).code is NextStep.KEEP_MODEL


def event(code, level=Level.WATCH, **figures):
    return Fact(code, level, time=20.0, boot=0, **figures)


@mark.parametrize(
    "known, events, code",
    [
        # An impact, a failsafe or a log that ends in the air matters more than a trim or a vibration.
        ({"vibration": "bad"}, (event(MotionEvent.HIT, speed=2.0),), MotionEvent.HIT),
        ({"motors": "watch"}, (event(ReportedEvent.FAILSAFE),), ReportedEvent.FAILSAFE),
        (
            {"vibration": "watch"},
            (event(MotionEvent.LOG_ENDED_IN_AIR, height=9.0),),
            MotionEvent.LOG_ENDED_IN_AIR,
        ),
        # A restart is the reason for whatever followed it.
        (
            {"motors": "bad"},
            (
                event(MotionEvent.HIT, Level.BAD),
                event(ReportedEvent.RESTARTED_IN_FLIGHT, Level.BAD),
            ),
            ReportedEvent.RESTARTED_IN_FLIGHT,
        ),
        # Of several bad events the first one is named.
        (
            {"motors": "bad"},
            (
                event(MotionEvent.HEIGHT_DIVERGED, Level.BAD),
                event(MotionEvent.POSITION_LOST, Level.BAD, duration=18.0),
            ),
            MotionEvent.HEIGHT_DIVERGED,
        ),
    ],
)
def test_losses_failsafes_and_impacts_rank_above_trims_and_vibration(known, events, code):
    """An event and a light are both found: the headline has the code of the event."""
    assert headline(lights(**known), events=events).code is code


@mark.parametrize("name", ["power", "motors", "vibration"])
def test_a_bad_light_ranks_above_a_log_that_ends_in_the_air(name):
    status_lights = lights(**{name: "bad"})
    ended = event(MotionEvent.LOG_ENDED_IN_AIR, height=9.0)
    assert headline(status_lights, events=(ended,)) is status_lights[name]


def test_advice_on_the_height_is_given_once_although_it_diverged_twice():
    """The first time showed less of the reason than the second, by which the flight was lost."""
    at_rest = {"part": "at rest", "acceleration": 7.8}
    gravity = Fact(SensorFact.GRAVITY_WRONG, Level.WATCH, **at_rest)
    first = event(MotionEvent.HEIGHT_DIVERGED, Level.BAD, cause=None)
    second = event(MotionEvent.HEIGHT_DIVERGED, Level.BAD, cause=gravity)
    cause = event(FailedFirst.HEIGHT_DIVERGED_FIRST, Level.BAD, cause=second)
    lost = event(Ending.CRASHED, Level.BAD, cause=cause)
    step = choose_next_step(lost, lights() | {Light.ESTIMATOR: first})
    assert str(step).count("in a mode that holds the height") == 1
    assert "accelerometer is calibrated" in str(step)


def test_a_swinging_setpoint_is_remedied_before_the_tracking_errors_that_it_causes():
    figures = {"subject": "roll", "angle": 0.44, "count": 4, "period": 3.2}
    swung = event(MotionEvent.ATTITUDE_SWUNG, end_time=9.0, **figures)
    status_lights = lights(tracking="watch")
    worst = headline(status_lights, events=(swung,))
    assert worst is swung
    step = choose_next_step(worst, status_lights)
    assert "lower the gains of the position controller" in str(step)


def test_a_hard_landing_ranks_above_lights_to_watch_and_below_those_that_are_bad():
    landed = event(MotionEvent.LANDED_HARD, speed=2.8)
    status_lights = lights(estimator="watch")
    worst = headline(status_lights, events=(landed,))
    assert worst is landed
    assert str(choose_next_step(worst, status_lights)).startswith("Check legs, arms and propellers")
    status_lights = lights(motors="bad")
    assert headline(status_lights, events=(landed,)) is status_lights[Light.MOTORS]


@mark.parametrize(
    "levels, code, level, light",
    [
        ({}, Ending.CRASHED, "bad", "tracking"),
        ({"wind": "bad"}, Ending.CRASHED, "bad", "tracking"),
        ({}, ReportedEvent.FAILSAFE, "watch", "tracking"),
        ({}, MotionEvent.HEIGHT_DIVERGED, "bad", "estimator"),
        ({}, ReportedEvent.RESTARTED_IN_FLIGHT, "bad", "power"),
        ({}, ReportedEvent.AUTOPILOT_SAID, "watch", None),
        ({"vibration": "bad"}, Ending.CRASHED, "bad", "tracking"),
        ({"vibration": "watch"}, ReportedEvent.FAILSAFE, "watch", "tracking"),
        ({"tracking": "watch"}, Ending.CRASHED, "bad", "tracking"),
        ({"tracking": "watch"}, ReportedEvent.FAILSAFE, "watch", None),
        ({"tracking": "bad"}, Ending.CRASHED, "bad", None),
    ],
)
def test_an_event_in_the_headline_is_its_light_unless_that_is_as_bad(levels, code, level, light):
    """An event replaces the light of its subject, such as the tracking, if the event is worse."""
    before = lights(**levels)
    event = Fact(code, Level(level))
    after = lights_with_event(before, event)
    # A warning that a light shows for want of a measurement gives way to a headline that is as bad.
    warning = Fact(MotionEvent.ATTITUDE_CAUGHT, Level(level))
    if LIGHT_OF_EVENT.get(code) is Light.TRACKING:
        assert (
            lights_with_event({**before, Light.TRACKING: warning}, event)[Light.TRACKING] is event
        )
    assert {name for name, fact in after.items() if fact is event} == ({light} - {None})


@mark.parametrize("codes", [MotionEvent, ReportedEvent, Ending])
def test_each_bad_event_has_a_light(codes):
    bad = {code for code in codes if Fact(code).is_bad}
    assert bad <= set(LIGHT_OF_EVENT)


def test_a_reset_by_the_watchdog_is_no_matter_of_the_supply():
    reset = Fact(ReportedEvent.RESTARTED_IN_FLIGHT, Level.BAD, watchdog=True)
    after = lights_with_event(lights(), reset)
    assert (after[Light.TRACKING], after[Light.POWER].level) == (reset, Level.GOOD)
