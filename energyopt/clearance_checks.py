"""The clearance of a motion and of its ends, as a problem asks for it: exact geometry, for all times.

The arm is judged by `clearance.check_clearance`. Where a workspace binds only some frames, the height of a frame's origin
above a wall, n·p(q(t)) − b, is taken at dense samples, the least of them refined by a parabola through its neighbours.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from energyopt.avoidance import arm_obstacles, bound_frames, checked_pairs
from energyopt.clearance import TOLERANCE, Clearance, check_clearance, scene_of, touching
from energyopt.geometry.exact import CollisionScene, obstacle_names
from energyopt.geometry.kinematics import joint_placements
from energyopt.impossible import impossible
from energyopt.limit_checks import Finding
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem

PER_SPAN = 20
DIGITS = 8
"""Decimal places of distances [m] that plans are made with. The library's iteration begins where it ended the last time, so that
the last digits depend on what was asked before; a plan should not."""
BETWEEN = "–"
MOUNTING = 0.01
"""Depth [m] to which an obstacle may reach into links that never move: the table an arm stands on touches its base."""
BASE_TIMES = 41
"""Instants at which a moving obstacle is looked at beside those links."""


@lru_cache(maxsize=16)
def motion_clearance(problem: Problem, trajectory: Trajectory) -> Clearance | None:
    """The verdict of the exact check of the arm; None where there is nothing to keep apart."""
    robot, obstacles, pairs, attached = problem.robot, arm_obstacles(problem), checked_pairs(problem), problem.attached
    if problem.clearance == 0.0:
        verdicts = [check_clearance(robot, trajectory, obstacles, pairs, attached)]
    else:  # links of the arm only must not touch
        verdicts = [
            check_clearance(robot, trajectory, obstacles, (), attached, problem.clearance),
            check_clearance(robot, trajectory, (), pairs, attached),
        ]
    return _worst([verdict for verdict in verdicts if verdict.first])


def _worst(verdicts: list[Clearance]) -> Clearance | None:
    """The one that fails, or comes nearest to its margin, with the violations of all."""
    if not verdicts:
        return None
    worst = min(verdicts, key=lambda v: (v.passes, v.distance - v.margin))
    return replace(worst, violations=tuple(instant for verdict in verdicts for instant in verdict.violations))


def exact_distances(problem: Problem, trajectory: Trajectory, t: np.ndarray, names: tuple[str, str]) -> np.ndarray:
    """Exact distance [m] of two links, or a link and an obstacle, at times ``t`` (N,), to `DIGITS`; shape (N,)."""
    scene = scene_of(problem.robot, arm_obstacles(problem), checked_pairs(problem), problem.attached)
    own = [k for k, pair in enumerate(scene.pairs) if pair == names]
    q = trajectory(t)
    return np.round([scene.exact(q[k], t[k], np.array(own)).min() for k in range(len(t))], DIGITS)


def clearance_of(problem: Problem, trajectory: Trajectory) -> tuple[Finding, float] | None:
    """The finding and the least distance [m] over arm and frames; None where there is nothing to keep apart."""
    verdicts = []
    if np.isfinite(trajectory(trajectory.breaks)).all():
        arm = motion_clearance(problem, trajectory)
        if arm is not None:
            # Where nothing was seen but something could not be excluded, the motion is not proved clear.
            missing = 0.0 if arm.passes else max(arm.margin - arm.distance, TOLERANCE)
            verdicts.append((missing, arm.distance, f"{arm.first}{BETWEEN}{arm.second}", arm.time))
        verdicts += _frame_verdicts(problem, trajectory)
    if not verdicts:
        return None
    missing, _, pair, time = max(verdicts, key=lambda v: (v[0], -v[1]))
    return Finding("clearance", missing, joint=pair, time=time), min(v[1] for v in verdicts)


def check_ends(problem: Problem, goal: np.ndarray | None) -> None:
    """Refuse a problem whose start, goal or waypoints touch something, or come closer than the clearance, or in which an obstacle
    is where the arm's base is. Beside a waypoint without a time only what does not move counts.

    Args:
        goal: joint positions of the goal, where they are known.

    Raises:
        ProblemError: names the pair, the distance or depth, and the remedy.
    """
    _check_base(problem)
    stations = [("start", problem.start, 0.0)]
    stations += [(f"waypoints[{k}]", w.position, w.time) for k, w in enumerate(problem.waypoints)]
    if goal is not None:
        stations.append(("goal", goal, problem.duration))
    for where, q, t in stations:
        _check_station(problem, where, q, t)


def _check_base(problem: Problem) -> None:
    robot, obstacles = problem.robot, problem.obstacles
    if not obstacles:
        return
    scene = CollisionScene(robot, obstacles, (), problem.attached, fixed=True)
    if not scene.pairs:
        return
    times = np.linspace(0.0, problem.duration, BASE_TIMES if any(shape.moves for shape in obstacles) else 1)
    distance = scene.distances(np.tile(robot.home, (len(times), 1)), times, cutoff=0.0)
    row, pair = np.unravel_index(np.argmin(distance), distance.shape)
    if distance[row, pair] < -MOUNTING:
        link, name = scene.pairs[pair]
        k = obstacle_names(obstacles).index(name)
        when = f" at {times[row]:.3g} s" if obstacles[k].moves else ""
        said = f"'{name}' is {-1e3 * distance[row, pair]:.1f} mm inside '{link}'{when}, a link that never moves"
        remedy = f"move it (what the arm stands on may reach {1e3 * MOUNTING:g} mm into its base)"
        raise impossible(problem, f"obstacles[{k}]", f"{said}; {remedy}")


def _check_station(problem: Problem, where: str, q: np.ndarray, t: float | None) -> None:
    pairs, obstacles = checked_pairs(problem), arm_obstacles(problem)
    if t is None:
        t, obstacles = 0.0, tuple(obstacle for obstacle in obstacles if not obstacle.moves)
    near = touching(problem.robot, q, (), pairs, problem.attached, t, TOLERANCE)
    near += touching(problem.robot, q, obstacles, (), problem.attached, t, max(problem.clearance, TOLERANCE))
    if near:
        worst = min(near, key=lambda pair: pair.distance)
        _refuse(problem, where, worst.first, worst.second, worst.distance, (worst.first, worst.second) in pairs)
    for frame, wall in bound_frames(problem):
        height = float(_heights(problem, frame, wall, q[None])[0])
        if height < problem.clearance:
            _refuse(problem, where, frame, obstacle_names([wall])[0], height, False)


def _refuse(problem: Problem, where: str, first: str, second: str, distance: float, own: bool) -> None:
    if distance > TOLERANCE:
        said = f"'{first}' is {1e3 * distance:.1f} mm from '{second}'; clearance asks for {1e3 * problem.clearance:.1f} mm"
        raise impossible(problem, where, f"{said}; choose another {where}, or a clearance of at most {distance:.4f}")
    depth = "touches" if distance > -TOLERANCE else f"is {-1e3 * distance:.1f} mm inside"
    remedy = f"choose another {where}" + (" (or self_collision=False)" if own else f", or move '{second}'")
    raise impossible(problem, where, f"'{first}' {depth} '{second}'; {remedy}")


def _frame_verdicts(problem: Problem, trajectory: Trajectory) -> list[tuple[float, float, str, float]]:
    found = []
    for frame, wall in bound_frames(problem):
        t = trajectory.sample_times(PER_SPAN)
        height = _heights(problem, frame, wall, trajectory(t))
        k = int(np.argmin(height))
        near = np.linspace(t[max(k - 1, 0)], t[min(k + 1, len(t) - 1)], 201)
        fine = _heights(problem, frame, wall, trajectory(near))
        j = int(np.argmin(fine))
        missing = max(problem.clearance - float(fine[j]), 0.0)
        found.append((missing, float(fine[j]), f"{frame}{BETWEEN}{obstacle_names([wall])[0]}", float(near[j])))
    return found


def _heights(problem: Problem, name: str, wall, q: np.ndarray) -> np.ndarray:
    frame = problem.robot.model.frames[problem.robot.frame_id(name)]
    rotation, position = joint_placements(problem.robot.model, q)
    joint = frame.parentJoint
    return wall.distance(position[:, joint] + rotation[:, joint] @ frame.placement.translation)
