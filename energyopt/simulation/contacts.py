"""Which solids touched during a replay, when, and how deeply."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from energyopt.simulation.surroundings import Surroundings

TOUCHING = 1e-4
"""Depth [m] from which an overlap counts: below are the replay's own tracking error at the end of an arm, and MuJoCo's
tolerance. A plan without clearance may graze an obstacle to this depth."""


@dataclass(frozen=True)
class Contact:
    """Two solids that touched without a pause.

    Attributes:
        first: link, or name of what is attached; second: another one, or the obstacle.
        begin, end: first and last time of the touch [s].
        depth: greatest penetration [m]; time: when it was [s].
    """

    first: str
    second: str
    begin: float
    end: float
    depth: float
    time: float

    def __str__(self) -> str:
        when = f"{self.begin:.3f} to {self.end:.3f} s"
        return f"{self.first} – {self.second}, {when}, {1e3 * self.depth:.2g} mm deep at {self.time:.3f} s"


class ContactWatch:
    """Collects the overlaps that MuJoCo reports, step by step."""

    def __init__(self, surroundings: Surroundings, solid: np.ndarray):
        """``solid``: number of the solid of every geometry of the model."""
        self._surroundings, self._solid = surroundings, solid
        self._seen: dict[tuple[str, str], dict[int, float]] = {}

    def __call__(self, step: int, data: mujoco.MjData) -> None:
        """Look at the overlaps of the configuration that ``data`` holds, as those of the given step."""
        if not data.ncon:
            return
        names = self._surroundings.names
        for (a, b), distance in zip(data.contact.geom.tolist(), data.contact.dist.tolist(), strict=True):
            if distance < -TOUCHING:
                first, second = sorted((int(self._solid[a]), int(self._solid[b])))
                depths = self._seen.setdefault((names[first], names[second]), {})
                depths[step] = max(depths.get(step, 0.0), -distance)

    def counts(self, steps: int) -> np.ndarray:
        """Number of touching pairs at every step, shape (steps,)."""
        counts = np.zeros(steps, dtype=int)
        for depths in self._seen.values():
            counts[list(depths)] += 1
        return counts

    def contacts(self, times: np.ndarray) -> tuple[Contact, ...]:
        """All touches in order of their beginning; ``times`` [s] of the steps, shape (N,)."""
        found = []
        for pair, depths in self._seen.items():
            steps = np.array(sorted(depths))
            for touch in np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1):
                deepest = max(touch.tolist(), key=depths.get)
                span = float(times[touch[0]]), float(times[touch[-1]])
                found.append(Contact(*pair, *span, depths[deepest], float(times[deepest])))
        return tuple(sorted(found, key=lambda contact: (contact.begin, contact.first, contact.second)))
