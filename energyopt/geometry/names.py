"""Names of things that may meet: reports speak of pairs by name, so no two may share one."""

from __future__ import annotations

from collections.abc import Sequence

from energyopt.errors import ProblemError, RobotError
from energyopt.geometry.bodies import Attached
from energyopt.geometry.exact import obstacle_names
from energyopt.geometry.shapes import Shape
from energyopt.geometry.workspace import Workspace
from energyopt.robots.model import RobotModel


def require_own_names(
    robot: RobotModel, obstacles: Sequence[Shape], workspace: Sequence[Workspace], attached: Sequence[Attached]
) -> None:
    """Refuse a name that two things have, or that a frame of the robot has; walls without a name need none.

    Raises:
        ProblemError: names both places.
    """
    given = [(f"obstacles[{k}].name", name) for k, name in enumerate(obstacle_names(obstacles))]
    given += [(f"workspace[{k}].name", item.region.name) for k, item in enumerate(workspace) if item.region.name]
    given += [(f"attached[{k}].name", item.name) for k, item in enumerate(attached)]
    taken = dict.fromkeys(robot.frame_names, "a frame of the robot")
    for key, name in given:
        if name in taken:
            raise ProblemError(f'{key} is "{name}", as {taken[name]}; expected a name of its own')
        taken[name] = f"that of {key.removesuffix('.name')}"


def require_frames(robot: RobotModel, workspace: Sequence[Workspace], attached: Sequence[Attached]) -> None:
    """Refuse frames that the robot does not have.

    Raises:
        ProblemError: names the place and the nearest frames.
    """
    asked = [(f"workspace[{k}].frames", frame) for k, item in enumerate(workspace) for frame in item.frames]
    asked += [(f"attached[{k}].frame", item.frame or robot.tool_frame) for k, item in enumerate(attached)]
    for key, frame in asked:
        try:
            robot.frame_id(frame)
        except RobotError as error:
            raise ProblemError(f"{key}: {error}") from None
