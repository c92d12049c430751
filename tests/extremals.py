"""Optimal motions without limits from the optimality conditions, by collocation of their boundary-value problem.

Minimise ∫ (τᵀWτ + λ q̇ᵀq̇) dt with the state (q, v) and the control u = q̈. Pontryagin's conditions with the Hamiltonian
H = τᵀWτ + λ vᵀv + pᵀv + rᵀu:

    ∂H/∂u = 0:  2 M W τ = −r            p' = −∂H/∂q = −2 (∂τ/∂q)ᵀ W τ         r' = −∂H/∂v = −2 (∂τ/∂v)ᵀ W τ − 2 λ v − p

The first gives τ = −½ W⁻¹M⁻¹r (W = 1 here), inverse dynamics solved for u close the system, and J rides along as one more
state. Guesses come from a Ritz method, q = cubic + s²(1 − s)² Σ c_k P_k(2s − 1) with Legendre polynomials P_k, minimised over c.
The dynamics are written here in closed form: nothing of energyopt is used.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import minimize

GRAVITY = 9.81
TERMS = 10
"""Polynomials of the Ritz method."""


@dataclass(frozen=True)
class Extremal:
    """A solution: J, accelerations at both ends (n,), and q(t)."""

    cost: float
    first: np.ndarray
    last: np.ndarray
    position: object


def pendulum_torque(mass, length):
    """τ = m l² u + m g l cos q."""
    return lambda q, v, u: mass * length**2 * u + mass * GRAVITY * length * ca.cos(q)


def two_link_torque(lengths, masses):
    """Thin rods in a vertical plane (M. W. Spong and others, "Robot Modeling and Control", 2006, sec. 7.4)."""
    (l1, l2), (m1, m2) = lengths, masses
    c1, c2, i1, i2 = l1 / 2, l2 / 2, m1 * l1**2 / 12, m2 * l2**2 / 12

    def torque(q, v, u):
        c, h = ca.cos(q[1]), -m2 * l1 * c2 * ca.sin(q[1])
        m11 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * c) + i1 + i2
        m12, m22 = m2 * (c2**2 + l1 * c2 * c) + i2, m2 * c2**2 + i2
        g2 = m2 * c2 * GRAVITY * ca.cos(q[0] + q[1])
        g1 = (m1 * c1 + m2 * l1) * GRAVITY * ca.cos(q[0]) + g2
        first = m11 * u[0] + m12 * u[1] + 2 * h * v[0] * v[1] + h * v[1] ** 2 + g1
        return ca.vertcat(first, m12 * u[0] + m22 * u[1] - h * v[0] ** 2 + g2)

    return torque


def extremals(torque, start, goal, duration, weight, bends, tolerance=1e-7):
    """All distinct solutions found from rest to rest, one search for every guess; cheapest first.

    Args:
        torque: (q, v, u) → τ as CasADi expressions.
        start, goal: [rad], shape (n,); duration [s]; weight: λ.
        bends: how far [rad] the Ritz method's first motions are bent away from the cubic, shape (guesses, n).
    """
    field, jacobian, control, costate = _functions(torque, len(start), weight)
    descend, found = _ritz(torque, start, goal, duration, weight), []
    for bend in bends:
        t = np.linspace(0.0, duration, 161)
        q, v, u = descend(bend, t)
        y = np.concatenate([q, v, *costate(q, v, u, t), np.zeros((1, t.size))])
        for tol in (1e-5, tolerance):
            solution = solve_bvp(
                lambda t, y: np.array(field(y)), _ends(start, goal), t, y,
                fun_jac=lambda t, y: np.array(jacobian(y)).reshape(len(y), t.size, len(y)).transpose(0, 2, 1),
                tol=tol, max_nodes=6000,
            )  # fmt: skip
            t, y = solution.x, solution.y
        cost = solution.y[-1, -1]
        if solution.success and not any(abs(cost / other.cost - 1) < 1e-7 for other in found):
            ends = np.array(control(solution.y[:, [0, -1]]))
            found.append(Extremal(cost, ends[:, 0], ends[:, 1], _position(solution, len(start))))
    return sorted(found, key=lambda e: e.cost)


def _position(solution, n):
    return lambda t: solution.sol(t)[:n].T


def _functions(torque, n, weight):
    """y' = f(y), its Jacobian, and u(y), for many y at once; the costates of a motion."""
    q, v, p, r, J, u = (ca.SX.sym(name, size) for name, size in zip("qvprJu", (n, n, n, n, 1, n), strict=True))
    y, tau = ca.vertcat(q, v, p, r, J), torque(q, v, u)
    M = ca.jacobian(tau, u)
    at_rest = ca.substitute(tau, u, ca.SX.zeros(n))
    tau_star = -0.5 * ca.solve(M, r)
    u_star = ca.solve(M, tau_star - at_rest)
    force = ca.SX.sym("force", n)
    pull = [ca.substitute(ca.substitute(ca.jtimes(tau, x, force, True), u, u_star), force, 2 * tau_star) for x in (q, v)]
    rate = ca.vertcat(v, u_star, -pull[0], -pull[1] - 2 * weight * v - p, ca.dot(tau_star, tau_star) + weight * ca.dot(v, v))
    make = lambda name, value: _columns(ca.Function(name, [y], [ca.densify(value)]))
    free = ca.SX.sym("tau", n)
    momentum = ca.Function("r", [q, v, u], [-2 * M @ tau])
    drag = ca.Function("drag", [q, v, u], [ca.substitute(ca.jtimes(tau, v, free, True), free, 2 * tau) + 2 * weight * v])

    def costate(q, v, u, t):
        """Of a motion that is not optimal: r from ∂H/∂u = 0, p from r' = −∂H/∂v."""
        r = np.array(momentum.map(t.size)(q, v, u))
        return -np.gradient(r, t, axis=1) - np.array(drag.map(t.size)(q, v, u)), r

    return make("f", rate), make("df", ca.jacobian(rate, y)), make("u", u_star), costate


