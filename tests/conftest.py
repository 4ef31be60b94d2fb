"""What holds for every test."""

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="session")
def one_thread_for_linear_algebra():
    """As learning has it: for small matrices more threads only wait for each other."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield
