"""Judges motions for `mbm` without any of energyopt's own checks: the robot's URDF file, Pinocchio, coal, and a grid of times.

At N = 2000 even times q, q̇ and q̈ of the motion are compared with the limits in the robot's file, the steps (q_{k+1} − q_k)/h with
the velocity limit as well, and τ = rnea(q, q̇, q̈) with the torque limits. Distances are those of coal between the collision meshes
and the obstacles, and between links (see `_mbm_robot`).

Not every pair is asked at every time. A point at most r from a centre p fixed to body b moves in the frame of body a from one
time to the next by at most |Δp| + r ‖ΔR‖, so distances d_i, d_j at the ends of an interval bound those inside it from below by
½ (d_i + d_j − path), path being the sum of these steps. Intervals are bisected, the least bound first, until no bound is below
the least distance found: that is the minimum over all N times, exactly, where nothing touches. Where something does, that is
found as surely; how deep is then only what was seen first.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from _mbm_robot import Body, RobotJudge, body_of, distance

from energyopt.parameterizations.trajectory import Trajectory

TIMES = 2000
SLACK = {"position": 1e-6, "velocity": 1e-6, "start": 1e-6, "goal": 1e-6, "rest": 1e-6, "duration": 1e-9}
"""Excess that is forgiven [rad, rad/s, s]."""
TORQUE_SLACK = 1e-4
"""The same as a share of the torque limit."""


class Closest(NamedTuple):
    """Least distance [m], 0 or less where the two touch, of which pair, at which row of the grid."""

    distance: float
    first: str
    second: str
    row: int


@dataclass(frozen=True)
class Verdict:
    """What was found of one motion.

    Attributes:
        faults: what is wrong, in words; empty where the motion is valid.
        clearance: least distance [m]; pair: of which two; time: when [s].
        torque_squared: ∫Στ² dt [N²m²s]; energy: Σ∫|τ q̇| dt [J].
        torque_share: largest |τ| over its limit; velocity_share: the same of velocities.
    """

    faults: tuple[str, ...]
    clearance: float
    pair: tuple[str, str]
    time: float
    torque_squared: float
    energy: float
    torque_share: float
    velocity_share: float

    @property
    def valid(self) -> bool:
        return not self.faults


class ProblemJudge:
    """One problem's obstacles around a `RobotJudge`."""

    def __init__(self, robot: RobotJudge, entry: Mapping[str, Any]):
        """``entry``: the problem as its file has it."""
        self.robot, base = robot, robot.frame(entry["frame"])
        self.start, self.goal = (np.array(entry[key], float) for key in ("q_start", "q_goal"))
        self.obstacles = [body_of(_shape(o), o["name"]) for o in entry["obstacles"]]
        self.places = [base @ _pose(o) for o in entry["obstacles"]]

    def faults_of_ends(self) -> list[str]:
        """Why start or goal are invalid, whatever the motion between them is."""
        robot, found = self.robot, []
        for where, q in (("start", self.start), ("goal", self.goal)):
            outside = max(np.max(q - robot.upper), np.max(robot.lower - q))
            if outside > SLACK["position"]:
                found.append(f"{where}: {outside:.3g} rad outside the position limits")
            held = np.max(np.abs(robot.torques(q[None], *np.zeros((2, 1, len(q)))))[0] / robot.torque)
            if held > 1 + TORQUE_SLACK:
                found.append(f"{where}: holding it takes {held:.2f} of a torque limit")
            nearest = self.closest(q[None])
            if nearest.distance <= 0:
                found.append(f"{where}: {nearest.first} touches {nearest.second}")
        return found

    def judge(self, motion: Trajectory, order: list[int], duration: float) -> Verdict:
        """Judge a motion whose joint k is joint ``order[k]`` of the problem, and which should take ``duration`` [s]."""
        robot, t = self.robot, np.linspace(0.0, motion.duration, TIMES)
        q, v, a = (_reordered(motion(t, k), order) for k in range(3))
        if not all(np.all(np.isfinite(x)) for x in (q, v, a)):
            return Verdict(("not finite",), -np.inf, ("", ""), 0.0, np.inf, np.inf, np.inf, np.inf)
        tau, speed = robot.torques(q, v, a), np.abs(np.diff(q, axis=0)) / t[1]
        nearest = self.closest(q)
        excess = {
            "position": max(np.max(q - robot.upper), np.max(robot.lower - q)),
            "velocity": max(np.max(np.abs(v) - robot.velocity), np.max(speed - robot.velocity)),
            "start": np.max(np.abs(q[0] - self.start)),
            "goal": np.max(np.abs(q[-1] - self.goal)),
            "rest": np.max(np.abs(v[[0, -1]])),
            "duration": abs(motion.duration - duration),
        }
        faults = [f"{name} by {amount:.3g}" for name, amount in excess.items() if not amount <= SLACK[name]]
        share = float(np.max(np.abs(tau) / robot.torque))
        faults += [f"torque {share:.4f} of its limit"] if not share <= 1 + TORQUE_SLACK else []
        if not nearest.distance > 0:
            faults.append(f"{nearest.first} touches {nearest.second} ({1e3 * nearest.distance:.2f} mm) at {t[nearest.row]:.3f} s")
        return Verdict(
            faults=tuple(faults),
            clearance=nearest.distance,
            pair=(nearest.first, nearest.second),
            time=float(t[nearest.row]),
            torque_squared=float(np.trapezoid(np.sum(tau**2, axis=1), t)),
            energy=float(np.trapezoid(np.sum(np.abs(tau * v), axis=1), t)),
            torque_share=share,
            velocity_share=float(np.max(np.abs(v) / robot.velocity)),
        )

    def closest(self, q: np.ndarray) -> Closest:
        """The least distance over the rows of ``q`` (N, n)."""
        place = self.robot.placements(q)
        pairs, known, order, heap = self._pairs(place), {}, count(), []

        def apart(p: int, row: int) -> float:
            if (p, row) not in known:
                (first, at), (second, there), _ = pairs[p]
                known[p, row] = distance(first, at[row], second, there[row])
            return known[p, row]

        def push(p: int, i: int, j: int) -> None:
            path = pairs[p][2]
            heapq.heappush(heap, (0.5 * (apart(p, i) + apart(p, j) - path[j] + path[i]), next(order), p, i, j))

        for p in range(len(pairs)):
            push(p, 0, len(q) - 1)
        least = min(known.values(), default=np.inf)
        while heap and heap[0][0] < least:
            _, _, p, i, j = heapq.heappop(heap)
            if j - i > 1:
                middle = (i + j) // 2
                least = min(least, apart(p, middle))
                push(p, i, middle)
                push(p, middle, j)
        p, row = min(known, key=known.get, default=(None, 0))
        return Closest(np.inf, "", "", 0) if p is None else Closest(least, pairs[p][0][0].link, pairs[p][1][0].link, row)

    def _pairs(self, place: np.ndarray) -> list[tuple]:
        """(body, its placements), (the other, its placements), and how far one has moved seen from the other [m], (N,)."""
        robot, pairs = self.robot, []
        for a in robot.moving:
            path = _travel(place[:, a], robot.bodies[a])
            for obstacle, at in zip(self.obstacles, self.places, strict=True):
                pairs.append(((robot.bodies[a], place[:, a]), (obstacle, np.broadcast_to(at, (len(place), 4, 4))), path))
        for a, b in robot.own_pairs:
            seen = np.linalg.inv(place[:, a]) @ place[:, b]
            pairs.append(((robot.bodies[a], place[:, a]), (robot.bodies[b], place[:, b]), _travel(seen, robot.bodies[b])))
        return pairs


