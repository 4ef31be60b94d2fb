"""Scenario files: those that come with the package load; what is wrong in another is said in one sentence."""

from pytest import mark, raises

from sitl_scenarios.files import load
from sitl_scenarios.scenario import Scenario

GUST = '[[wind]]\nkind = "gust"\nstart = 5\nspeed = 3\n'


def test_an_empty_file_is_the_default_scenario(tmp_path):
    # A byte order mark is no part of the text.
    (tmp_path / "own.toml").write_bytes(b"\xef\xbb\xbf")
    assert load(tmp_path / "own.toml") == load(str(tmp_path / "own.toml")) == Scenario()


@mark.parametrize(
    "text, sentence",
    {
        '[[wind]]\nkind = "gaussian"\nsd=1\ns=-1': "wind.0.gaussian.s must be greater than or equal to 0.001, not -1",
        'duration = "long"': 'duration must be a valid number, not "long"',
        GUST + "strength = 2": "wind.0.gust.strength is no key of a scenario",
        "[vehicle]\nmodel = 'heron'": "vehicle.model must be 'ardrone2', 'iris' or 'crazyflie', not \"heron\"",
        '[excitation]\nkind = "chirp"\nlowest = 6': "excitation.lowest must be at most excitation.highest, 5 Hz, not 6",
        "height = 60": "duration must be at least 88 s for a height of 60 m, not 60",
        '[excitation]\nkind = "course"\nmoves = [{north = 5}]': "the course must end where it began",
        '[excitation]\nkind = "course"\nmoves = [{nort = 5}]': "excitation.course.moves.0.nort is no key of a scenario",
        '[excitation]\nkind = "course"\nmoves = [{hover=60}]': "at least 74 s for a height of 5 m and the course",
        "[vehicle]\ndrag_linear = [0.3]": "vehicle.drag_linear",
        "duration = [": "own.toml: ",
        "duration = " + "[" * 5000 + "]" * 5000: "own.toml: ",
        "[wind]\nkind = 'steady'\nspeed = 1": "wind ",
        "[[wind]]\nkind = 'steddy'\nspeed = 1": "wind.0 ",
        "".join(f"a{i} = 1\n" for i in range(2000)): "a0 is no key of a scenario",
    }.items(),
)
def test_what_is_wrong_is_said_in_a_sentence_that_names_file_and_key(tmp_path, text, sentence):
    """Each text is a faulty scenario file, and the error is one short line."""
    file = tmp_path / "own.toml"
    file.write_text(text)
    with raises(ValueError) as caught:
        load(file)
    message = str(caught.value)
    assert message.startswith(("own.toml", f"{file} cannot be read"))
    assert sentence in message and "\n" not in message and len(message) < 1500
    assert type(caught.value) is ValueError


def test_what_is_no_text_or_no_file_is_said_too(tmp_path):
    (tmp_path / "own.toml").write_bytes(b"\xff\xfe")
    with raises(ValueError, match="own.toml is no scenario or vehicle file"):
        load(tmp_path / "own.toml")
    with raises(ValueError, match="other.toml cannot be read: No such file"):
        load(str(tmp_path / "other.toml"))
    with raises(ValueError, match="/dev/zero cannot be read: it is a device"):
        load("/dev/zero")
    with raises(ValueError, match="there is no scenario 'hover_blowr': `mavdem fly --list`"):
        load("hover_blowr")
