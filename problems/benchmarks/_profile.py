"""Where the time of a plan goes: kernels, assembly, the solver's own work, Python; and the solvers side by side.

Functions of C are timed by calling them again and again at the optimum, in processor time; what they take in a solve is that
times the number of calls the solver counts. Kernels are the arm's torques and their derivatives at all samples; assembly is
what is made of them: gradient, Jacobian, Hessian of the program. The rest of a solve is the solver's own: linear algebra and
line search. The rest of a plan is Python: the program's arrays, the dense checks, the result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from _shared import Goal, quartiles, shown, table

import energyopt as eo
from energyopt.baselines import baseline
from energyopt.dynamics.kernels import Kernels, kernels_of
from energyopt.solvers import SolverOptions, SolverResult, interior, ipopt
from energyopt.transcription import NonlinearProgram, transcribe

PARTS = ("kernels", "assembly", "solver", "python")
SAYS = {
    "kernels": "torques and derivatives at the samples",
    "assembly": "gradient, Jacobian and Hessian made of them",
    "solver": "linear algebra, line search, its interface",
    "python": "program, guess, checks, result",
}
MEASURES = "where the processor time of energyopt.plan goes with fixed knots on random moves, and our solver beside IPOPT"
CALLS = 40
"""Times each function is called to be timed."""
FEW = (8, 24)
"""Samples given to kernels: the difference is what samples cost, without the call and without pages of new memory."""
SAME = 1e-5
"""Relative difference of J up to which two optima count as the same."""
SMALL_CHANGE = 0.01
"""Change of the goal [rad] after which a solve starts from the last optimum."""


def profile(problems: Sequence[eo.Problem], spline: eo.BSpline) -> dict:
    """Profiles of some problems, as quartiles over them."""
    runs = [_one(problem, spline) for problem in problems]
    spread = lambda key: quartiles([run[key] for run in runs])
    change = np.array([run["change"] for run in runs])
    return {
        "parts": {part: quartiles([run["parts"][part] for run in runs]) for part in (*PARTS, "plan")},
        "evaluation_per_iteration": spread("evaluation_per_iteration"),
        "solver_per_iteration": spread("solver_per_iteration"),
        **{
            key: spread(key)
            for key in ("ours", "ours_iterations", "ipopt", "ipopt_iterations", "ratio", "warm", "warm_iterations")
        },
        "same": int(np.sum(np.abs(change) <= SAME)),
        "better": int(np.sum(change < -SAME)),
        "worse": int(np.sum(change > SAME)),
        "mean_change": float(change.mean()),
        "problems": len(runs),
    }


def text(found: dict) -> str:
    """The profile as tables."""
    total = found["parts"]["plan"]["median"]
    rows = [
        (part, SAYS[part], shown(found["parts"][part], ".2f", 1e3), f"{100 * found['parts'][part]['median'] / total:.0f} %")
        for part in PARTS
    ]
    rows.append(("plan", "all together", shown(found["parts"]["plan"], ".2f", 1e3), ""))
    head = ("part of a plan", "what it is", "processor time, median (quartiles) [ms]", "share")
    solvers = [
        (name, shown(found[key], ".1f", 1e3), shown(found[f"{key}_iterations"], ".0f"))
        for name, key in (("ours", "ours"), ("IPOPT", "ipopt"), (f"ours, goal changed by {SMALL_CHANGE} rad", "warm"))
    ]
    each, own = (shown(found[key], ".3f", 1e3) for key in ("evaluation_per_iteration", "solver_per_iteration"))
    return (
        table(head, rows)
        + f"  kernels and assembly {each} ms an iteration, the solver's own work {own} ms\n\n"
        + table(("first solve", "processor time [ms]", "iterations"), solvers)
        + f"  IPOPT over ours, in turns: {shown(found['ratio'], '.1f')}; optima of {found['problems']}: same {found['same']}, "
        + f"ours better {found['better']}, worse {found['worse']}, mean change of J {100 * found['mean_change']:+.2f} %\n\n"
    )


def goals(found: dict, parsed) -> list[Goal]:
    """Stated for the Panda on 16 even control points."""
    if parsed.robot != "panda" or parsed.control_points != 16:
        return []
    return [
        Goal("kernels and assembly an iteration", 1e3 * found["evaluation_per_iteration"]["median"], 0.2, "ms"),
        Goal("plan", 1e3 * found["parts"]["plan"]["median"], 20.0, "ms"),
        Goal("solve", 1e3 * found["ours"]["median"], 10.0, "ms"),
        Goal("solve after a small change", 1e3 * found["warm"]["median"], 5.0, "ms"),
    ]


def _one(problem: eo.Problem, spline: eo.BSpline) -> dict:
    program, x0 = _program(problem, spline)
    solves = {interior: [], ipopt: []}
    for method in (interior, ipopt) * 3:
        solves[method].append(_timed(lambda method=method: method.solve(program, x0)))
    (ours, result), (reference, best) = (min(runs, key=lambda run: run[0]) for runs in solves.values())
    warm, again = _warm(problem, spline, result)
    whole = min(_timed(lambda: eo.plan(problem, spline, starts=1, throw=False))[0] for _ in range(3))
    kernels, evaluation = _calls(program, kernels_of(problem.robot.dynamics), result)
    return {
        "parts": {
            "kernels": kernels,
            "assembly": evaluation - kernels,
            "solver": ours - evaluation,
            "python": whole - ours,
            "plan": whole,
        },
        "evaluation_per_iteration": evaluation / max(result.iterations, 1),
        "solver_per_iteration": (ours - evaluation) / max(result.iterations, 1),
        "ours": ours,
        "ours_iterations": result.iterations,
        "ipopt": reference,
        "ipopt_iterations": best.iterations,
        "ratio": reference / ours,
        "warm": warm,
        "warm_iterations": again.iterations,
        "change": result.objective / best.objective - 1.0,
    }


def _program(problem: eo.Problem, spline: eo.BSpline) -> tuple[NonlinearProgram, np.ndarray]:
    program = transcribe(problem, spline.space(problem.duration), kernels_of(problem.robot.dynamics))
    return program, program.guess(baseline(problem))


def _warm(problem: eo.Problem, spline: eo.BSpline, last: SolverResult) -> tuple[float, SolverResult]:
    """The same problem with its goal a little elsewhere, from the last optimum."""
    limits = problem.robot.limits
    goal = np.clip(problem.goal + SMALL_CHANGE, limits.lower, limits.upper)
    changed = eo.Problem(problem.robot, problem.start, goal, problem.duration, self_collision=False)
    program, _ = _program(changed, spline)
    options = SolverOptions(barrier=1e-5)
    return min((_timed(lambda: interior.solve(program, last.x, options)) for _ in range(3)), key=lambda run: run[0])


def _calls(program: NonlinearProgram, kernels: Kernels, result: SolverResult) -> tuple[float, float]:
    """Seconds that a solve spends in kernels, and in all functions of the program."""
    evaluator, x = program.evaluator, result.x
    n, m, samples, nv = program.size, program.rows, len(program.layout.weight), program.layout.nv
    gradient, g, multipliers = np.empty(n), np.empty(m), np.zeros(m)
    jacobian, hessian = np.empty(len(program.jacobian_pattern[1])), np.empty(len(program.hessian_pattern[1]))
    z, p = np.random.default_rng(0).uniform(-1.0, 1.0, (FEW[1], 3 * nv)), np.ones((FEW[1], nv))
    kernel = {
        "state": lambda k: kernels.torque(z[:k]),
        "gradient": lambda k: kernels.adjoint(z[:k], p[:k], p[:k]),
        "hessian": lambda k: kernels.hessian(z[:k], p[:k], p[:k]),
    }
    a_sample = lambda call: (_each(lambda: call(FEW[1])) - _each(lambda: call(FEW[0]))) / (FEW[1] - FEW[0])
    whole = {
        "state": lambda: (evaluator.move(x), evaluator.objective(), evaluator.constraints(x, g)),
        "gradient": lambda: evaluator.gradient(gradient),
        "jacobian": lambda: evaluator.jacobian(jacobian),
        "hessian": lambda: evaluator.hessian(1.0, multipliers, hessian),
    }
    counts = result.evaluations
    return (
        sum(counts[name] * samples * a_sample(function) for name, function in kernel.items()),
        sum(counts[name] * _each(function) for name, function in whole.items()),
    )


def _each(function: Callable[[], object]) -> float:
    """Least processor time of one call, in groups."""
    function()
    return min(_timed(lambda: [function() for _ in range(CALLS)])[0] for _ in range(3)) / CALLS


def _timed(work: Callable) -> tuple[float, object]:
    began = time.process_time()
    result = work()
    return time.process_time() - began, result
