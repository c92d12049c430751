"""Distinct optima of one problem: what several guesses led to.

Two motions are the same optimum where their J agree and they are never far apart. Guesses that end in one are counted.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from energyopt.parameterizations.trajectory import Trajectory

SAME_OBJECTIVE, SAME_PLACE = 1e-3, 0.1
"""Relative difference of J, and distance in any joint at any time [rad or m], up to which two motions are the same optimum."""
SAMPLES = 50


@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum that guesses led to.

    Attributes:
        objective: J by the program's own quadrature on the knots that all guesses begin with, so that optima compare; only the
            best ones are refined, which lowers J by some 10 %, now and then by more. Where links of the arm had to be kept apart,
            with the penalty that does it; optima that cost more even without are left as they are.
        guess: name of the first guess that led to it; guesses: how many did.
        seed: of the guesses.
        trajectory: the motion on those knots.
    """

    objective: float
    guess: str
    guesses: int
    seed: int
    trajectory: Trajectory

    @property
    def summary(self) -> dict[str, Any]:
        """Everything but the motion."""
        return {key: getattr(self, key) for key in ("objective", "guess", "guesses", "seed")}


def place(motion: Trajectory) -> np.ndarray:
    """Where a motion is at even steps of its duration [rad or m], (SAMPLES, nv)."""
    return motion(np.linspace(0.0, motion.duration, SAMPLES))


def distinct(found: Iterable[tuple[float, str, Trajectory]], seed: int) -> tuple[Optimum, ...]:
    """Optima among (J, name of the guess, motion) in the order of the guesses, of which the first stands for each; best first."""
    kept: list[tuple[float, str, Trajectory]] = []
    places: list[np.ndarray] = []
    counts: list[int] = []
    for objective, name, motion in found:
        there = place(motion)
        for k, (other, _, _) in enumerate(kept):
            if abs(objective - other) <= SAME_OBJECTIVE * abs(other) and np.abs(there - places[k]).max() <= SAME_PLACE:
                counts[k] += 1
                break
        else:
            kept.append((objective, name, motion))
            places.append(there)
            counts.append(1)
    optima = [Optimum(*item[:2], number, seed, item[2]) for item, number in zip(kept, counts, strict=True)]
    return tuple(sorted(optima, key=lambda optimum: optimum.objective))


def described(optima: tuple[Optimum, ...], most: int = 6) -> str:
    """Such as ``2 distinct optima from 20 guesses that converged; J on the first knots (guesses): 463 (4), 701 (16)``."""
    guesses = sum(optimum.guesses for optimum in optima)
    shown = [f"{optimum.objective:.4g} ({optimum.guesses})" for optimum in optima[:most]] + ["…"] * (len(optima) > most)
    kinds = "1 optimum" if len(optima) == 1 else f"{len(optima)} distinct optima"
    return (
        f"{kinds} from {guesses} guess{'es' * (guesses > 1)} that converged; J on the first knots (guesses): {', '.join(shown)}"
    )
