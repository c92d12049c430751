"""What a rival is: a way to plan a motion, on its own terms, behind a small interface."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, ClassVar

from energyopt import Problem, RobotModel
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.serving import no_more_processes


@dataclass(frozen=True)
class Attempt:
    """One solve.

    Attributes:
        motion: what came out, converged or not.
        converged: whether the solver says so.
        iterations: of the solver.
        seconds: processor time of the solve alone.
        build: processor time of what the rival needs for this one problem before (differentiation, creating solvers).
    """

    motion: Trajectory
    converged: bool
    iterations: int
    seconds: float
    build: float = 0.0


class Rival(ABC):
    """One way to plan. `prepare` is called once a robot (what is compiled there counts for no solve), `solve` once a move."""

    says: ClassVar[str]
    """In words, for the table's legend."""
    requires: ClassVar[tuple[str, ...]] = ()
    """Packages that have to be importable."""

    def prepare(self, robot: RobotModel) -> None:  # noqa: B027
        """Do what is done once a robot."""

    @abstractmethod
    def solve(self, problem: Problem) -> Attempt:
        """Plan a move."""


def missing(rival: type[Rival]) -> list[str]:
    """The packages a rival needs that are not installed."""
    return [name for name in rival.requires if find_spec(name) is None]


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What ``work`` gives, and the processor time of all threads it took [s]; energyopt starts no worker processes meanwhile."""
    with no_more_processes():
        began = time.process_time()
        result = work()
        return result, time.process_time() - began
