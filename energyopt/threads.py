"""Linear algebra on one thread: the matrices of a plan are small, and several threads on them mostly wait for one another."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


def single_thread() -> AbstractContextManager:
    """A context in which NumPy's and SciPy's linear algebra keeps to one thread."""
    return _controller().limit(limits=1, user_api="blas")


@cache
def _controller() -> ThreadpoolController:
    """Knows the libraries that are loaded when it is made, so it is made once NumPy and SciPy are."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()
