"""The errors energyopt raises on purpose.

Every message is one line that says what is wrong, where, what was expected, and what to do about it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from energyopt.plans import Plan


class EnergyOptError(Exception):
    """Base class: catching it catches everything energyopt raises on purpose."""


class InputError(EnergyOptError, ValueError):
    """The request itself is wrong; nothing was solved (command line: exit code 2)."""


class RobotError(InputError):
    """A robot model cannot be found, read, or is physically impossible."""


class ProblemError(InputError):
    """A problem is malformed, contradicts itself, or cannot be met whatever the motion."""


class GeometryError(InputError):
    """A shape, its pose or its mesh is malformed, or a collision model cannot be built from it."""


class FileError(InputError):
    """A file is missing, unreadable, damaged, or of another kind than its name says."""


class MissingDependencyError(EnergyOptError):
    """An optional package is needed for what was asked; the message names how to install it."""


class SimulationError(EnergyOptError):
    """The physics simulation left the range in which its numbers mean anything."""


class NoSolutionFound(EnergyOptError):
    """The planner ended without a valid motion.

    Attributes:
        plan: the best attempt, with its status, violations and options.
    """

    def __init__(self, plan: Plan):
        super().__init__(plan.message)
        self.plan = plan


class BatchInterrupted(KeyboardInterrupt):
    """Ctrl-C while several problems were being planned: a KeyboardInterrupt that keeps what was done.

    Attributes:
        results: one a problem that was drawn, in order: its plan, or a failure that says that it was not reached.
    """

    def __init__(self, results: list[Any]):
        super().__init__(f"interrupted; {sum(result.solved for result in results)} of {len(results)} problems are solved")
        self.results = results
