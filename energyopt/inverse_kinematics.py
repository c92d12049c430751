"""Configurations that bring a frame where it should be: damped least squares from many starts.

Δq = Jᵀ (J Jᵀ + ε I)⁻¹ e,   e the pose error in the frame (S. R. Buss, "Introduction to inverse kinematics with Jacobian
transpose, pseudoinverse and damped least squares methods", 2004), clipped to the position limits after each step.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from energyopt.errors import ProblemError
from energyopt.impossible import called, impossible
from energyopt.problem import FramePose, Problem

TOLERANCE = 1e-8
"""Pose error [m and rad] at which a configuration counts as found; the optimiser polishes it further."""


def goal_configurations(problem: Problem, seed: int = 0, count: int = 4, tries: int = 60) -> list[np.ndarray]:
    """Configurations inside the position limits whose frame is at the problem's `FramePose`, nearest to the start first.

    Nearness is the kinematic time the slowest joint needs from the start. The first search starts from the start itself.

    Raises:
        ProblemError: none was found, which proves nothing; the message gives the least error reached.
    """
    rng, limits = np.random.default_rng(seed), problem.limits
    low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    low, high = np.minimum(low, high), np.maximum(low, high)
    found, best = [], np.full(3, np.inf)
    for k in range(tries):
        q = problem.start if k == 0 else rng.uniform(low, high)
        q, error = _search(problem, problem.goal, np.clip(q, limits.lower, limits.upper))
        best = min(best, error, key=np.linalg.norm)
        if np.linalg.norm(error) < TOLERANCE and all(np.abs(q - other).max() > 1e-2 for other in found):
            found.append(q)
        if len(found) >= 3 * count:
            break
    if not found:
        raise _not_found(problem, best, tries)
    time = lambda q: np.max(np.abs(q - problem.start) / problem.limits.velocity)
    return sorted(found, key=time)[:count]


def _not_found(problem: Problem, error: np.ndarray, tries: int) -> ProblemError:
    goal, free = problem.goal, problem.goal.rotation is None
    missed = f"{np.linalg.norm(error[:3]):.3g} m" + ("" if free else f" and {np.linalg.norm(error[3:]):.3g} rad")
    words = f"no configuration was found that brings frame '{goal.frame}' there inside the position limits"
    remedy = f"move the goal, {'' if free else 'free its orientation, '}or widen {called(problem, 'position_limits')}"
    return impossible(problem, "goal", f"{words}: the nearest of {tries} searches is off by {missed}; {remedy}")


def _search(problem: Problem, goal: FramePose, q: np.ndarray, steps: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """The configuration a search from ``q`` ends in, and its pose error."""
    model, limits = problem.robot.model, problem.limits
    data, frame, damping = model.createData(), problem.robot.frame_id(goal.frame), 1e-2
    error, jacobian = _pose_error(model, data, frame, goal, q)
    for _ in range(steps):
        if np.linalg.norm(error) < 1e-10:
            break
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping**2 * np.eye(len(error)), error)
        candidate = np.clip(q + np.clip(step, -0.5, 0.5), limits.lower, limits.upper)
        new_error, new_jacobian = _pose_error(model, data, frame, goal, candidate)
        if np.linalg.norm(new_error) < np.linalg.norm(error):
            q, error, jacobian, damping = candidate, new_error, new_jacobian, max(damping * 0.3, 1e-7)
        else:
            damping *= 4.0
            if damping > 1e3:
                break
    return q, error


def _pose_error(model: pin.Model, data: pin.Data, frame: int, goal: FramePose, q: np.ndarray):
    """Error [m, rad] in base axes, and its Jacobian with the sign of a step that reduces it."""
    J = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    placement = data.oMf[frame]
    error = goal.position - placement.translation
    if goal.rotation is None:
        return error, J[:3]
    turn = pin.log3(goal.rotation @ placement.rotation.T)
    return np.concatenate([error, turn]), J
