"""Online learning: a model that is learned again and again from a stream of samples, and its estimates at each sample.

``learner`` uses the others: ``memory`` keeps the samples, ``forecaster`` predicts the next ones, ``error_bands`` and
``prediction_errors`` measure the errors, ``free_energy_monitor`` and ``anomaly_marks`` find unusual samples.
"""
