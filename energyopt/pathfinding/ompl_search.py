"""RRT-Connect of the Open Motion Planning Library, where that is installed (the extra ``ompl``), in place of our own.

I. A. Şucan, M. Moll and L. E. Kavraki, "The Open Motion Planning Library", IEEE Robotics & Automation Magazine 19, 2012.
Its own check of straight ways has a resolution that is a share of the space's extent; here ways are asked of `FreeSpace`.
The library has one random generator for all: two searches at the same time, in threads, are not reproducible.
"""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import Any

import numpy as np

from energyopt.errors import MissingDependencyError
from energyopt.pathfinding.free_space import LIMIT_SLACK, FreeSpace
from energyopt.pathfinding.rrt import Budget, PathSearch, ended, require_free, sampled_box


def ompl_rrt_connect(
    free: FreeSpace, start: np.ndarray, goal: np.ndarray, rng: np.random.Generator, budget: Budget | None = None
) -> PathSearch:
    """A path of straight free ways from ``start`` to ``goal`` (nv,) [rad], by OMPL; arguments and errors as of `rrt_connect`.

    Raises:
        MissingDependencyError: OMPL is not installed.
    """
    began, budget = time.monotonic(), budget or Budget()
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    base, geometric, util = _library()
    require_free(free, start, "start")
    require_free(free, goal, "goal")
    setup, ways = _set_up(base, geometric, free, start, goal)
    util.RNG.setSeed(int(rng.integers(1, 2**31)))
    deadline = budget.deadline()
    setup.solve(base.PlannerTerminationCondition(lambda: time.monotonic() > deadline or 2 + ways.free >= budget.nodes))
    nodes = 2 + ways.free
    # An approximate path, which ends elsewhere, also counts as a solution there.
    if not setup.haveExactSolutionPath():
        return ended(None, nodes, time.monotonic() - began)
    found = setup.getSolutionPath()
    path = np.array([_numbers(found.getState(k), len(start)) for k in range(found.getStateCount())])
    path[0], path[-1] = start, goal
    return ended(path, nodes, time.monotonic() - began)


def ompl_installed() -> bool:
    """Whether the library is there; it is not loaded."""
    return find_spec("ompl") is not None


def _library() -> tuple[Any, Any, Any]:
    try:
        from ompl import base, geometric, util
    except ImportError:
        raise MissingDependencyError(
            "OMPL is not installed: pip install 'energyopt[ompl]', or leave the search to our own"
        ) from None
    # It writes to the terminal otherwise, and calls a second seed an error, which it is not.
    util.setLogLevel(util.LogLevel.LOG_NONE)
    return base, geometric, util


def _set_up(base: Any, geometric: Any, free: FreeSpace, start: np.ndarray, goal: np.ndarray) -> tuple[Any, Any]:
    nv = len(start)
    space, bounds = base.RealVectorStateSpace(nv), base.RealVectorBounds(nv)
    for k, (low, high) in enumerate(zip(*sampled_box(free, start, goal), strict=True)):
        # A start that lies on a limit is outside for it without some slack.
        bounds.setLow(k, float(low) - LIMIT_SLACK)
        bounds.setHigh(k, float(high) + LIMIT_SLACK)
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(lambda state: bool(free.free(_numbers(state, nv))[0]))
    ways = _ways(base, information, free, nv)
    information.setMotionValidator(ways)
    states = [space.allocState(), space.allocState()]
    for state, q in zip(states, (start, goal), strict=True):
        for k in range(nv):
            state[k] = float(q[k])
    setup.setStartAndGoalStates(*states)
    setup.setPlanner(geometric.RRTConnect(information))
    return setup, ways


def _ways(base: Any, information: Any, free: FreeSpace, nv: int) -> Any:
    """The library's question whether a straight way is free, put to `FreeSpace`; counts those that are, a node each."""

    class Ways(base.MotionValidator):
        free = 0

        def checkMotion(self, first: Any, second: Any, *_: Any) -> bool:
            answer = free.free_way(_numbers(first, nv), _numbers(second, nv))
            self.free += answer
            return answer

    return Ways(information)


def _numbers(state: Any, nv: int) -> np.ndarray:
    return np.array([state[k] for k in range(nv)])
