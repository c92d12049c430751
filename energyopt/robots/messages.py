"""Parts of error messages, and what all arguments have in common."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np


def shown(value: Any) -> str:
    """A value for a message: on one line, and not too long."""
    return " ".join(repr(value).split())[:100]


def as_numbers(value: Any) -> np.ndarray | None:
    """Any array of real numbers as floats; None for what holds texts, None, truth values, or is ragged."""
    try:
        array = np.array(value)
    except Exception:  # an object that says it is an array, and is none, may raise anything
        return None
    return array.astype(float) if array.dtype.kind in "iuf" else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown name: the nearest known ones, or some of them."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=4, cutoff=0.4)
    shown = near or known[:8]
    return f"{'nearest' if near else 'known'}: {', '.join(shown)}" if shown else "there is none"
