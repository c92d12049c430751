"""Motions for other programs: a table (CSV) and the shape of ROS 2 ``trajectory_msgs/JointTrajectory`` (JSON).

Both hold samples every `SAMPLE_TIME` seconds and at the end. Numbers are written with all their digits.
"""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np

from energyopt.arguments import check_plan
from energyopt.dynamics.body import joint_axis
from energyopt.io.archive import write_atomic
from energyopt.plans import Plan
from energyopt.problem_values import real
from energyopt.robots import RobotModel

SAMPLE_TIME = 0.01
"""Time between samples [s]; longer where a motion would have more than `MAX_SAMPLES`."""
MAX_SAMPLES = 100_000


def write_csv(plan: Plan, path: str | Path, sample_time: float = SAMPLE_TIME) -> None:
    """Write t, then q, v, a and tau of every joint, with units in the header.

    Raises:
        FileError: the file cannot be written. InputError: an argument makes no sense.
    """
    t, q, v, a, tau = _samples(plan, sample_time)
    units = [_units(plan.problem.robot, i) for i in range(plan.problem.robot.nv)]
    header = ["t [s]"]
    for k, symbol in enumerate(("q", "v", "a", "tau")):
        header += [f"{symbol}_{name} [{unit[k]}]" for name, unit in zip(plan.problem.robot.joint_names, units, strict=True)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(np.column_stack([t, q, v, a, tau]).tolist())
    write_atomic(path, text.getvalue().encode())


def write_joint_trajectory(plan: Plan, path: str | Path, sample_time: float = SAMPLE_TIME) -> None:
    """Write a ``trajectory_msgs/JointTrajectory`` as JSON.

    Raises:
        FileError: the file cannot be written. InputError: an argument makes no sense.
    """
    t, q, v, a, tau = _samples(plan, sample_time)
    robot = plan.problem.robot
    points = [
        {
            "positions": q[k].tolist(),
            "velocities": v[k].tolist(),
            "accelerations": a[k].tolist(),
            "effort": tau[k].tolist(),
            "time_from_start": _duration(t[k]),
        }
        for k in range(len(t))
    ]
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": _base_link(robot)}
    message = {"header": header, "joint_names": list(robot.joint_names), "points": points}
    write_atomic(path, (json.dumps(message, allow_nan=False) + "\n").encode())


def _samples(plan: Plan, sample_time: float) -> tuple[np.ndarray, ...]:
    """Times (N,) and q, v, a, tau (N, nv); the last interval may be shorter."""
    check_plan("the export", plan)
    real("sample_time", sample_time, lambda h: 0 < h < np.inf, "seconds > 0")
    trajectory = plan.trajectory
    step = max(sample_time, trajectory.duration / MAX_SAMPLES)
    count = int(np.ceil(trajectory.duration / step - 1e-9))
    t = np.append(step * np.arange(count), trajectory.duration)
    return t, trajectory(t), trajectory(t, 1), trajectory(t, 2), plan.torque(t)


def _units(robot: RobotModel, joint: int) -> tuple[str, str, str, str]:
    if joint_axis(robot.model, joint + 1)[0] == "prismatic":
        return "m", "m/s", "m/s^2", "N"
    return "rad", "rad/s", "rad/s^2", "N m"


def _duration(t: float) -> dict[str, int]:
    """A ROS duration: whole seconds and the nanoseconds beyond them."""
    nanoseconds = round(float(t) * 1e9)
    return {"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000}


def _base_link(robot: RobotModel) -> str:
    """The link the first joint is fixed to."""
    names = [f.name for f in robot.model.frames if f.parentJoint == 0 and f.type.name == "BODY"]
    return names[0] if names else "world"
