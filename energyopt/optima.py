"""Distinct optima of one problem: what several guesses led to.

Two motions are the same optimum where their J agree and they are never far apart. Guesses that end in one are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.readable import Readable, counted

SAME_OBJECTIVE, SAME_PLACE = 1e-3, 0.1
"""Relative difference of J, and distance in any joint at any time [rad or m], up to which two motions are the same optimum."""
HINGED_OBJECTIVE = 0.1
"""The same for motions with links kept apart: by penalties of several stiffnesses, whose share in J differs by that much."""
SAMPLES = 50


@dataclass(frozen=True, eq=False, repr=False)
class Optimum(Readable):
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

    def in_brief(self) -> str:
        return f"J {self.objective:.6g}, {counted(self.guesses, 'guess', 'es')}, first '{self.guess}'"

    @property
    def summary(self) -> dict[str, Any]:
        """Everything but the motion."""
        return {key: getattr(self, key) for key in ("objective", "guess", "guesses", "seed")}


def above(objective: float, best: float) -> float:
    """By which share of the best J another one is above it; J may be negative, where drives feed energy back."""
    return (objective - best) / max(abs(best), 1e-300)


def place(motion: Trajectory) -> np.ndarray:
    """Where a motion is at even steps of its duration [rad or m], (SAMPLES, nv)."""
    return motion(np.linspace(0.0, motion.duration, SAMPLES))


def groups(objectives: Sequence[float], motions: Sequence[Trajectory], same: float = SAME_OBJECTIVE) -> list[list[int]]:
    """Which motions are one optimum, as their numbers, ascending; the optimum of least J first.

    Args:
        objectives, motions: J and motion of each.
        same: share up to which J may be above the least of its group. No joint is ever farther than `SAME_PLACE` from there.
    """
    found: list[tuple[int, np.ndarray, list[int]]] = []
    for k in np.argsort(objectives, kind="stable").tolist():
        there = place(motions[k])
        for least, here, members in found:
            if above(objectives[k], objectives[least]) <= same and np.abs(there - here).max() <= SAME_PLACE:
                members.append(k)
                break
        else:
            found.append((k, there, [k]))
    return [sorted(members) for _, _, members in found]


def distinct(
    found: Sequence[tuple[float, str, Trajectory]], seed: int, same: float = SAME_OBJECTIVE
) -> tuple[Optimum, ...]:
    """Optima among (J, name of the guess, motion) in the order of the guesses, of which the first stands for each; best first.

    ``same``: as for `groups`.
    """
    objectives, names, motions = zip(*found, strict=True) if found else ((), (), ())
    optima = [
        Optimum(objectives[first], names[first], len(more) + 1, seed, motions[first])
        for first, *more in groups(objectives, motions, same)
    ]
    return tuple(sorted(optima, key=lambda optimum: optimum.objective))


def described(optima: tuple[Optimum, ...], most: int = 6) -> str:
    """Such as ``2 distinct optima from 20 guesses that converged; J on the first knots (guesses): 463 (4), 701 (16)``."""
    guesses = sum(optimum.guesses for optimum in optima)
    shown = [f"{optimum.objective:.4g} ({optimum.guesses})" for optimum in optima[:most]] + ["…"] * (len(optima) > most)
    kinds = "1 optimum" if len(optima) == 1 else f"{len(optima)} distinct optima"
    return (
        f"{kinds} from {guesses} guess{'es' * (guesses > 1)} that converged; J on the first knots (guesses): {', '.join(shown)}"
    )
