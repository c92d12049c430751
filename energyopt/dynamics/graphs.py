"""The four graphs evaluated at every sample of a motion, as functions of its state z = (q, q̇, q̈) and of the arm's numbers θ.

    torque     z, θ            → τ
    adjoint    z, p, μ, θ      → τ, g = Jᵀ u                            u = p∘τ + μ,  J = ∂τ/∂z
    jacobian   z, θ            → τ, J
    hessian    z, p, μ, θ      → J, S = ∂²(uᵀτ)/∂z² with u held fixed   (lower triangle)

With p = 2 w W (quadrature weight, torque weights) and μ the multipliers of the torque rows, g is the gradient and
S + Jᵀ diag(p) J the exact Hessian of the sample's share in the Lagrangian, w Σ Wᵢτᵢ² + μᵀτ.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from energyopt.dynamics.parameters import Structure
from energyopt.dynamics.symbolic import parametric_torque


@dataclass(frozen=True, eq=False)
class SampleGraphs:
    """CasADi SX functions with dense inputs and outputs; see the module docstring.

    ``lower`` lists the (row, column) of the entries of S that the `hessian` graph gives, in their order.
    """

    torque: ca.Function
    adjoint: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    lower: np.ndarray

    @property
    def all(self) -> tuple[ca.Function, ...]:
        return self.torque, self.adjoint, self.jacobian, self.hessian


def sample_graphs(structure: Structure) -> SampleGraphs:
    """Differentiate the inverse dynamics of the arms of a structure into their `SampleGraphs`."""
    nv, theta = structure.nv, ca.SX.sym("theta", structure.size)
    z, p, mu, fixed = ca.SX.sym("z", 3 * nv), ca.SX.sym("p", nv), ca.SX.sym("mu", nv), ca.SX.sym("u", nv)
    tau = parametric_torque(structure)(z[:nv], z[nv : 2 * nv], z[2 * nv :], theta)
    gradient = ca.gradient(ca.dot(fixed, tau), z)
    curvature = ca.tril(ca.hessian(ca.dot(fixed, tau), z)[0])
    jacobian = ca.jacobian(tau, z)
    rows, columns = (np.array(index, dtype=int) for index in curvature.sparsity().get_triplet())
    adjoint, curvature = ca.substitute([gradient, ca.vertcat(*curvature.nonzeros())], [fixed], [p * tau + mu])
    dense, few, all_of = ca.densify, ["z", "theta"], ["z", "p", "mu", "theta"]
    return SampleGraphs(
        torque=ca.Function("torque", [z, theta], [tau], few, ["tau"]),
        adjoint=ca.Function("adjoint", [z, p, mu, theta], [tau, dense(adjoint)], all_of, ["tau", "g"]),
        jacobian=ca.Function("jacobian", [z, theta], [tau, dense(jacobian)], few, ["tau", "J"]),
        hessian=ca.Function("hessian", [z, p, mu, theta], [dense(jacobian), dense(curvature)], all_of, ["J", "S"]),
        lower=np.stack([rows, columns], axis=1),
    )
