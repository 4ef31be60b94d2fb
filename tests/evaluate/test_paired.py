"""The paired test: of windows that share no samples, at the level it says, whatever diverged."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom, wilcoxon

from mavdem.evaluate.scores import Paired, disjoint, paired

INF = np.inf


def windows(count: int, hop: int = 425, length: int = 850, flight: str = "a") -> list[SimpleNamespace]:
    return [SimpleNamespace(flight=flight, start=hop * k, stop=hop * k + length) for k in range(count)]


def test_windows_that_overlap_are_not_tested_together():
    assert disjoint(windows(15)).tolist() == [0, 2, 4, 6, 8, 10, 12, 14]
    assert disjoint(windows(4, hop=850)).tolist() == [0, 1, 2, 3]
    assert disjoint(windows(4, hop=300)).tolist() == [0, 3]
    assert disjoint([*windows(3), *windows(3, flight="b")]).tolist() == [0, 2, 3, 5]
    assert disjoint(windows(5)[::-1]).tolist() == [0, 2, 4]
    assert disjoint([]).tolist() == []


def test_the_test_is_wilcoxons_on_log_ratios():
    rng = np.random.default_rng(0)
    ours, theirs = rng.lognormal(size=(2, 15))
    found = paired(ours, theirs, windows(15))
    assert found.p_value == wilcoxon(np.log(ours / theirs)[::2]).pvalue
    assert found.ratio == pytest.approx(np.median(ours / theirs))
    assert (found.less, found.windows, found.tested) == (int((ours < theirs).sum()), 15, 8)
    back = paired(theirs, ours, windows(15))
    assert (back.p_value, back.ratio) == (found.p_value, pytest.approx(1 / found.ratio))


@pytest.mark.slow
def test_windows_that_share_half_their_samples_do_not_make_it_reject_too_often():
    """A method's advantage is that of both halves of its training part, which the next window has one of."""
    rng = np.random.default_rng(0)
    tries, of_all, of_disjoint = 500, 0, 0
    for _ in range(tries):
        halves = rng.standard_normal(31)
        errors = np.exp(halves[:-1] + halves[1:])
        of_all += paired(errors, np.ones(30)).p_value < 0.05
        of_disjoint += paired(errors, np.ones(30), windows(30)).p_value < 0.05
    most = binom.ppf(0.999, tries, 0.05)
    assert of_disjoint <= most < of_all


def test_a_method_that_diverged_lost_that_window():
    found = paired(np.ones(7), [INF, INF, 2, 3, 4, 0.5, INF])
    assert (found.less, found.ratio) == (6, 0.25)
    assert found.p_value == wilcoxon([-5, -5, -2.5, -3, -4, 2.5, -5]).pvalue or found.p_value < 0.1
    assert paired([INF, INF, 1], [INF, INF, 1]) == Paired(1.0, 0, 3, 3, 1.0)
    assert paired([INF, 1], [1, INF]).ratio == 1.0
    assert paired([INF, INF], [1, 1]).ratio == INF


def test_nothing_to_compare_is_no_evidence():
    none = paired([], [], [])
    assert np.isnan(none.ratio) and (none.windows, none.tested, none.p_value) == (0, 0, 1.0)
    assert paired([1, 2], [1, 2]).p_value == 1.0


@pytest.mark.parametrize(("ours", "theirs"), [([1, 2], [1]), ([1, np.nan], [1, 1]), ([1, -1], [1, 1]), (1, 1)])
def test_what_are_no_errors_of_the_same_windows_is_refused(ours, theirs):
    with pytest.raises(ValueError, match="^ours"):
        paired(ours, theirs)


def test_what_is_distinguished_takes_six_pairs_and_a_side():
    assert paired([1.0] * 6, [2.0] * 6).verdict == "lower" and paired([2.0] * 6, [1.0] * 6).verdict == "higher"
    assert paired([1.0] * 5, [2.0] * 5).verdict == paired([], []).verdict == "not distinguishable"
    assert paired([1.0, 2.0] * 10, [2.0, 1.0] * 10).to_dict()["verdict"] == "not distinguishable"