def _travel(place: np.ndarray, body: Body) -> np.ndarray:
    """How far any point of a body has moved at most, at each row of its placements (N, 4, 4), shape (N,) [m]."""
    center = place[:, :3, :3] @ body.center + place[:, :3, 3]
    # A difference of two rotations has two equal singular values and a zero: its largest is the Frobenius norm over √2.
    turn = np.linalg.norm(np.diff(place[:, :3, :3], axis=0), axis=(1, 2)) / np.sqrt(2.0)
    steps = np.linalg.norm(np.diff(center, axis=0), axis=1) + body.radius * turn
    return np.append(0.0, np.cumsum(steps))


def _shape(entry: Mapping[str, Any]) -> Any:
    if entry["type"] == "box":
        return coal.Box(*map(float, entry["size"]))
    if entry["type"] == "cylinder":
        return coal.Cylinder(float(entry["radius"]), float(entry["length"]))
    return coal.Sphere(float(entry["radius"]))


def _pose(entry: Mapping[str, Any]) -> np.ndarray:
    w, x, y, z = entry["quat_wxyz"]
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), np.array(entry["xyz"], float)).homogeneous


def _reordered(values: np.ndarray, order: list[int]) -> np.ndarray:
    result = np.empty_like(values)
    result[:, order] = values
    return result
