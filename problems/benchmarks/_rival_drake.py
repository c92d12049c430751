"""Drake's kinematic trajectory optimisation: a B-spline whose control points keep the limits on position and velocity for all t,
torque limits at nodes, and the cost Σ wτ² + λ q̇², which Drake does not have, by Gauss quadrature of its MultibodyPlant's inverse
dynamics: derivatives by its automatic differentiation with respect to (q, q̇, q̈) at a node, the rest by constant matrices. SNOPT.

`DirectCollocation` was tried first: with 16 nodes it took 15 s on a Panda and cheated: eight times the velocity
limit between nodes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
from _rival import Attempt, Rival, timed
from scipy.interpolate import BSpline

from energyopt import Problem, baseline
from energyopt.parameterizations.trajectory import SplineTrajectory, gauss_on_spans

CONTROL_POINTS = 14
DEGREE = 3
SECONDS = 60.0
"""Wall time after which SNOPT is stopped."""


class Kinematic(Rival):
    says = f"Drake, KinematicTrajectoryOptimization, {CONTROL_POINTS} control points, torques by its MultibodyPlant, SNOPT"
    requires = ("pydrake",)

    def prepare(self, robot):
        self._plant = _plant(robot)
        self._differentiable = self._plant.ToAutoDiffXd()

    def solve(self, problem):
        from pydrake.solvers import SnoptSolver, SolverOptions

        made, build = timed(lambda: _program(problem, self._plant, self._differentiable))
        options = SolverOptions()
        options.SetOption(SnoptSolver.id(), "Time limit", SECONDS)
        options.SetOption(SnoptSolver.id(), "Major optimality tolerance", 1e-4)
        options.SetOption(SnoptSolver.id(), "Major iterations limit", 1000)
        result, seconds = timed(lambda: SnoptSolver().Solve(made.prog(), None, options))
        points = result.GetSolution(made.control_points()).T
        motion = SplineTrajectory(np.array(made.basis().knots()) * problem.duration, points, DEGREE)
        return Attempt(motion, result.is_success(), 0, seconds, build)


def _plant(robot):
    """The robot's own URDF without its looks, with a motor at every joint."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    root = ET.fromstring(robot.urdf)
    for element in root:
        for name in ("visual", "collision", "dynamics", "safety_controller", "mimic"):
            for part in element.findall(name):
                element.remove(part)
    for name in ("transmission", "gazebo"):
        for part in root.findall(name):
            root.remove(part)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(ET.tostring(root, encoding="unicode"), "urdf")
    if _base(root) != "world":
        plant.WeldFrames(plant.world_frame(), plant.GetBodyByName(_base(root)).body_frame())
    for name in robot.joint_names:
        plant.AddJointActuator(name, plant.GetJointByName(name))
    plant.Finalize()
    return plant


def _base(root: ET.Element) -> str:
    """The link that is nobody's child."""
    children = {joint.find("child").get("link") for joint in root.findall("joint")}
    return next(link.get("name") for link in root.findall("link") if link.get("name") not in children)


def _program(problem: Problem, plant, differentiable):
    from pydrake.planning import KinematicTrajectoryOptimization

    nv, limits, duration, rest = problem.robot.nv, problem.limits, problem.duration, np.zeros(problem.robot.nv)
    made = KinematicTrajectoryOptimization(nv, CONTROL_POINTS, DEGREE + 1, duration)
    made.AddDurationConstraint(duration, duration)
    made.AddPositionBounds(limits.lower, limits.upper)
    made.AddVelocityBounds(-limits.velocity, limits.velocity)
    for s, position in ((0.0, problem.start), (1.0, problem.goal_position)):
        made.AddPathPositionConstraint(position, position, s)
        made.AddPathVelocityConstraint(rest, rest, s)
    made.AddEffortBoundsAtNormalizedTimes(plant, np.linspace(0.0, 1.0, CONTROL_POINTS), -limits.torque, limits.torque)
    points = made.control_points()
    made.prog().AddCost(_cost(problem, np.array(made.basis().knots()) * duration, differentiable), vars=points.T.ravel())
    quintic = baseline(problem, "quintic")
    knots = np.array(made.basis().knots()) * duration
    greville = np.array([knots[k + 1 : k + DEGREE + 1].mean() for k in range(CONTROL_POINTS)])
    made.prog().SetInitialGuess(points, quintic(greville).T)
    made.prog().SetInitialGuess(made.duration(), duration)
    return made


def _cost(problem: Problem, knots: np.ndarray, plant):
    """J of the control points (points · joints, one point after the other), as Drake calls costs: on floats or AutoDiffXd."""
    from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
    from pydrake.multibody.tree import MultibodyForces_

    context, nv = plant.CreateDefaultContext(), problem.robot.nv
    t, weights = gauss_on_spans(np.unique(knots), 3)
    whole = BSpline(knots, np.eye(CONTROL_POINTS), DEGREE)
    basis = np.stack([whole.derivative(k)(t) if k else whole(t) for k in range(3)])

    def at_node(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """τ and ∂τ/∂(q, v, a)."""
        seeded = InitializeAutoDiff(z).ravel()
        plant.SetPositions(context, seeded[:nv])
        plant.SetVelocities(context, seeded[nv : 2 * nv])
        forces = MultibodyForces_[AutoDiffXd](plant)
        plant.CalcForceElementsContribution(context, forces)
        tau = plant.CalcInverseDynamics(context, seeded[2 * nv :], forces)
        return ExtractValue(tau).ravel(), ExtractGradient(tau)

    def value(x):
        plain = x.dtype == float
        points = (x if plain else ExtractValue(x)).reshape(CONTROL_POINTS, nv)
        states = np.concatenate(basis @ points, axis=1)
        total, slope = 0.0, np.zeros_like(points)
        for k, (z, weight) in enumerate(zip(states, weights, strict=True)):
            tau, jacobian = at_node(z)
            v = z[nv : 2 * nv]
            total += weight * (problem.torque_weights @ tau**2 + problem.velocity_weight @ v**2)
            row = 2.0 * weight * (problem.torque_weights * tau) @ jacobian
            row[nv : 2 * nv] += 2.0 * weight * problem.velocity_weight * v
            slope += np.einsum("ob,oj->bj", basis[:, k], row.reshape(3, nv))
        return total if plain else AutoDiffXd(total, slope.ravel() @ ExtractGradient(x))

    return value
