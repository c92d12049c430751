"""Robots in words: one with its joints and limits, and the catalogue as a table."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from energyopt.robots.model import RobotModel


def robots_table(names: tuple[str, ...], load: Callable[[str], RobotModel]) -> str:
    """Joints, mass they move, limits and data file of the robots of the catalogue."""
    lines = [f"{'name':16} {'joints':>6} {'moves':>9} {'torque limits':>15} {'velocity limits':>15}  file"]
    for name in names:
        robot = load(name)
        mass = sum(inertia.mass for inertia in list(robot.model.inertias)[1:])
        torque, velocity = _range(robot.limits.torque, "N·m"), _range(robot.limits.velocity, "rad/s")
        file = "/".join(robot.source.parts[-3:]) if robot.source else ""
        lines.append(f"{name:16} {robot.nv:6} {mass:6.1f} kg {torque:>15} {velocity:>15}  {file}")
    return "\n".join(lines)


def robot_table(robot: RobotModel) -> str:
    """One robot: its joints with limits, its tool, and what loading found."""
    limits, width = robot.limits, max(len(name) for name in robot.joint_names)
    mass = sum(inertia.mass for inertia in list(robot.model.inertias)[1:])
    lines = [f"{robot.name}: {robot.nv} joints, moving mass {mass:.4g} kg, tool frame {robot.tool_frame}"]
    for i, name in enumerate(robot.joint_names):
        position = f"{limits.lower[i]:8.4g} to {limits.upper[i]:8.4g}"
        lines.append(f"  {name:<{width}}  {position}   velocity {limits.velocity[i]:6.4g}   torque {limits.torque[i]:6.4g}")
    return "\n".join(lines + [f"  note: {note}" for note in robot.notes])


def _range(values: np.ndarray, unit: str) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.3g} {unit}" if low == high else f"{low:.3g}–{high:.3g} {unit}"
