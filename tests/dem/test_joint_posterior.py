"""DEM against the exact posterior of short series, drawn from the covariance that the posterior is taken with.

Where DEM is exact in some limit, it must get there at the rate its derivation gives; where it is not, its departure
must be the one its equations imply. docs/evidence/tried.md has how far it departs.
"""

from dataclasses import replace

import numpy as np
import pytest
from dem_posterior import DT, Embedding, decay, parameters_of, roll, states_of, weak_prior
from joint_gaussian import parameters_given
from scipy.special import erfc

from mavdem.dem.engine.generative import temporal_precision

SERIES = 40


def draw(system, number=SERIES):
    return system.draw(np.random.default_rng(0), number)


def standard_error(values):
    return np.std(values, axis=0, ddof=1) / np.sqrt(len(values))


def departures(system, embedding, number=10):
    """Mean square, by series and state, of DEM's states less the exact ones, in variances of DEM's own posterior.

    And the exact variance in the same unit, by state.
    """
    squares = []
    for outputs in draw(system, number)[1]:
        states, sd = states_of(system, outputs, embedding, weak_prior(system))
        seen = slice(embedding.centre, embedding.centre + len(states))
        exact, exact_sd = (part[seen] for part in system.states_given(outputs))
        squares.append(np.mean(((states - exact) / sd) ** 2, axis=0))
    return np.array(squares), np.mean((exact_sd / sd) ** 2, axis=0)


def departure(system, embedding):
    """The root mean square over everything."""
    return np.sqrt(np.mean(departures(system, embedding)[0]))


# The exact posterior itself.


@pytest.mark.parametrize("smoothness", [1, 2, 4])
def test_covariance_is_that_of_the_closed_form_and_of_twice_the_nodes(smoothness):
    system = replace(decay(smoothness, 0.1), lead=200)
    _, covariance = system.state_moments
    # ∫∫ e^−(u+v) ρ(u − v) du dv over the past, for a rate of decay of one; what was before it counts e^−20.
    s = system.smoothness
    variance = np.sqrt(np.pi) * s * np.exp(s**2) * erfc(s)
    np.testing.assert_allclose(np.diag(covariance), variance, rtol=1e-8)
    np.testing.assert_allclose(
        replace(system, nodes=12).state_moments[1], covariance, atol=1e-9 * variance
    )


# States, the parameters being known.


def test_states_come_to_the_exact_ones_as_measurement_noise_vanishes():
    """In proportion to it for p = 1, faster than its square for p = 2.

    With noise-to-signal precision ratio ε² small, the exact correction of y is −ε² (d/dt + A)ᵀ(d/dt − A) y to first
    order. DEM's is its first order, which needs w′: p = 1 does not have it and errs by order ε², p = 2 by order ε⁴ and
    ε² (dt/s)²; the posterior sd they are counted in is of order ε.
    """
    half = departure(decay(4, 0.025), Embedding(1, 0)) / departure(decay(4, 0.05), Embedding(1, 0))
    # What the next order changes: the noise-to-signal ratio at the edge of the band, three sd of the spectrum.
    next_order = 0.05**2 * (9 / (2 * 0.4**2) + 1)
    assert half == pytest.approx(1 / 2, rel=next_order)
    assert departure(decay(4, 0.1), Embedding(2, 1)) < departure(decay(4, 0.2), Embedding(2, 1)) / 4


@pytest.mark.parametrize("smoothness", [1, 2, 4])
@pytest.mark.parametrize("outputs", [1, 2], ids=["rate hidden", "both measured"])
def test_states_err_by_what_they_say_when_noise_is_as_it_is_read(smoothness, outputs):
    """E(x_D − x)² = E(x_D − x_exact)² + exact variance, for any estimate; DEM says it is its own variance."""
    squares, exact = departures(
        roll(smoothness, 0.1, outputs=outputs), Embedding(2, 1, as_read=True), SERIES
    )
    assert (np.abs(squares.mean(axis=0) + exact - 1) < 4 * standard_error(squares)).all()


@pytest.mark.parametrize("smoothness", [1, 2, 4])
def test_the_last_derivative_is_false_evidence(smoothness):
    """0 = A x″ + w″ leaves out x‴: the rate then errs by more than it says, and not if the equation is left out."""
    system = roll(smoothness, 0.1)
    for q, honest in ((2, False), (1, True)):
        squares, exact = departures(system, Embedding(2, q), SERIES)
        excess = squares[:, 1].mean() + exact[1] - 1
        assert (excess < 4 * standard_error(squares)[1]) == honest


