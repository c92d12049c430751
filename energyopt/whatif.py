"""What if the payload were heavier, the move slower, the goal elsewhere? Re-solves of one problem with other numbers.

A session holds a base problem and its last optimum. A re-solve takes over the refined knots, the rows that were added, the
compiled kernels (whose inputs the numbers of the arm are, see `dynamics.parameters`) and what is prepared of the geometry, and
starts from the last motion, its ends moved to where they now have to be:

    q(t) + (1 − b(t/T)) Δstart + b(t/T) Δgoal,    b(s) = 10 s³ − 15 s⁴ + 6 s⁵.

The knots are refined further only where the estimated error of J has grown beyond the accuracy asked. Every result is a `Plan`,
and solved only if the independent dense check says so. The search is local: it follows one optimum, and where a change makes
another optimum better, only a cold start can find that (`cold=True` tries both).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np

from energyopt import planning
from energyopt.attempts import Attempt
from energyopt.campaign import Campaign
from energyopt.clearance_checks import check_ends
from energyopt.clock import now
from energyopt.dynamics.kernels import kernels_of
from energyopt.errors import NoSolutionFound, ProblemError
from energyopt.feasibility import check_feasibility
from energyopt.parameterizations import BSpline, HermiteSimpson, Sinusoid
from energyopt.parameterizations.bspline import SplineSpace
from energyopt.parameterizations.space import MotionSpace
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SplineTrajectory, Trajectory
from energyopt.plans import Plan, Status
from energyopt.problem import Problem
from energyopt.problem_values import shown
from energyopt.readable import Readable
from energyopt.refinement import ALIKE, DOUBT, difference, rough
from energyopt.robots.messages import did_you_mean
from energyopt.robots.model import RobotModel
from energyopt.robots.payload import Payload
from energyopt.robots.variation import Variation, with_numbers
from energyopt.search import Search
from energyopt.search_state import SearchOptions
from energyopt.solvers import Interrupts
from energyopt.threads import single_thread

ROUGH_NODES = 5
"""Quadrature nodes a span of refined knots where there is Coulomb friction."""
STATIONS = {"start", "goal", "waypoints", "obstacles", "workspace", "clearance", "attached", "self_collision"}
"""Changes after which start, goal or waypoints may touch something."""
MOST_JUDGED = 3
"""Motions kept whose error was looked for, besides the first."""
OF_THE_ROBOT = ("payload", "mass", "masses", "friction", "armature", "viscous_friction", "coulomb_friction", "gravity")
"""Changes that concern the arm; every other one is a field of `Problem`."""
OF_THE_PROBLEM = tuple(f.name for f in fields(Problem) if f.name not in ("robot", "name", "origin"))
_KINDS = {kind.__name__: kind for kind in (BSpline, Sinusoid, HermiteSimpson)}


def what_if(base: Problem | Plan, **options: Any) -> WhatIf:
    """A session of re-solves.

    Args:
        base: a problem, which is planned first, or a solved plan.
        options: of `energyopt.plan`, for a problem.

    Raises:
        InputError: an argument makes no sense.
        NoSolutionFound: the problem has no valid motion.
    """
    if isinstance(base, Problem):
        base = planning.plan(base, **options)
        if base.status is Status.INTERRUPTED:
            raise KeyboardInterrupt  # there is no session without an optimum
    elif not isinstance(base, Plan):
        raise ProblemError(f"what_if: base is {shown(base)}: expected an energyopt.Problem or a solved Plan")
    elif options:
        raise ProblemError(f"what_if: {', '.join(options)}: options of plan go with a problem; a Plan has been made with its own")
    if not base.solved:
        raise ProblemError(f"what_if: the plan is {base.status.value}: expected a solved one")
    return WhatIf(base)


class WhatIf(Readable):
    """A problem whose numbers may be changed; see the module docstring.

    Attributes:
        base: the plan of the unchanged problem; plan: of the last solve that succeeded, from which the next one starts.
    """

    def __init__(self, base: Plan):
        self.base = self.plan = base
        self.parameterization = parameterization_of(base)
        self._near = _search_at(base)
        self._trust: float | None = None
        self._judged = [(base.trajectory, base.discretization_error)]
        self._found: Search | None = None

    def in_brief(self) -> str:
        return f"base {self.base.in_brief()}; now {self.plan.in_brief()}"

    def solve(self, *, cold: bool = False, throw: bool = True, **changes: Any) -> Plan:
        """Plan the base problem with some numbers changed.

        Args:
            cold: plan the changed problem from the usual guesses as well, and return the better plan.
            throw: raise where no valid motion is found; otherwise return the attempt with its status.
            changes: of the arm: ``payload`` (a `Payload` it carries besides), ``mass`` [kg] (of one at the tool, 0 for none),
                ``masses`` and ``friction`` (factors), ``armature``, ``viscous_friction``, ``coulomb_friction``, ``gravity`` as
                `load_robot` takes them; and every field of `Problem`. All count from the base problem, not from the last solve.

        Raises:
            InputError: a change makes no sense, or makes the request impossible.
            NoSolutionFound: no valid motion was found near the last one (nor from a cold start, if asked); carries the attempt.
        """
        problem = what_if_problem(self.base.problem, **changes)
        if STATIONS & changes.keys():
            check_ends(problem, problem.goal_position)
        return self.solve_problem(problem, cold=cold, throw=throw)

    def solve_problem(self, problem: Problem, *, cold: bool = False, throw: bool = True) -> Plan:
        """As `solve`, for a problem that was changed by other means (`what_if_problem`, say).

        Its arm has to have the joints of the base's; it starts quickest if it has been made by changes of the base's.
        """
        if problem.robot.joint_names != self.base.problem.robot.joint_names:
            raise ProblemError(f"what_if: the problem's robot is {problem.robot.name}: expected the joints of the base's")
        if rough(problem) != rough(self.base.problem):  # the knots, and the quadrature, are made for another kind of problem
            found = self._cold(problem)
        else:
            found = self._resolve(problem)
            if cold:
                found = min(found, self._cold(problem), key=lambda plan: (not plan.solved, plan.objective))
        if found.solved:
            self._keep(found)
        elif throw and found.status is not Status.INTERRUPTED:
            raise NoSolutionFound(found)
        return found

    def _cold(self, problem: Problem) -> Plan:
        return planning.plan(problem, self.parameterization, throw=False)

    def _resolve(self, problem: Problem) -> Plan:
        durations = problem.durations if problem.free_duration else None
        if durations is not None:
            problem = problem.lasting(float(np.clip(self.plan.duration, *durations)))
        check_feasibility(problem)
        began = now()
        kernels = kernels_of(problem.robot.dynamics)
        loaded = now() - began
        settings = {"parameterization": type(self.parameterization).__name__, **asdict(self.parameterization),
                    "kernels": kernels.kind, "what_if": True}  # fmt: skip
        with single_thread(), Interrupts() as stop:
            options = SearchOptions(stop=stop)
            campaign = Campaign(problem, self.parameterization, kernels, options, self.base.seed, durations=durations)
            search = self._search(campaign)
            search.resume()
            campaign.found.add(search)
            return planning.finished_plan(campaign, self._refined(campaign, search), loaded, settings)

    def resumed(self, problem: Problem) -> Search:
        """The search of a problem with a given duration, on the knots of the last optimum; nothing is verified."""
        campaign = Campaign(problem, self.parameterization, kernels_of(problem.robot.dynamics), SearchOptions(), self.base.seed)
        search = self._search(campaign)
        search.resume()
        return search

    def _search(self, campaign: Campaign) -> Search:
        """A search that starts from the last optimum."""
        problem, space = campaign.problem, self._near.space
        motion = _moved(space if space.duration == problem.duration else space.stretched(problem.duration), self.plan, problem)
        goal = motion(motion.duration) if problem.goal_position is None else problem.goal_position
        avoidance = campaign.searcher.relaxed(Attempt("what-if", motion, goal))
        search = self._near.restarted(problem, campaign.options, avoidance, campaign.searcher.spent, motion)
        search.name, search.durations = "what-if", campaign.durations
        among_obstacles = avoidance is not None and bool(avoidance.scene.obstacles)
        search.stiffness, search.hard = int(among_obstacles), among_obstacles
        return search

    def _refined(self, campaign: Campaign, search: Search) -> Search:
        """Refined further where the estimated error has grown too much."""
        accuracy = getattr(self.parameterization, "accuracy", None)
        if search.converged and accuracy is not None:
            search.error = self._estimate(search, accuracy)
            if search.error is not None and search.error > accuracy:
                return campaign.refined(search)
        search.harden(accuracy)
        self._found = search
        return search

    def _estimate(self, search: Search, accuracy: float) -> float | None:
        """The estimated error of J: that of a motion much like it, with some doubt, where one was judged; else by looking ahead.

        An estimate that has seen no refinement is too large; at the base it was so by a factor that is known.
        """
        if self.base.discretization_error is None or rough(search.problem):
            return self.base.discretization_error
        far, known = min(((difference(motion, search.trajectory), error) for motion, error in self._judged), key=lambda j: j[0])
        doubtful = known * (1.0 + DOUBT * far)
        if far <= ALIKE and doubtful <= accuracy:
            return doubtful
        if self._trust is None:
            base, own = self.base, _search_at(self.base)
            own.objective = own.first_objective = base.objective
            own.reaches(accuracy)
            self._trust = min(1.0, self.base.discretization_error / own.error) if own.error else 1.0
        search.reaches(accuracy)
        if search.error is None:
            return None
        estimate = self._trust * search.error
        self._judged = [self._judged[0], *self._judged[1:][-MOST_JUDGED:], (search.trajectory, estimate)]
        return estimate

    def _keep(self, plan: Plan) -> None:
        """Start the next solve from this plan."""
        found, self.plan = self._found, plan
        self._near = found if found is not None and found.trajectory is plan.trajectory else _search_at(plan)


def what_if_problem(base: Problem, **changes: Any) -> Problem:
    """A problem with some numbers changed, as `WhatIf.solve` takes them; nothing is solved.

    Raises:
        InputError: there is no such change, or a value makes no sense.
    """
    for key in changes:
        if key not in (*OF_THE_ROBOT, *OF_THE_PROBLEM):
            known = did_you_mean(key, (*OF_THE_ROBOT, *OF_THE_PROBLEM))
            raise ProblemError(f"what_if: no change is named '{key}'; {known}; fields of Problem can be changed too")
    of_problem = {key: value for key, value in changes.items() if key in OF_THE_PROBLEM}
    of_robot = {key: value for key, value in changes.items() if key in OF_THE_ROBOT}
    if of_robot:
        of_problem["robot"] = changed_robot(base.robot, of_robot)
    return replace(base, **of_problem) if of_problem else base


def changed_robot(robot: RobotModel, changes: Mapping[str, Any]) -> RobotModel:
    """A robot with some numbers changed; see `WhatIf.solve`."""
    changes = dict(changes)
    payload, mass = changes.pop("payload", None), changes.pop("mass", None)
    if payload is not None and mass is not None:
        raise ProblemError("what_if: payload and mass: expected one of them; a mass is that of a payload at the tool")
    if mass is not None and not (isinstance(mass, (int, float)) and mass == 0):
        payload = Payload(mass)
    variation = Variation(payload, changes.pop("masses", 1.0), changes.pop("friction", 1.0))
    return with_numbers(robot, variation, **changes)


def parameterization_of(plan: Plan) -> BSpline | Sinusoid | HermiteSimpson:
    """The parameterization a plan was made with."""
    kind = _KINDS[plan.options["parameterization"]]
    return kind(**{f.name: plan.options[f.name] for f in fields(kind) if f.name in plan.options})


def space_of(plan: Plan) -> MotionSpace:
    """The space in which a plan's motion is optimal: its own knots, for a spline."""
    motion = plan.trajectory
    if isinstance(motion, SplineTrajectory) and plan.options["parameterization"] == "BSpline":
        return SplineSpace(motion.breaks, motion.degree, ROUGH_NODES if rough(plan.problem) else None)
    return parameterization_of(plan).space(plan.duration)


def _search_at(plan: Plan) -> Search:
    """A search that has ended with a plan's motion."""
    return Search(plan.problem, space_of(plan), kernels_of(plan.problem.robot.dynamics), plan.trajectory, SearchOptions())


def _moved(space: MotionSpace, plan: Plan, problem: Problem) -> Trajectory:
    """The plan's motion with the ends of another problem, in its duration."""
    old, shift = space.interpolate(plan.trajectory), np.zeros((6, problem.robot.nv))
    ends = plan.trajectory(np.array([0.0, plan.duration]))
    first = problem.start - ends[0]
    last = np.zeros_like(first) if problem.goal_position is None else problem.goal_position - ends[1]
    blend = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    shift[0] = first
    shift += blend[:, None] * (last - first)
    shift /= problem.duration ** np.arange(6)[:, None]
    between = PolynomialTrajectory(np.array([0.0, problem.duration]), shift[None])
    return space.trajectory(old + space.interpolate(between))
