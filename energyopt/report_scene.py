"""The part of a report that shows the arm among its obstacles: a picture in space, and the distances over time."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING

from energyopt.errors import RobotError
from energyopt.geometry.bodies import collision_bodies
from energyopt.plots.svg import inline_svg
from energyopt.plotting import plot_clearance, plot_scene
from energyopt.report_parts import Markup, section

if TYPE_CHECKING:
    from energyopt.plans import Plan
    from energyopt.simulation.log import ReplayLog


def has_surroundings(plan: Plan) -> bool:
    """Whether there is more to keep clear of than the arm itself, and geometry to show it with."""
    problem = plan.problem
    if not any(not item.frames for item in problem.workspace) and not problem.obstacles:
        return False
    try:
        return any(body.joint for body in collision_bodies(problem.robot, problem.attached))
    except RobotError:
        return False


def scene_sections(plan: Plan, log: ReplayLog | None) -> list[Markup]:
    """Two sections; nothing where there are no obstacles."""
    if not has_surroundings(plan):
        return []
    image = io.BytesIO()
    plot_scene(plan).savefig(image, format="png", dpi=120)
    data = base64.b64encode(image.getvalue()).decode()
    scene = Markup(f'<img alt="The arm at several instants among the obstacles." src="data:image/png;base64,{data}">')
    curves = inline_svg(plot_clearance(plan, log), "clearance", "Distance to every obstacle over time.")
    return [section("Among obstacles", scene), section("How far it stays away", Markup(curves))]