# Parameters, the noise being known.


@pytest.mark.parametrize("smoothness", [1, 2, 4])
@pytest.mark.parametrize("p", [2, 4])
def test_every_sample_is_counted_as_if_independent(smoothness, p):
    """How much more than there is DEM learns of an input's gain, when all else is known.

    The input being a sinusoid at ω, a period tells dt/ρ̂(ω) per sample, where ρ̂ = 2√π s exp(−s²ω²) is the noise's
    spectrum. DEM takes [u; u′; …] at each sample for a regressor of its own: vᴴ S v with v = [1; iω; …]. Their ratio,
    at low frequency and q ≤ 1, is Σₖ ρ(k dt) = 2√π s/dt, the samples in a correlation time. What the ends of a series
    tell cancels in the difference of two lengths.
    """
    period = 50
    omega = 2 * np.pi / (period * DT)
    noise = 0.03
    q = p - 1

    def information(samples):
        system = replace(
            decay(smoothness, noise, gain=1.0, samples=samples),
            free=np.array([1]),
            inputs=lambda times: np.sin(omega * times)[:, None],
        )
        _, covariance = parameters_of(
            system, draw(system, 1)[1][0], Embedding(p, q), weak_prior(system)
        )
        return np.array(
            [1 / covariance[0, 0] - weak_prior(system).precision[0, 0], system.information[0, 0]]
        )

    dem, exact = information(100 + period) - information(100)
    s = smoothness * DT
    v = (1j * omega) ** np.arange(q + 1)
    counted = (
        2
        * np.sqrt(np.pi)
        * smoothness
        * np.exp(-((s * omega) ** 2))
        * (v.conj() @ temporal_precision(q, s) @ v)
    )
    # Differences for derivatives; and what measurement noise takes from the exact information.
    tolerance = (omega * DT) ** 2 + noise**2 * (omega**2 + 1)
    assert dem / exact == pytest.approx(counted.real, rel=tolerance)


@pytest.mark.slow
def test_of_a_motion_that_only_noise_drives_dem_sees_the_ends_alone():
    """DEM's rate of decay is Σ x̃ᵀS Dx̃ / Σ x̃ᵀS x̃: of a smooth motion the upper sum telescopes.

    Smooth w leans on the x that it drove, E[x̃ᵀS w̃] > 0: what the normalizer of p(x̃ | θ), which U leaves out, is for.
    """
    noise = 0.003
    system = decay(2, noise)
    s = system.smoothness
    prior = weak_prior(system)
    ours = []
    exact = []
    for outputs in draw(system)[1]:
        y = outputs[:, 0]
        ends = (y[-1] * y[-2] - y[1] * y[0]) / (2 * DT)
        ends += 2 * s**2 * ((y[-1] - y[-2]) ** 2 - (y[1] - y[0]) ** 2) / (2 * DT**3)
        squares = np.sum(y[1:-1] ** 2) + 2 * s**2 * np.sum((y[2:] - y[:-2]) ** 2) / (2 * DT) ** 2
        weight = prior.precision[0, 0]
        ours.append(parameters_of(system, outputs, Embedding(2, 1), prior)[0][0])
        # States are the outputs, but for the noise-to-signal ratio at the edge of the band, as above.
        expected = (ends + weight * prior.mean[0]) / (squares + weight)
        assert ours[-1] == pytest.approx(expected, abs=noise**2 * (9 / (2 * s**2) + 1))
        exact.append(parameters_given(system, outputs, prior)[0][0])
    assert abs(np.mean(ours)) < 4 * standard_error(ours)
    assert abs(np.mean(exact) + 1) < 4 * standard_error(exact)


@pytest.mark.slow
@pytest.mark.parametrize("smoothness", [1, 2])
def test_a_backward_difference_makes_such_a_motion_grow(smoothness):
    """Σ xₜ (xₜ − xₜ₋₁)/dt ≥ 0: p = 1 reads the slope half a sample late, and the rate it finds is positive."""
    system = decay(smoothness, 0.003)
    rates = [
        parameters_of(system, y, Embedding(1, 0), weak_prior(system))[0][0] for y in draw(system)[1]
    ]
    assert np.mean(rates) > 4 * standard_error(rates)