def _columns(function):
    return lambda y: function.map(y.shape[1])(y)


def _ends(start, goal):
    n = len(start)
    return lambda a, b: np.concatenate([a[:n] - start, a[n : 2 * n], b[:n] - goal, b[n : 2 * n], a[-1:]])


def _ritz(torque, start, goal, duration, weight):
    """A function (bend, t) → q, v, u (n, N): a local minimum among the motions of the Ritz method, first bent by ``bend``."""
    n, s = len(start), np.polynomial.Polynomial([0.0, 1.0])
    straight = 3 * s**2 - 2 * s**3
    bumps = [16 * s**2 * (1 - s) ** 2 * np.polynomial.Legendre.basis(k)(2 * s - 1) for k in range(TERMS)]

    def motion(c, t):
        """c has shape (TERMS, n), numbers or a CasADi expression."""
        states = []
        for order in range(3):
            value = lambda p, order=order: (p.deriv(order) if order else p)(t / duration) / duration**order
            fixed = np.outer(value(straight), np.asarray(goal) - start) + (order == 0) * np.asarray(start)
            states.append((fixed + np.stack([value(p) for p in bumps], axis=1) @ c).T)
        return states

    x, w = np.polynomial.legendre.leggauss(40)
    times, w = 0.5 * duration * (x + 1), 0.5 * duration * w
    q, v, u = (ca.SX.sym(name, n) for name in "qvu")
    tau = torque(q, v, u)
    rate = ca.Function("rate", [q, v, u], [ca.dot(tau, tau) + weight * ca.dot(v, v)]).map(times.size)
    c = ca.MX.sym("c", TERMS * n)
    J = ca.dot(ca.DM(w).T, rate(*_matrix_motion(motion, c, times, n)))
    both = ca.Function("both", [c], [J, ca.gradient(J, c)])

    def descend(bend, t):
        first = np.zeros((TERMS, n))
        first[0] = bend
        value = lambda c: (float((r := both(c))[0]), np.array(r[1]).ravel())
        best = minimize(value, first.ravel(), jac=True, method="BFGS", options={"gtol": 1e-6, "maxiter": 2000})
        return motion(best.x.reshape(TERMS, n), t)

    return descend


def _matrix_motion(motion, c, times, n):
    """q, v, u (n, N) as expressions in the vector c (row-major): the motion is affine in it."""
    fixed, size = motion(np.zeros((TERMS, n)), times), TERMS * n
    slopes = [motion(e.reshape(TERMS, n), times) for e in np.eye(size)]
    for order in range(3):
        columns = np.stack([(s[order] - fixed[order]).ravel(order="F") for s in slopes], axis=1)
        yield ca.reshape(ca.DM(columns) @ c, n, times.size) + ca.DM(fixed[order])
