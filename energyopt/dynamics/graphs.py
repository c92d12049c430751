"""The four graphs evaluated at every sample of a motion, as functions of its state z = (q, q̇, q̈).

    torque     z               → τ
    adjoint    z, p, μ         → τ, g = Jᵀ u                            u = p∘τ + μ,  J = ∂τ/∂z
    jacobian   z               → τ, J
    hessian    z, p, μ         → J, S = ∂²(uᵀτ)/∂z² with u held fixed   (lower triangle)

With p = 2 w W (quadrature weight, torque weights) and μ the multipliers of the torque rows, g is the gradient and
S + Jᵀ diag(p) J the exact Hessian of the sample's share in the Lagrangian, w Σ Wᵢτᵢ² + μᵀτ.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from energyopt.dynamics.body import Dynamics
from energyopt.dynamics.symbolic import inverse_dynamics


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


def sample_graphs(dynamics: Dynamics) -> SampleGraphs:
    """Differentiate the inverse dynamics of an arm into its `SampleGraphs`."""
    nv = dynamics.nv
    z, p, mu, fixed = ca.SX.sym("z", 3 * nv), ca.SX.sym("p", nv), ca.SX.sym("mu", nv), ca.SX.sym("u", nv)
    tau = inverse_dynamics(dynamics)(z[:nv], z[nv : 2 * nv], z[2 * nv :])
    gradient = ca.gradient(ca.dot(fixed, tau), z)
    curvature = ca.tril(ca.hessian(ca.dot(fixed, tau), z)[0])
    jacobian = ca.jacobian(tau, z)
    rows, columns = (np.array(index, dtype=int) for index in curvature.sparsity().get_triplet())
    adjoint, curvature = ca.substitute([gradient, ca.vertcat(*curvature.nonzeros())], [fixed], [p * tau + mu])
    dense = ca.densify
    return SampleGraphs(
        torque=ca.Function("torque", [z], [tau]),
        adjoint=ca.Function("adjoint", [z, p, mu], [tau, dense(adjoint)]),
        jacobian=ca.Function("jacobian", [z], [tau, dense(jacobian)]),
        hessian=ca.Function("hessian", [z, p, mu], [dense(jacobian), dense(curvature)]),
        lower=np.stack([rows, columns], axis=1),
    )
