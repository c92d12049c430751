"""Arguments of the public functions: what callers may pass, and one line that says what they passed in its place."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from energyopt.errors import InputError, MissingDependencyError
from energyopt.parameterizations import BSpline, HermiteSimpson, Sinusoid
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Plan
from energyopt.problem import Problem
from energyopt.problem_values import real, shown, whole
from energyopt.robots.messages import did_you_mean

if TYPE_CHECKING:
    from energyopt.simulation.log import ReplayLog

MOST_STARTS, MOST_ITERATIONS = 100_000, 1_000_000
STARTS_EXPECTED = f"a whole number of guesses, 1 to {MOST_STARTS}, or None"
PATH_SEARCHES = ("auto", "built-in", "ompl")
"""What may look for ways around obstacles."""


def check_planning(problem: Problem, parameterization: Any, options: Mapping[str, Any]) -> None:
    """The arguments of `energyopt.plan`, its ``options`` by name.

    Raises:
        InputError: one of them makes no sense.
    """
    check_problem("plan", problem)
    check_options(parameterization, options)


def check_options(parameterization: Any, options: Mapping[str, Any]) -> None:
    """The arguments of `energyopt.plan` that do not depend on the problem.

    Raises:
        InputError: one of them makes no sense.
    """
    if not isinstance(parameterization, BSpline | Sinusoid | HermiteSimpson):
        expected = "BSpline, Sinusoid or HermiteSimpson, such as energyopt.BSpline()"
        raise InputError(f"parameterization is {shown(parameterization)}: expected {expected}")
    for key, value in options.items():
        _OPTIONS[key](key, value)


def check_problem(function: str, problem: Problem) -> None:
    """Refuse what is no problem."""
    if not isinstance(problem, Problem):
        raise InputError(f"{function}: problem is {shown(problem)}: expected one energyopt.Problem (or what load_problem gives)")


def check_plan(function: str, plan: Plan) -> None:
    """Refuse what is no plan."""
    if not isinstance(plan, Plan):
        remedy = "solve it first: plan(problem)" if isinstance(plan, Problem) else "plan and load_plan give one"
        raise InputError(f"{function}: plan is {shown(plan)}: expected an energyopt.Plan; {remedy}")


def check_guess(problem: Problem, guess: Any) -> None:
    """Refuse a motion of another number of joints, and what is none.

    Raises:
        InputError: says what was given.
    """
    guess = _motion(guess)
    if guess.nv != problem.robot.nv:
        raise InputError(f"guess: a motion of {guess.nv} joints; expected {problem.robot.nv}, as {problem.robot.name} has")


def _motion(guess: Any) -> Trajectory:
    """The motion of a guess."""
    motion = getattr(guess, "trajectory", guess)
    if not isinstance(motion, Trajectory):
        raise InputError(f"guess is {shown(guess)}: expected a Trajectory, a Plan, or None")
    return motion


def check_log(plan: Plan, log: ReplayLog | None) -> None:
    """Refuse what is no replay, or that of another arm.

    Raises:
        InputError: no log, or one of another number of joints.
    """
    if log is None:
        return
    from energyopt.simulation.log import ReplayLog

    if not isinstance(log, ReplayLog):
        raise InputError(f"log is {shown(log)}: expected what energyopt.replay gives, or None")
    nv = plan.problem.robot.nv
    if log.q.shape[1] != nv:
        raise InputError(f"log: a replay of {log.q.shape[1]} joints; expected {nv}, as the plan has")


def check_names(function: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse options a function does not have."""
    known = tuple(known)
    for name in given:
        if name not in known:
            raise InputError(f"{function}: no option '{name}'; {did_you_mean(name, known)}")


def _or_none(check: Callable[[str, Any], Any]) -> Callable[[str, Any], Any]:
    return lambda key, value: None if value is None else check(key, value)


def _time_limit(key: str, value: Any) -> float:
    return real(key, value, lambda t: 0 < t < np.inf, "seconds > 0, or None for no limit")


def _path_search(key: str, value: Any) -> None:
    if not isinstance(value, str) or value not in PATH_SEARCHES:
        raise InputError(f"{key} is {shown(value)}: expected one of {', '.join(PATH_SEARCHES)}")
    if value == "ompl" and find_spec("ompl") is None:
        raise MissingDependencyError(f"{key}: OMPL is not installed: pip install 'energyopt[ompl]', or leave {key} out")


def _truth(key: str, value: Any) -> None:
    if not isinstance(value, bool):
        raise InputError(f"{key} is {shown(value)}: expected True or False")


def _verbose(key: str, value: Any) -> None:
    if not isinstance(value, bool) and not takes(value, 4):
        function = "a function of (phase, iteration, objective, violation)"
        raise InputError(f"{key} is {shown(value)}: expected True, False, or {function}")


def takes(function: Any, count: int) -> bool:
    """Whether a value can be called with so many arguments; built-in functions that do not tell are believed."""
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:
        return callable(function)
    return True


_OPTIONS: dict[str, Callable[[str, Any], Any]] = {
    "starts": _or_none(lambda key, value: whole(key, value, 1, MOST_STARTS, STARTS_EXPECTED)),
    "seed": lambda key, value: whole(key, value, 0, 2**63 - 1, "a whole number, 0 to 2**63 - 1"),
    "guess": _or_none(lambda key, value: _motion(value)),
    "time_limit": _or_none(_time_limit),
    "iterations": lambda key, value: whole(key, value, 1, MOST_ITERATIONS),
    "path_search": _path_search,
    "verbose": _verbose,
    "throw": _truth,
}
