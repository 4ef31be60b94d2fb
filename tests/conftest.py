"""What holds for every test."""

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

# A busy machine may take long over an example; the profile is otherwise the one that hypothesis chose.
settings.register_profile("without deadline", settings(), deadline=None)
settings.load_profile("without deadline")


@pytest.fixture(autouse=True, scope="session")
def one_thread_for_linear_algebra():
    """As learning has it: for small matrices more threads only wait for each other."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield
