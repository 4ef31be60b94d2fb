"""Errors of the predictions of a stream at several horizons, compared with the errors of two trivial predictions."""

import numpy as np

from mavdem.arrays import Array

ERROR_SECONDS = 10.0
"""Time constant of the averages of the squared errors, s; a choice."""

MODEL, LAST_SAMPLE, MEAN = range(3)
"""Ways of prediction, as indices: by the model, by repeating the last sample, by the mean of all samples so far."""


class PredictionErrors:
    """Compares each sample of a stream with its predictions at H horizons, by the model and by two trivial ways.

    Attributes:
        latest: (H, m) errors of the model's predictions of the latest sample; NaN where it was not predicted.
    """

    def __init__(self, dt: float, horizons: tuple[int, ...], outputs: int) -> None:
        """Begins without predictions.

        Args:
            dt: Sampling step, s.
            horizons: Steps ahead of the predictions, increasing, H of them.
            outputs: Number of outputs, m.
        """
        self._horizons = np.array(horizons)
        self._horizon_indices = np.arange(len(horizons))
        # Weight of a new squared error in an exponential average with the time constant ERROR_SECONDS.
        self._update_weight = 1 - np.exp(-dt / ERROR_SECONDS)
        # Ring buffer (slots, 3, H, m): for each of the latest samples what was predicted at it, by each of the three
        # ways at each horizon. With one slot more than the longest horizon, a sample's predictions are there until they
        # can be compared.
        self._predictions = np.full((horizons[-1] + 1, 3, len(horizons), outputs), np.nan)
        self._next_slot = 0
        self._sample_count = 0
        # Mean of all samples so far, (m,).
        self._mean = np.zeros(outputs)
        # Averages (H, 3, m) of the squared errors at each horizon, of each way of prediction; NaN before the first.
        self._mean_squares = np.full((len(horizons), 3, outputs), np.nan)
        self.latest = np.full((len(horizons), outputs), np.nan)

    def forget_predictions(self) -> None:
        """Forgets all predictions, as after a gap: no sample after it is compared with predictions before it."""
        self._predictions[:] = np.nan

    def forget_averages(self) -> None:
        """Forgets the averages of the squared errors, as of a model that has been replaced."""
        self._mean_squares[:] = np.nan

    def compare(self, sample: Array) -> None:
        """Compares the next sample with its predictions, and updates the averages of the squared errors.

        A sample is predicted in three ways: by the model, by the last sample at the time of the prediction, and by the
        mean of all samples before that time. The model should be better than the other two. The mean of the samples is
        updated last, so that only later predictions use this sample.

        Args:
            sample: (m,) outputs of the sample.
        """
        # The prediction at horizon h was made h samples ago. Its slot in the ring buffer is h before the next one.
        slots = (self._next_slot - self._horizons) % len(self._predictions)
        # (H, 3, m) errors of each way of prediction at each horizon.
        errors = sample - self._predictions[slots, :, self._horizon_indices]
        self.latest = errors[:, MODEL]
        squares = errors * errors
        averages = self._mean_squares
        new_averages = averages + self._update_weight * (squares - averages)
        is_finite = np.isfinite(new_averages)
        if not is_finite.all():
            # An average begins with the first error. If there was no prediction, the average does not change.
            first_or_new = np.where(np.isfinite(averages), new_averages, squares)
            new_averages = np.where(np.isfinite(squares), first_or_new, averages)
        self._mean_squares = new_averages
        self._sample_count += 1
        self._mean += (sample - self._mean) / self._sample_count

    def store(self, predictions: Array, sample: Array) -> None:
        """Stores the predictions that are made at a sample, after the sample has been compared with earlier ones.

        Args:
            predictions: (H, m) predictions of the model at each horizon.
            sample: (m,) the sample.
        """
        slot = self._predictions[self._next_slot]
        slot[MODEL] = predictions
        slot[LAST_SAMPLE] = sample
        slot[MEAN] = self._mean
        self._next_slot = (self._next_slot + 1) % len(self._predictions)

    @property
    def ratio(self) -> Array:
        """Recent mean squared error of the model over the better trivial prediction's, (H, m); NaN at first."""
        best_trivial = np.minimum(self._mean_squares[:, LAST_SAMPLE], self._mean_squares[:, MEAN])
        with np.errstate(invalid="ignore", divide="ignore"):
            return self._mean_squares[:, MODEL] / best_trivial
