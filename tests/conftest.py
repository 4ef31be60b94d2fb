"""What holds for every test."""

import os

from hypothesis import settings

# Read when NumPy and SciPy are imported, here and in every process that a test starts: for small matrices more threads
# only wait for each other.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

# A busy machine may take long over an example; the profile is otherwise the one that hypothesis chose.
settings.register_profile("without deadline", settings(), deadline=None)
settings.load_profile("without deadline")
