"""The words for a request that no motion can meet: where it is asked, by which joint, how much, and what would make it possible.

A problem read from a file calls its keys as the file does ("limits.acceleration", with file and line), one made in Python as the
arguments of `Problem` are called ("acceleration_limits").
"""

from __future__ import annotations

from energyopt.dynamics.body import joint_axis
from energyopt.errors import ProblemError
from energyopt.problem import Problem


def impossible(problem: Problem, key: str, text: str) -> ProblemError:
    """The error about an argument of `Problem`, such as "start", "waypoints[1]" or "torque_limits"."""
    place, name = ("", key) if problem.origin is None else problem.origin(key)
    return ProblemError(f"{place}: {name}: {text}" if place else f"{name}: {text}")


def called(problem: Problem, key: str) -> str:
    """What an argument of `Problem` is called where the user has written it."""
    return key if problem.origin is None else problem.origin(key)[1]


def joint(problem: Problem, i: int) -> str:
    return f"joint '{problem.robot.joint_names[i]}'"


def unit(problem: Problem, i: int) -> str:
    """Of a joint's position: rad, or m where it slides."""
    return "m" if joint_axis(problem.robot.model, i + 1)[0] == "prismatic" else "rad"
