"""Experiments: other methods, held-out errors, comparisons, and the experiments of the paper."""
