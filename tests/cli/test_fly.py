"""``mavdem fly``: what is flown is written whole or not at all, can be read and learnt from, and is the same again."""

import re
import tomllib
from contextlib import nullcontext
from unittest.mock import Mock

from command_line import document_of, refused, run, strict_json
from pytest import fail, mark

from sitl_scenarios.files import load, names, scenario_from_table, scenario_toml

pytestmark = mark.slow

SHORT = ["--duration", "20"]


def fly(capsys, *words):
    return document_of(capsys, "fly", *words)


def test_the_list_is_one_a_line_name_first(capsys):
    assert run("fly", "--list") == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == list(names())
    assert {"hover_blower", "paper_1"} < {
        scenario["name"] for scenario in fly(capsys, "--list")["scenarios"]
    }


@mark.parametrize("name", names())
def test_a_description_is_a_file_that_is_the_same_scenario(name, tmp_path):
    scenario = load(name)
    text = scenario_toml(scenario)
    assert scenario_from_table(tomllib.loads(text)) == scenario
    # Every key that is on or off says so.
    assert text.count("; true or false") == len(re.findall(r"(?m)^\w+ = (?:true|false)\b", text))


@mark.parametrize(
    "text", ["two\nlines", "\x1b[31mred\x07", "\x7f\x80\x9b\u2028\u202e\U000e0001", '"\\', "\t\r"]
)
def test_a_description_of_any_characters_reads_back_and_sends_none_to_the_terminal(
    text, tmp_path, capsys
):
    """The description of a scenario contains control characters."""
    own_file = tmp_path / "mine.toml"
    again = tmp_path / "again.toml"
    escaped = "".join(f"\\U{ord(character):08x}" for character in text)
    own_file.write_text(f'description = "{escaped}"\n')
    assert load(own_file).description == text
    assert run("fly", own_file, "--describe") == 0
    output = capsys.readouterr().out
    assert output.replace("\n", "").isprintable()
    again.write_text(output)
    assert load(again) == load(own_file)


@mark.parametrize("speed, flown, slow", [(2, 18.0004, True), (2, 19.2, False), (0.5, 4.7, True)])
def test_a_live_flight_says_how_it_went_and_if_the_machine_is_too_slow(
    speed, flown, slow, monkeypatch, capsys
):
    """In 10 s of real time at double speed 20 s should be simulated. With less than 19 s, the user is warned."""
    shown_texts = []

    def fly_live(scenario, simulation, ground, speed, show):
        for now in (5.0, 1e9):
            show(now)
        return Mock(flown=flown, took=10.0004, sent=7, commands=2, stopped=False)

    monkeypatch.setattr("mavdem.cli.fly.fly_live", fly_live)
    monkeypatch.setattr("mavdem.cli.fly.progress", lambda _: nullcontext(shown_texts.append))
    arguments = ["fly", "calm", "--udp", "127.0.0.1:9", "--speed", speed, "--duration", "20"]
    assert run(*arguments, "--json") == 0
    captured = capsys.readouterr()
    if slow:
        assert "This machine is too slow" in captured.err
    else:
        assert "This machine is too slow" not in captured.err
    document = strict_json(captured.out)
    assert (document["flown"], document["took"]) == (round(flown, 3), 10.0)
    assert 0 < shown_texts[0] <= 0.25 and shown_texts[1] == 1.0


def test_files_that_fail_to_be_written_leave_those_that_were_there(tmp_path, capsys, monkeypatch):
    full = Mock(side_effect=OSError(28, "No space left on device"))
    monkeypatch.setattr("mavdem.cli.fly.write_truth", full)
    (tmp_path / "f.rrd").write_bytes(b"old")
    arguments = ["hover_blower", "--out", tmp_path / "f.tlog", "--rrd", tmp_path / "f.rrd", *SHORT]
    assert "No space left" in refused(capsys, 2, "fly", *arguments)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]


@mark.parametrize("words", ["fly hover_blower --out none.tlog", "reproduce noise --out none"])
def test_a_place_that_takes_no_file_is_refused_before_the_work(words, here, capsys, monkeypatch):
    # It takes none, as /proc does, though its mode says that it would.
    monkeypatch.setattr("mavdem.files.TemporaryDirectory", Mock(side_effect=FileNotFoundError))
    for work in ("fly.progress", "reproduce.process_pool"):
        monkeypatch.setattr(f"mavdem.cli.{work}", lambda *_: fail("it works"))
    assert "not writable" in refused(capsys, 2, *words.split())
