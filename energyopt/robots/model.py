"""RobotModel: an arm with its dynamics, frames and limits. Immutable; made by `load_robot`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from energyopt.dynamics.body import Dynamics
from energyopt.errors import RobotError
from energyopt.readable import Readable, counted
from energyopt.robots.messages import as_numbers, shown

if TYPE_CHECKING:
    import casadi

    from energyopt.actuators import Actuators


@dataclass(frozen=True)
class Limits:
    """Joint limits in SI units; an entry is ±inf where nothing limits.

    Attributes:
        lower, upper: position [rad], shape (nv,).
        velocity: |q̇| [rad/s]; acceleration: |q̈| [rad/s²]; jerk: |d³q/dt³| [rad/s³];
        torque: |τ| [N·m]; torque_rate: |dτ/dt| [N·m/s]; each of shape (nv,).
    """

    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    torque_rate: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class RobotModel(Readable):
    """A fixed-base arm whose nv joints each have one degree of freedom; ``str()`` is a table of them.

    Attributes:
        name: catalogue name, or the name in the URDF.
        dynamics: numeric dynamics (armature, friction, payload and gravity included).
        limits: joint limits.
        urdf: the prepared URDF text that every engine reads: locked joints are fixed, continuous joints
            revolute with a stated range, mimic joints resolved, the payload attached as a link.
        package_dirs: folders in which ``package://`` mesh paths of ``urdf`` are resolved.
        tool_frame: frame whose tracking error is reported.
        notes: what loading changed or assumed, one sentence each.
        home: a resting configuration inside the limits [rad or m], shape (nv,).
        source: the URDF file the robot came from; relative mesh paths start there.
        srdf: semantic description (pairs of links that may touch), where one was found.
        actuators: the electric drives of the joints, where they are known.
        like: a robot of the same bodies and joints, but of other masses or frictions: its geometry serves this one too.
    """

    name: str
    dynamics: Dynamics
    limits: Limits
    urdf: str
    package_dirs: tuple[Path, ...] = ()
    tool_frame: str = ""
    notes: tuple[str, ...] = field(default=())
    home: np.ndarray = field(default_factory=lambda: np.zeros(0))
    source: Path | None = None
    srdf: Path | None = None
    actuators: Actuators | None = None
    like: RobotModel | None = field(default=None, repr=False)

    def in_brief(self) -> str:
        return f"{self.name}, {counted(self.nv, 'joint')}"

    def __str__(self) -> str:
        from energyopt.robots.text import robot_table

        return robot_table(self)

    @property
    def geometry(self) -> RobotModel:
        """The robot for which what follows from the geometry alone is prepared and kept."""
        return self.like or self

    @property
    def model(self) -> pin.Model:
        return self.dynamics.model

    @property
    def nv(self) -> int:
        return self.dynamics.nv

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(self.model.names[1:])

    @property
    def frame_names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(f.name for f in self.model.frames))

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Joint torques [N·m] by numeric Pinocchio; ``q``, ``v``, ``a`` and the result have shape (N, nv) or (nv,)."""
        states = [self._state(name, value) for name, value in (("q", q), ("v", v), ("a", a))]
        if len({state.shape for state in states}) > 1:
            shapes = ", ".join(str(state.shape) for state in states)
            raise RobotError(f"{self.name}: torque: q, v and a have the shapes {shapes}; expected one shape")
        return self.dynamics.torque(*states)

    def placement(self, frame: str, q: np.ndarray) -> pin.SE3:
        """world_T_frame at the configuration ``q`` (nv,)."""
        data = self.model.createData()
        q = self._state("q", q)
        if q.ndim != 1:
            raise RobotError(f"{self.name}: placement: q has the shape {q.shape}; expected one configuration, ({self.nv},)")
        pin.forwardKinematics(self.model, data, q)
        return pin.updateFramePlacement(self.model, data, self.frame_id(frame))

    def frame_id(self, frame: str) -> int:
        """Index of a frame by name; links are preferred where a link and a joint share the name.

        Raises:
            RobotError: no such frame; the message lists the nearest names.
        """
        matches = [i for i, f in enumerate(self.model.frames) if isinstance(frame, str) and f.name == frame]
        if not matches:
            raise RobotError(f"{self.name}: no frame named {shown(frame)}; {self._frame_hint(frame)}")
        return max(matches, key=lambda i: self.model.frames[i].type == pin.FrameType.BODY)

    def _state(self, key: str, value: ArrayLike) -> np.ndarray:
        """Numbers of shape (N, nv) or (nv,)."""
        array = value if isinstance(value, np.ndarray) and value.dtype == float else as_numbers(value)
        if array is None:
            raise RobotError(f"{self.name}: {key} is {shown(value)}; expected {self.nv} numbers, or rows of them")
        if array.ndim not in (1, 2) or array.shape[-1] != self.nv:
            raise RobotError(f"{self.name}: {key} has the shape {array.shape}; expected ({self.nv},) or (N, {self.nv})")
        return array

    def _frame_hint(self, frame: str) -> str:
        """Names like ``frame``; where there is none, the links nearest to the tool."""
        import difflib

        names = [name for name in self.frame_names if name not in ("universe", "root_joint")]
        near = difflib.get_close_matches(str(frame), names, n=4, cutoff=0.5)
        if near:
            return f"did you mean {' or '.join(near)}?"
        links = [f.name for f in self.model.frames if f.type == pin.FrameType.BODY and f.name != self.tool_frame]
        tool = f"the tool is '{self.tool_frame}', further links" if self.tool_frame in names else "the last links"
        return f"{tool} are {', '.join(links[::-1][:6])}"

    @cached_property
    def inverse_dynamics(self) -> casadi.Function:
        """CasADi function (q, v, a) → tau with everything `torque` includes."""
        from energyopt.dynamics.symbolic import inverse_dynamics

        return inverse_dynamics(self.dynamics)

    @cached_property
    def mass_matrix(self) -> casadi.Function:
        """CasADi function (q) → M(q) + armature, shape (nv, nv)."""
        from energyopt.dynamics.symbolic import mass_matrix

        return mass_matrix(self.dynamics)

    def frame_placement(self, frame: str) -> casadi.Function:
        """CasADi function (q) → R (3×3), p (3,): world_T_frame."""
        from energyopt.dynamics.symbolic import frame_placement

        return frame_placement(self.model, self.frame_id(frame))

    def with_limits(self, **changes: np.ndarray) -> RobotModel:
        """The same robot with some fields of its `Limits` replaced."""
        return replace(self, limits=replace(self.limits, **changes), like=None)
