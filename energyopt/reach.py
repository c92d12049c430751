"""How far a frame can be from the first joint that moves it: no farther than the lengths of the links between them add up to.

With o_k the origin of joint k in the axes of the joint before, the frame is at p₁ + Σ R_k o_k + R o_frame, so that

    ‖p − p₁‖ ≤ Σ_{k>1} ‖o_k‖ + ‖o_frame‖ + Σ_{sliding} max(|lower|, |upper|).

A goal beyond is impossible; within, the bound says nothing, and only a search can find a configuration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.dynamics.body import joint_axis
from energyopt.impossible import impossible
from energyopt.problem import Problem

MILLIMETRE = 1e-3
MANY_METRES = 20.0
"""Distances [m] beyond this are rare enough for a hint that they might be millimetres."""


@dataclass(frozen=True, eq=False)
class Reach:
    """The ball that a frame cannot leave.

    Attributes:
        joint: the first joint that moves the frame, "" where none does.
        center: its origin in the robot's base [m], shape (3,); the frame's own place where nothing moves it.
        radius: [m].
    """

    joint: str
    center: np.ndarray
    radius: float


def reach(problem: Problem, frame: str) -> Reach:
    """The ball around the first joint that holds a frame, whatever the configuration."""
    robot, limits = problem.robot, problem.limits
    model, index = robot.model, robot.frame_id(frame)
    last = model.frames[index].parentJoint
    chain = [k for k in model.supports[last] if k > 0]
    place = model.frames[index].placement.translation
    if not chain:
        return Reach("", np.array(place), 0.0)
    radius = np.linalg.norm(place) + sum(np.linalg.norm(model.jointPlacements[k].translation) for k in chain[1:])
    slides = [k - 1 for k in chain if joint_axis(model, k)[0] == "prismatic"]
    radius += sum(max(abs(limits.lower[i]), abs(limits.upper[i])) for i in slides)
    return Reach(model.names[chain[0]], np.array(model.jointPlacements[chain[0]].translation), float(radius))


def check_reach(problem: Problem) -> None:
    """Raise where the Cartesian goal of a problem is out of the arm's reach.

    Raises:
        ProblemError: how far it is, and how far the arm reaches.
    """
    goal, ball = problem.goal, reach(problem, problem.goal.frame)
    if not ball.joint:
        words = f"frame '{goal.frame}' stands still whatever the joints do"
        raise impossible(problem, "goal", f"{words}; choose a frame of a moving link, such as '{problem.robot.tool_frame}'")
    away = np.linalg.norm(goal.position - ball.center)
    if away > ball.radius * (1 + 1e-9):
        small = np.linalg.norm(MILLIMETRE * goal.position - ball.center) <= ball.radius
        hint = "looks like millimetres, expected metres" if small and away > MANY_METRES else "move it nearer"
        reason = f"frame '{goal.frame}' stays within {ball.radius:.4g} m of joint '{ball.joint}', so long are its links"
        raise impossible(problem, "goal", f"out of reach: {reason}; the goal is {away:.4g} m away; {hint}")
