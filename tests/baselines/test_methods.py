"""What holds of every identified model: units, dependent inputs, stability, and data that teach nothing."""

from functools import partial

import numpy as np
import pytest
from innovation_systems import flown, random_system
from peculiar_flights import (
    FLIGHT,
    NOTHING_NEW,
    TEST,
    TRAIN,
    back_from_other_units,
    errors_of,
    growing,
    in_other_units,
    with_inputs,
)

from mavdem import Flight, Forecaster, baselines

METHODS = {"arx": baselines.arx, "subspace": baselines.subspace, "pem": partial(baselines.pem, order=2)}
SLOW = [pytest.param(partial(baselines.em, order=2), id="em", marks=pytest.mark.slow)]
ALL = [*(pytest.param(method, id=name) for name, method in METHODS.items()), *SLOW]


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("method", [baselines.subspace, baselines.pem])
def test_without_noise_the_forecast_is_exact(method, order):
    system = random_system(order, order)
    flight, _ = flown(system, 1, 450, noise=0.0)
    model = method(flight[:300], order=order)
    assert errors_of(model.forecast(flight.inputs[300:]), flight[300:]) < 1e-6
    assert errors_of(model.one_step(), flight[:300]) < 1e-6


@pytest.mark.parametrize("method", ALL)
def test_units_do_not_matter(method):
    model, other = method(TRAIN), method(in_other_units(TRAIN))
    assert isinstance(model, Forecaster) and repr(model).startswith(f"<Identified: {model.method}, ")
    forecast = back_from_other_units(other.forecast(in_other_units(TEST).inputs))
    np.testing.assert_allclose(forecast, model.forecast(TEST.inputs), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("method", [baselines.arx, baselines.subspace])
@pytest.mark.parametrize("more", NOTHING_NEW)
def test_inputs_that_tell_nothing_new_change_nothing(method, more):
    wider = with_inputs(FLIGHT, NOTHING_NEW[more](FLIGHT.inputs))
    plain, found = (method(flight[:700]).forecast(flight.inputs[700:]) for flight in (FLIGHT, wider))
    np.testing.assert_allclose(found, plain, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("method", ALL)
def test_inputs_that_stand_still_leave_what_the_outputs_do_by_themselves(method):
    still = with_inputs(FLIGHT, np.full_like(FLIGHT.inputs, 1500.0))
    model = method(still[:700])
    assert not model.model.B.any() and np.isfinite(model.forecast(still.inputs[700:])).all()


@pytest.mark.parametrize("method", ALL)
def test_an_unstable_model_is_said_to_be(method):
    as_found = method(growing(), order=1)
    assert not as_found.stable and "unstable" in as_found.cautions[0]


STILL = Flight(TRAIN.time, TRAIN.inputs, np.zeros((700, 2)))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: baselines.arx(TRAIN[:9], 2), "^train has 7 samples with 2 before them"),
        (lambda: baselines.arx(None), "^train must be a Flight"),
        (lambda: baselines.arx(TRAIN, 2.5), "^order must be a whole number of at least 1, not 2.5"),
        (lambda: baselines.subspace([TRAIN[i : i + 5] for i in range(0, 600, 5)], 4), "^train has too few samples"),
        (lambda: baselines.em(TRAIN, 10**9), "^train has too few samples for 1000000000 states"),
        *((partial(method, STILL), "^outputs column 0 must vary") for method in METHODS.values()),
        *(
            (partial(method, TRAIN[:30], 2), "^train has too few samples for 2 states: 30 in segments of 30")
            for method in (baselines.subspace, baselines.pem, baselines.em)
        ),
    ],
)
def test_what_cannot_be_learned_from_is_named(make, said):
    with pytest.raises(ValueError, match=said):
        make()
