"""Hermite–Simpson collocation written by hand in CasADi, as carefully as can be: the strongest rival.

Unknowns are z_k = (q, q̇, q̈)_k at the nodes and midpoints of N intervals of lengths h. With the acceleration linear on an
interval (nodes 0 and 1, midpoint m) all dynamics are linear rows,

    a_m = (a₀ + a₁)/2     v_m = (v₀ + v₁)/2 + h (a₀ − a₁)/8     v₁ = v₀ + h (a₀ + a₁)/2
                          q_m = (q₀ + q₁)/2 + h (v₀ − v₁)/8     q₁ = q₀ + h (v₀ + 4 v_m + v₁)/6

and whatever is not linear belongs to one point alone: φ(z) = Σ wτ² + λ q̇² under Simpson's weights, and |τ(z)| ≤ τ_max. So the
Hessian of the Lagrangian is block-diagonal. Value, gradient, Jacobian and Hessian at one point are SX functions, written as
C, compiled once a robot, mapped over the points, and handed to IPOPT as they are. Limits hold between the nodes
because the inner Bernstein coefficients of q̇ and q (v₀ + h a₀/2; q₀ + h v₀/3, q₁ − h v₁/3) are bounded too. Intervals grow
shorter towards both ends, which lowered J by 1 to 8 % at the same number; accelerations at start and goal are free.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np
import scipy.sparse as sp
from _rival import Attempt, Rival, timed

from energyopt import Problem, baseline
from energyopt.dynamics.compiler import find_compiler
from energyopt.parameterizations.bspline import graded_breaks
from energyopt.parameterizations.trajectory import PolynomialTrajectory
from energyopt.solvers import SolverOptions
from energyopt.solvers.linear import MUMPS

MARGIN = 0.995
"""Share of the torque limits allowed at nodes and midpoints, so that they hold between."""
FLAGS = ("-O1", "-march=native", "-fPIC", "-shared")
SETTINGS = MUMPS | {
    "print_level": 0, "sb": "yes", "tol": SolverOptions.tolerance, "max_iter": 500, "mu_init": 1e-2, "bound_relax_factor": 0.0,
    "min_refinement_steps": 0,
}  # fmt: skip
SOLVER = {"print_time": False, "no_nlp_grad": True, "calc_lam_p": False, "calc_lam_x": False, "record_time": False}


class HermiteSimpson(Rival):
    says = "Hermite–Simpson by hand in CasADi: 30 intervals, exact block-diagonal Hessian, all compiled, IPOPT tuned"
    intervals = 30

    def prepare(self, robot):
        self._points = _compiled(_point_functions(robot))

    def solve(self, problem):
        breaks = graded_breaks(problem.duration, self.intervals)
        (solver, arguments), build = timed(lambda: _program(problem, self._points, breaks))
        result, seconds = timed(lambda: solver(**arguments))
        stats = solver.stats()
        motion = _motion(np.array(result["x"]).reshape(-1, 3, problem.robot.nv), breaks)
        return Attempt(motion, bool(stats["success"]), stats["iter_count"], seconds, build)


class Coarser(HermiteSimpson):
    says = "the same with 20 intervals"
    intervals = 20


def _point_functions(robot) -> dict[str, ca.Function]:
    """Of one point z = (q, v, a): value, gradient and Jacobian, Hessian; s scales the cost; multipliers are those of τ."""
    nv = robot.nv
    z, s, multiplier = ca.SX.sym("z", 3 * nv), ca.SX.sym("s"), ca.SX.sym("l", nv)
    w, damping = ca.SX.sym("w", nv), ca.SX.sym("lambda", nv)
    q, v, a = z[:nv], z[nv : 2 * nv], z[2 * nv :]
    tau = robot.inverse_dynamics(q, v, a)
    phi = s * (ca.dot(w, tau**2) + ca.dot(damping, v**2))
    hessian = ca.triu(ca.hessian(phi + ca.dot(multiplier, tau), z)[0])
    given = [z, s, w, damping]
    return {
        "value": ca.Function("value", given, [phi, tau]),
        "slope": ca.Function("slope", given, [phi, ca.gradient(phi, z), tau, ca.jacobian(tau, z)]),
        "curvature": ca.Function("curvature", [*given, multiplier], [hessian]),
    }


def _compiled(functions: dict[str, ca.Function]) -> dict[str, ca.Function]:
    """The same functions as machine code, or as they are where there is no C compiler."""
    compiler = find_compiler()
    if compiler is None:
        return functions
    with tempfile.TemporaryDirectory(prefix="rivals-") as folder:
        code = ca.CodeGenerator("points.c")
        for function in functions.values():
            code.add(function)
        code.generate(f"{folder}/")
        library = Path(folder) / "points.so"
        subprocess.run([*compiler, *FLAGS, f"{folder}/points.c", "-o", library, "-lm"], check=True)
        return {name: ca.external(name, str(library)) for name in functions}


def _program(problem: Problem, points: dict[str, ca.Function], breaks: np.ndarray):
    """IPOPT made for the problem, and what it is called with."""
    nv, count = problem.robot.nv, 2 * (len(breaks) - 1) + 1
    x, p = ca.MX.sym("x", 3 * nv * count), ca.MX.sym("p", 0)
    weights = ca.DM(_simpson(np.diff(breaks))).T
    shared = ca.DM(problem.torque_weights), ca.DM(problem.velocity_weight)
    rows, lower, upper = _linear_rows(problem, np.diff(breaks))
    matrix = ca.DM(sp.csc_matrix(rows))
    at = lambda name, *arguments: points[name].map(count)(
        arguments[0], arguments[1], *(ca.repmat(c, 1, count) for c in shared), *arguments[2:]
    )
    z = ca.reshape(x, 3 * nv, count)
    phi, tau = at("value", z, weights)
    slope_phi, gradient, slope_tau, jacobian = at("slope", z, weights)
    f, g = ca.sum2(phi), ca.vertcat(matrix @ x, ca.vec(tau))
    factor, multiplier = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.shape[0])
    hessian = at("curvature", z, factor * weights, ca.reshape(multiplier[matrix.shape[0] :], nv, count))
    blocks = lambda mapped, name, out: ca.sparsity_cast(mapped, ca.diagcat(*[points[name].sparsity_out(out)] * count))
    steep = ca.vertcat(matrix, blocks(jacobian, "slope", 3))
    dense_gradient = ca.vec(gradient)
    options = SOLVER | {
        "ipopt": SETTINGS,
        "grad_f": ca.Function("grad_f", [x, p], [ca.sum2(slope_phi), dense_gradient], ["x", "p"], ["f", "grad_f_x"]),
        "jac_g": ca.Function("jac_g", [x, p], [ca.vertcat(matrix @ x, ca.vec(slope_tau)), steep], ["x", "p"], ["g", "jac_g_x"]),
        "hess_lag": ca.Function(
            "hess_lag", [x, p, factor, multiplier], [blocks(hessian, "curvature", 0)],
            ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
        ),
    }  # fmt: skip
    solver = ca.nlpsol("hermite_simpson", "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)
    bound = np.tile(MARGIN * problem.limits.torque, count)
    low, high = _bounds(problem, count)
    guess = _guess(problem, breaks)
    arguments = {"x0": guess, "lbx": low, "ubx": high}
    arguments |= {"lbg": np.concatenate([lower, -bound]), "ubg": np.concatenate([upper, bound])}
    return solver, arguments


def _simpson(h: np.ndarray) -> np.ndarray:
    """Weights of nodes and midpoints."""
    weights = np.zeros(2 * len(h) + 1)
    weights[:-1:2] += h / 6
    weights[1::2] = 4 * h / 6
    weights[2::2] += h / 6
    return weights


def _linear_rows(problem: Problem, h: np.ndarray):
    """Defects (= 0) and the Bernstein coefficients of q̇ and q inside an interval (within limits), all joints; sparse (m, n)."""
    Q, V, A = range(3)
    defects = [
        {(1, A): 1.0, (0, A): -0.5, (2, A): -0.5},
        {(1, V): 1.0, (0, V): -0.5, (2, V): -0.5, (0, A): -h / 8, (2, A): h / 8},
        {(2, V): 1.0, (0, V): -1.0, (0, A): -h / 2, (2, A): -h / 2},
        {(1, Q): 1.0, (0, Q): -0.5, (2, Q): -0.5, (0, V): -h / 8, (2, V): h / 8},
        {(2, Q): 1.0, (0, Q): -1.0, (0, V): -h / 6, (1, V): -4 * h / 6, (2, V): -h / 6},
    ]
    between = [{(0, V): 1.0, (0, A): h / 2}, {(0, Q): 1.0, (0, V): h / 3}, {(2, Q): 1.0, (2, V): -h / 3}]
    chain = lambda pattern: sp.kron(_chain(pattern, len(h)), sp.identity(problem.robot.nv))
    rows = sp.vstack([chain(defects), chain(between)])
    limits, zero = problem.limits, np.zeros(len(defects) * len(h) * problem.robot.nv)
    low = np.tile([-limits.velocity, limits.lower, limits.lower], (len(h), 1, 1))
    high = np.tile([limits.velocity, limits.upper, limits.upper], (len(h), 1, 1))
    return rows, np.concatenate([zero, low.ravel()]), np.concatenate([zero, high.ravel()])


def _chain(pattern: list[dict], intervals: int) -> sp.csr_matrix:
    """The rows of a pattern ((point, order) → factor, one or one an interval) on every interval, for one joint."""
    matrix, first = sp.lil_matrix((intervals * len(pattern), 3 * (2 * intervals + 1))), np.arange(intervals)
    for r, row in enumerate(pattern):
        for (point, order), factor in row.items():
            matrix[first * len(pattern) + r, 3 * (2 * first + point) + order] = factor
    return matrix.tocsr()


def _bounds(problem: Problem, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of all unknowns: limits; start and goal at rest."""
    limits, free = problem.limits, np.full(problem.robot.nv, np.inf)
    low = np.tile(np.array([limits.lower, -limits.velocity, -free]), (count, 1, 1))
    high = np.tile(np.array([limits.upper, limits.velocity, free]), (count, 1, 1))
    for point, position in ((0, problem.start), (-1, problem.goal_position)):
        low[point, 0] = high[point, 0] = position
        low[point, 1] = high[point, 1] = 0.0
    return low.ravel(), high.ravel()


def _guess(problem: Problem, breaks: np.ndarray) -> np.ndarray:
    quintic, t = baseline(problem, "quintic"), np.sort(np.concatenate([breaks, 0.5 * (breaks[1:] + breaks[:-1])]))
    return np.stack([quintic(t, order) for order in range(3)], axis=1).ravel()


def _motion(z: np.ndarray, breaks: np.ndarray) -> PolynomialTrajectory:
    """The piecewise cubic through states (count, 3, nv) at the nodes, every other point."""
    q, v, a = z[::2, 0], z[::2, 1], z[::2, 2]
    jerk = np.diff(a, axis=0) / np.diff(breaks)[:, None]
    return PolynomialTrajectory(breaks, np.stack([q[:-1], v[:-1], a[:-1] / 2, jerk / 6], axis=1))
