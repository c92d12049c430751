"""Problem: what is asked of the planner, validated when made, and immutable.

minimise ∫₀ᵀ ( Σ wᵢ τᵢ² + Σ λᵢ q̇ᵢ² ) dt, or other cost terms,   over all motions q(t), 0 ≤ t ≤ T, T given or free, with
q(0), q̇(0), q̈(0) given;  q(T) given or the tool in a given pose;  q̇(T), q̈(T) given;  waypoints passed;
position, velocity, acceleration, jerk, torque and torque rate inside their limits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from energyopt import problem_values as values
from energyopt.costs import CostTerm, TorqueSquared, VelocitySquared, checked_costs
from energyopt.errors import ProblemError
from energyopt.geometry.bodies import Attached
from energyopt.geometry.names import require_frames, require_own_names
from energyopt.geometry.potential import RepulsivePotential
from energyopt.geometry.shapes import Box, HalfSpace, Shape
from energyopt.geometry.workspace import Workspace
from energyopt.readable import Readable, counted
from energyopt.robots.model import Limits, RobotModel

VELOCITY_WEIGHT = 0.1
"""λ where none is given."""
MOST_CLEARANCE = 10.0
_CLEARANCE = f"metres, 0 to {MOST_CLEARANCE:g}"


@dataclass(frozen=True, eq=False)
class FramePose:
    """A Cartesian goal: where a frame has to be; the redundancy of the arm is left to the optimiser.

    Attributes:
        frame: name of a link, joint or frame of the robot.
        position: of the frame's origin in the robot's base [m], shape (3,).
        rotation: 3×3 matrix or unit quaternion (w, x, y, z); None leaves the orientation free.
    """

    frame: str
    position: np.ndarray
    rotation: np.ndarray | None = None

    def __post_init__(self):
        values.text("goal frame", self.frame, "the name of a link or joint")
        object.__setattr__(self, "position", values.vector("goal position", self.position, 3, scalar=False))
        if self.rotation is not None:
            object.__setattr__(self, "rotation", values.rotation(self.rotation))


@dataclass(frozen=True, eq=False)
class Waypoint:
    """A configuration to pass through.

    Attributes:
        position: joint positions [rad], shape (nv,).
        time: when [s]; None lets the optimiser choose, in the order the waypoints are listed.
    """

    position: np.ndarray
    time: float | None = None

    def __post_init__(self):
        object.__setattr__(self, "position", values.configuration("waypoint position", self.position))
        if self.time is not None:
            object.__setattr__(self, "time", values.seconds("waypoint time", self.time))


@dataclass(frozen=True, eq=False, repr=False)
class Problem(Readable):
    """One planning problem. Arrays have shape (nv,); a single number stands for all joints.

    Attributes:
        robot: the arm.
        start: joint positions at t = 0 [rad].
        goal: joint positions at t = T [rad], or a `FramePose`.
        duration: T [s], or (least, most) where the optimiser is to choose it.
        velocity_weight: λ, one number or one a joint [N²·m²·s²/rad²].
        torque_weights: w, dimensionless.
        periodic: whether the motion is a cycle: it ends where it starts, with the velocity and the acceleration it starts with,
            which the optimiser chooses.
        costs: cost terms (see `energyopt.costs`) in place of these two.
        waypoints: configurations to pass through: `Waypoint`, an array, or a pair (array, time).
        start_velocity, goal_velocity: [rad/s]; start_acceleration, goal_acceleration: [rad/s²]; zero by default.
        position_limits: (lower, upper) [rad]; velocity_limits [rad/s]; acceleration_limits [rad/s²];
            jerk_limits [rad/s³]; torque_limits [N·m]; torque_rate_limits [N·m/s]: in place of the robot's own.
        obstacles: shapes to stay clear of, such as `Box`; a pose may be `Moving`.
        workspace: where to stay: a `Box` (inside it), a `HalfSpace` (out of it), `Workspace`, or several of them.
        clearance: least distance from obstacles and walls [m]; 0 asks for no contact, as always between links of the arm.
        potential: `RepulsivePotential`, whose integral over the motion, summed over spheres and obstacles, is added to J.
        self_collision: whether links of the arm are kept apart.
        attached: tools and grasped objects, `Attached`.
        name: for reports.
        origin: for a problem read from a file: what gives, for one of these names, its place there and its name there.

    Raises:
        ProblemError: a value is malformed; the message names it, what was expected, and what to do.
    """

    robot: RobotModel
    start: ArrayLike
    goal: ArrayLike | FramePose
    duration: float | tuple[float, float]
    velocity_weight: ArrayLike = VELOCITY_WEIGHT
    torque_weights: ArrayLike = 1.0
    waypoints: Sequence = ()
    start_velocity: ArrayLike = 0.0
    goal_velocity: ArrayLike = 0.0
    start_acceleration: ArrayLike = 0.0
    goal_acceleration: ArrayLike = 0.0
    position_limits: tuple[ArrayLike, ArrayLike] | None = None
    velocity_limits: ArrayLike | None = None
    acceleration_limits: ArrayLike | None = None
    jerk_limits: ArrayLike | None = None
    torque_limits: ArrayLike | None = None
    torque_rate_limits: ArrayLike | None = None
    obstacles: Sequence[Shape] = ()
    workspace: Box | HalfSpace | Workspace | Sequence | None = None
    clearance: float = 0.0
    potential: RepulsivePotential | None = None
    self_collision: bool = True
    attached: Sequence[Attached] = ()
    name: str = ""
    origin: Callable[[str], tuple[str, str]] | None = field(default=None, repr=False)
    costs: Sequence[CostTerm] | CostTerm | None = None
    periodic: bool = False

    def __post_init__(self):
        if not isinstance(self.robot, RobotModel):
            raise ProblemError(f"robot is {values.shown(self.robot)}: expected what energyopt.load_robot gives")
        joints = self.robot.joint_names
        put = lambda key, value: object.__setattr__(self, key, value)
        put("start", values.vector("start", self.start, joints, scalar=False))
        if isinstance(self.goal, FramePose):
            self.robot.frame_id(self.goal.frame)
        else:
            put("goal", values.vector("goal", self.goal, joints, scalar=False, also=", or an energyopt.FramePose"))
        put("duration", values.duration(self.duration))
        for key in ("start_velocity", "goal_velocity", "start_acceleration", "goal_acceleration"):
            put(key, values.vector(key, getattr(self, key), joints))
        for key in ("velocity_weight", "torque_weights"):
            put(key, values.non_negative(key, getattr(self, key), joints))
        if self.costs is not None:
            put("costs", self._checked_costs())
        elif not (np.any(self.torque_weights > 0) or np.any(self.velocity_weight > 0)):
            raise ProblemError("torque_weights and velocity_weight are all zero: every motion costs nothing; make one positive")
        values.text("name", self.name, "a name for reports")
        put("waypoints", values.waypoints(self.waypoints, joints, self.durations[1], Waypoint))
        if self.free_duration and any(w.time is not None for w in self.waypoints):
            raise ProblemError("a waypoint has a time, and the duration is free: leave its time out, or give one duration")
        _ = self.limits
        self._check_cycle()
        put("obstacles", values.instances("obstacles", self.obstacles, Shape, "shapes such as energyopt.Box(size, pose)"))
        put("attached", values.instances("attached", self.attached, Attached, "energyopt.Attached(shape, frame)"))
        put("workspace", _workspaces(self.workspace))
        require_frames(self.robot, self.workspace, self.attached)
        require_own_names(self.robot, self.obstacles, self.workspace, self.attached)
        put("clearance", values.real("clearance", self.clearance, lambda d: 0 <= d <= MOST_CLEARANCE, _CLEARANCE))
        if self.potential is not None and not isinstance(self.potential, RepulsivePotential):
            expected = "energyopt.RepulsivePotential(gain, safe_distance)"
            raise ProblemError(f"potential is {values.shown(self.potential)}: expected {expected}")
        if not isinstance(self.self_collision, (bool, np.bool_)):
            raise ProblemError(f"self_collision is {values.shown(self.self_collision)}: expected True or False")

    def in_brief(self) -> str:
        least, most = self.durations
        time = f"{least:g} to {most:g} s" if self.free_duration else f"{most:g} s"
        parts = [self.name, self.robot.name, time, "to a pose of a frame" if isinstance(self.goal, FramePose) else ""]
        for things, noun in ((self.waypoints, "waypoint"), (self.obstacles, "obstacle"), (self.attached, "attached object")):
            parts.append(counted(len(things), noun) if things else "")
        return ", ".join(filter(None, parts))

    @cached_property
    def limits(self) -> Limits:
        """The limits in force: the problem's own where given, else the robot's."""
        robot, joints = self.robot.limits, self.robot.joint_names
        lower, upper = robot.lower, robot.upper
        if self.position_limits is not None:
            lower, upper = values.interval("position_limits", self.position_limits, joints)
        own = {}
        for kind in ("velocity", "torque", "acceleration", "jerk", "torque_rate"):
            value = getattr(self, f"{kind}_limits")
            own[kind] = getattr(robot, kind) if value is None else values.positive(f"{kind}_limits", value, joints)
        return Limits(lower=lower, upper=upper, **own)

    @property
    def durations(self) -> tuple[float, float]:
        """The least and the most T may be [s]; the same where it is given."""
        return self.duration if self.free_duration else (self.duration, self.duration)

    @property
    def free_duration(self) -> bool:
        """Whether T is to be chosen."""
        return isinstance(self.duration, tuple)

    def lasting(self, duration: float) -> Problem:
        """The same problem with a given T [s]."""
        return self if duration == self.duration else replace(self, duration=duration)

    @cached_property
    def cost_terms(self) -> tuple[CostTerm, ...]:
        """The terms of J, but for the potential."""
        if self.costs is not None:
            return self.costs
        return TorqueSquared(weights=self.torque_weights), VelocitySquared(weights=self.velocity_weight)

    def _check_cycle(self) -> None:
        if not isinstance(self.periodic, (bool, np.bool_)):
            raise ProblemError(f"periodic is {values.shown(self.periodic)}: expected True or False")
        if not self.periodic:
            return
        if isinstance(self.goal, FramePose) or np.any(self.goal != self.start):
            raise ProblemError("periodic: the goal is not the start; expected goal=start, and what lies between as waypoints")
        if not self.waypoints:
            raise ProblemError("periodic: a cycle without waypoints stands still; expected one waypoint or more")
        for key in ("start_velocity", "goal_velocity", "start_acceleration", "goal_acceleration"):
            if np.any(getattr(self, key) != 0):
                raise ProblemError(f"periodic: {key} is given; leave it out, a cycle passes its start with a velocity of its own")

    def _checked_costs(self) -> tuple[CostTerm, ...]:
        if np.any(self.torque_weights != 1.0) or np.any(self.velocity_weight != VELOCITY_WEIGHT):
            raise ProblemError(
                "costs is given, and so are torque_weights or velocity_weight: expected one or the other; "
                "TorqueSquared(weights=…) and VelocitySquared(weights=…) are cost terms"
            )
        return checked_costs(self.costs, self.robot)

    @property
    def goal_position(self) -> np.ndarray | None:
        """The goal as joint positions; None where it is Cartesian."""
        return None if isinstance(self.goal, FramePose) else self.goal


def _workspaces(given: object) -> tuple[Workspace, ...]:
    """What ``workspace`` may be, as `Workspace` objects."""
    if given is None:
        return ()
    several = list(given) if isinstance(given, (list, tuple)) else [given]
    return tuple(item if isinstance(item, Workspace) else Workspace(item) for item in several)
