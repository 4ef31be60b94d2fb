"""The link that signs a telephone in is a secret: a terminal shows it, and a log does not."""

from pytest import mark

from mavdem.cli.sign_in_links import print_sign_in_link

LINK = "http://192.168.1.20:9090/sign-in?token=0123456789abcdef0123456789abcdef"


@mark.parametrize("is_terminal", [True, False])
def test_a_link_is_shown_with_its_code_on_a_terminal_only(is_terminal, monkeypatch, capsys):
    monkeypatch.setattr("mavdem.cli.sign_in_links.stderr_is_terminal", lambda: is_terminal)
    print_sign_in_link(LINK)
    first_line, *code = capsys.readouterr().err.splitlines() or [""]
    assert first_line.endswith(LINK) == is_terminal
    # The rows of the code are equally wide, and high enough for its three corners.
    assert len({len(row) for row in code}) == int(is_terminal)
    assert len(code) > 14 or not is_terminal
