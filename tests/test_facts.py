"""Facts: frozen records with figures and units, which words are made of elsewhere."""

import pickle
from dataclasses import FrozenInstanceError

import numpy as np
from pytest import raises

from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Level
from mavdem.facts.forecasts import ForecastFact
from mavdem.facts.model import ParameterDoubt
from mavdem.report.templates import sentence


def test_a_fact_has_a_code_a_level_a_time_and_figures_with_units():
    """A fact of NumPy numbers has plain Python numbers, and a figure knows its unit by its name."""
    fact = Fact(
        ForecastFact.FAILED,
        Level.WATCH,
        time=np.float64(3.5),
        subject="motor 2",
        error="",
        text="It rings.",
        rate=np.float64(4),
    )
    assert (fact.code, fact.level, fact.time, fact.subject) == (
        ForecastFact.FAILED,
        "watch",
        3.5,
        "motor 2",
    )
    assert dict(fact.figures) == {"error": "", "text": "It rings.", "rate": 4.0}
    assert fact.units["rate"] == "Hz"
    assert type(fact.figures["rate"]) is type(fact.time) is float


def test_a_fact_does_not_change_and_can_be_compared_hashed_and_sent():
    fact = Fact(ForecastFact.FAILED, error="", text="It rings.", names=["a", "b"])
    with raises(FrozenInstanceError):
        fact.level = Level.BAD
    with raises(TypeError):
        fact.figures["text"] = "another"
    assert pickle.loads(pickle.dumps(fact)) == fact
    assert hash(fact.replace(Level.BAD)) != hash(fact)
    assert fact.replace(text="It hums.").figures["text"] == "It hums."
    other = fact.with_code(ForecastFact.FAILED)
    assert (other.level, other.figures) == (Fact(ForecastFact.FAILED).level, fact.figures)
    with raises(ValueError, match="colour"):
        Fact(ForecastFact.FAILED, colour=3)


def test_words_are_those_of_the_table_and_errors_say_them():
    fact = Fact(ForecastFact.FAILED, error="", text="Too slow.", remedy="Log faster.")
    assert fact.remedy == "Log faster."
    assert sentence(fact) == str(fact) == "Too slow."
    assert fact.sentence_and_remedy == str(NotLearnable(fact)) == "Too slow. Log faster."


def test_several_doubts_have_one_remedy_and_a_slow_log_is_first_to_be_mended():
    """Two doubts about a parameter: the remedy is that of the one to solve first."""
    wind = Fact(ParameterDoubt.DEPENDS_ON_WIND_SPECTRUM, share=0.14)
    short = Fact(ParameterDoubt.ESTIMATE_UNCERTAIN, share=0.3)
    slow = Fact(ParameterDoubt.COMMANDS_TOO_FAST, share=0.3, rate=25.0, least_rate=80.0)
    # Only logs of 80 Hz and more have this doubt, and they are not called slow.
    filtered = Fact(ParameterDoubt.FILTER_TAKEN_FOR_LAG, bias=0.1)
    remedies = {
        (wind, short): wind.remedy,
        (wind, slow): slow.remedy,
        (wind, filtered): wind.remedy,
    }
    for doubts, remedy in remedies.items():
        assert Fact(ParameterDoubt.SEVERAL_DOUBTS, reason=doubts).remedy == remedy
    assert not Fact(
        ParameterDoubt.SEVERAL_DOUBTS, reason=(wind, short)
    ).without_flight_advice.remedy
