"""Which source a module runs: what it imports counts, what it does not, and comments, do not."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import source
from simulated import simulated

import mavdem
from mavdem.comparison import METHODS, Method, dem, judge
from mavdem.dem import Settings
from mavdem.windows import windows

JUDGE = judge.__module__
HOME = Path(mavdem.__file__).parent
RUN = [
    dem("DEM", Settings(window=9, parameter_precision=1.0)),
    dem("DEM paper", Settings.paper()),
    *(method for method in METHODS if method.name in ("subspace(2)", "PEM(2)", "EM(2)", "ARX(1)", "hold last")),
]


@pytest.fixture
def made_up(tmp_path, monkeypatch):
    """A package that hands on a name of each of two files; answers how to write a file of it."""
    folder = tmp_path / "made_up_package"
    folder.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(source, "OWN", "made_up_package")

    def write(name, text):
        (folder / f"{name}.py").write_text(text)
        source.digest.cache_clear()
        source._tree.cache_clear()

    write("__init__", "from made_up_package.one import f\nfrom made_up_package.other import g\n")
    write("one", "from made_up_package import deeper\n\ndef f(): return deeper.h()\n")
    write("deeper", "def h(): return 1\n")
    write("other", "def g(): return 2\n")
    write("user", "from made_up_package import f\n")
    yield write
    for name in [name for name in sys.modules if name.startswith("made_up_package")]:
        del sys.modules[name]


def test_a_digest_changes_with_what_is_imported_and_with_nothing_else(made_up):
    before = source.digest("made_up_package.user")
    made_up("other", "def g(): return 3\n")
    made_up("deeper", "# Why it is one.\ndef h():\n    return 1\n")
    assert source.digest("made_up_package.user") == before
    made_up("deeper", "def h(): return 2\n")
    assert source.digest("made_up_package.user") != before


def test_peers_do_not_run_what_only_dem_does():
    peers, ours = source.imported("mavdem.baselines.pem", JUDGE), source.imported("mavdem.dem.learn", JUDGE)
    assert {"mavdem.dem.recursion", "mavdem.baselines.subspace", "mavdem.evaluate.skill"} <= peers
    assert {"mavdem.dem.trajectory", "mavdem.dem.learned", "mavdem.evaluate.skill"} <= ours
    assert not peers & {"mavdem.dem.learn", "mavdem.dem.learned", "mavdem.dem.settings", "mavdem.dem.prediction"}
    assert not ours & {"mavdem.baselines.pem", "mavdem.dem.online", "mavdem.comparison.standing"}


@pytest.mark.parametrize("method", RUN, ids=lambda method: method.name)
def test_nothing_runs_that_does_not_count(method: Method):
    (window, *_) = windows("made up", simulated(samples=300, wind=2.0), train=250, test=50)
    ran: set[str] = set()
    sys.setprofile(lambda frame, *_: ran.add(frame.f_code.co_filename))
    try:
        outcome = judge(method, window)
    finally:
        sys.setprofile(None)
    counted = source.imported(getattr(method.learn, "func", method.learn).__module__, JUDGE)
    own = {name for name in ran if Path(name).is_relative_to(HOME)}
    assert not outcome.failure and own
    assert own <= {find_spec(module).origin for module in counted}
