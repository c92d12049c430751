"""Versions of what computes the numbers, for summaries and reports."""

from __future__ import annotations

import platform
from functools import cache
from importlib import metadata

from energyopt import __version__

LIBRARIES = ("casadi", "pin", "mujoco", "numpy", "scipy", "matplotlib", "example-robot-data")


def versions() -> dict[str, str]:
    """By name: energyopt, Python, and those of `LIBRARIES` that are installed."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    """Looked up once: that takes longer than planning a small problem."""
    found = {"energyopt": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
