"""`plot_scene`: the sweep of the arm past the obstacles, in space.

A few poses of the arm, light at the start and dark at the goal; obstacles, those that move at the same instants; the way of
the tool. The eye looks from where least of that way is hidden.
"""

from __future__ import annotations

from itertools import combinations, product
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from energyopt.arguments import check_plan
from energyopt.errors import InputError
from energyopt.geometry.bodies import collision_bodies
from energyopt.geometry.exact import obstacle_names
from energyopt.geometry.kinematics import joint_placements
from energyopt.geometry.shapes import Box, HalfSpace
from energyopt.plots import look
from energyopt.plots.solids import COARSEST, Faces, faces_of, plane_patch, same_length
from energyopt.plots.viewpoint import fill_page, viewpoint

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

    from energyopt.plans import Plan

TIME = LinearSegmentedColormap.from_list("time", ["#b5daf0", "#56a3d6", "#155a9c"])
"""Of the arm, from start to goal."""
REST, OBSTACLE, NAME = "#c3c8ce", "#d9a441", "#6b4c0d"
"""Of what never moves on the robot; of obstacles; of their names and ways."""
GHOST, FIRST, LAST, SOLID = 0.22, 0.6, 1.0, 0.5
"""How opaque poses between, at the start and at the goal are, and obstacles."""
GRID = 0.2
"""Width of a square of the ground [m]."""
MARGIN = 0.1
SAME_PLACE = 0.08
"""Way of a solid's middle [m] below which only its last place is drawn."""
FARTHEST, SMALL = 0.6, 0.7
"""How far beyond the arm [m] obstacles are drawn; radius below which one is drawn whole."""
MOST_POSES, MOST_NAMES = 24, 10


def plot_scene(plan: Plan, ax: Axes3D | None = None, poses: int = 6) -> Figure:
    """Draw the arm's sweep past the obstacles.

    Args:
        plan: the motion.
        ax: a 3-D panel to draw into; a figure of its own by default.
        poses: how many to show, 2 to 24, start and goal among them.

    Returns:
        The figure.

    Raises:
        InputError: no plan, a robot without geometry, or another number of poses.
    """
    check_plan("plot_scene", plan)
    if not (isinstance(poses, (int, np.integer)) and 2 <= poses <= MOST_POSES):
        raise InputError(f"poses is {poses!r}; expected a whole number from 2 to {MOST_POSES}")
    problem = plan.problem
    if not collision_bodies(problem.robot, problem.attached):
        raise InputError(f"{problem.robot.name}: no link has geometry; there is nothing to draw")
    with look.style():
        figure = ax.figure if ax is not None else Figure(figsize=(look.WIDTH, 7.4))
        panel = ax if ax is not None else figure.add_axes((0.0, 0.05, 1.0, 0.9), projection="3d")
        picture = _Picture(plan, poses)
        picture.paint(panel)
        if ax is None:
            fill_page(panel, picture.corners)
            _time_bar(figure, plan)
            among = ", among obstacles" if problem.obstacles else ""
            look.heading(figure, plan, f"The arm at {poses} instants and the way of its tool{among}.")
    return figure


class _Picture:
    """Everything to paint, in the axes of the robot's base."""

    def __init__(self, plan: Plan, poses: int):
        problem, robot = plan.problem, plan.problem.robot
        self.plan, self.problem = plan, problem
        self.bodies = collision_bodies(robot, problem.attached)
        self.fine = np.linspace(0.0, plan.duration, 161)
        self.way = self._tool(self.fine)
        self.times = self._instants(poses)
        self.solids = [faces_of(body.shape).placed(body.shape.pose_at(0.0)) for body in self.bodies]
        self.middles = [np.concatenate(faces.polygons).mean(axis=0) for faces in self.solids]
        self.rotation, self.position = joint_placements(robot.model, plan.trajectory(self.times))
        points = [p for k in range(len(self.times)) for faces, _ in self._arm(k, True) for p in faces.polygons]
        points = np.concatenate([*points, self.way])
        self.low, self.high = points.min(axis=0), points.max(axis=0)
        self.low[2] = min(self.low[2], 0.0)
        self.shown = (self.low - FARTHEST, self.high + FARTHEST)
        self.obstacles = self._obstacles()
        finite = [faces for faces, _, number in self.obstacles if number in self.finite]
        inside = [polygon for faces in finite for polygon in faces.polygons]
        self.cells = [_edges(item.region) for item in problem.workspace if isinstance(item.region, Box)]
        self.corners = np.concatenate([points, *inside, *(e.reshape(-1, 3) for e in self.cells if self._near(e.reshape(-1, 3)))])
        self.low, self.high = np.minimum(self.low, self.corners.min(axis=0)), self.corners.max(axis=0)
        solids = [problem.obstacles[k] for k in self.finite]
        self.view = viewpoint(self.way, self.fine, solids, 0.5 * (self.low + self.high))

    def paint(self, ax: Axes3D) -> None:
        polygons, colours = [], []
        ax.computed_zorder = False
        self._ground(ax)
        for faces, colour, alpha in self._everything():
            seen = faces.seen_from(self.view.eye)
            polygons += seen.polygons
            colours.append(seen.colours(colour, alpha))
        filled = np.concatenate(colours)
        edges = filled * [1.0, 1.0, 1.0, 0.0]
        edges[filled[:, 3] >= 1.0, 3] = 1.0  # closes the hair lines between faces; between translucent ones it would draw them
        style = {"facecolors": filled, "edgecolors": edges, "linewidths": 0.4, "zorder": 2, "clip_on": False}
        ax.add_collection3d(Poly3DCollection(same_length(polygons), **style), autolim=False)
        self._cells(ax)
        self._paths(ax)
        self._names(ax)
        self._frame(ax)

    def _everything(self):
        """(faces, colour, alpha) of every solid."""
        for k, t in enumerate(self.times):
            share = t / self.plan.duration
            alpha = LAST if k == len(self.times) - 1 else FIRST if k == 0 else GHOST
            for faces, moves in self._arm(k, k == 0):
                yield faces, TIME(share)[:3] if moves else REST, alpha if moves else LAST
        for faces, alpha, _ in self.obstacles:
            yield faces, OBSTACLE, alpha

    def _arm(self, k: int, resting: bool):
        """Solids at the k-th instant, and whether each moves; those that do not only where asked for.

        Before the end, solids that are nearly where they will be then are left out: they would only run into each other.
        """
        before = k < len(self.times) - 1
        for body, faces, middle in zip(self.bodies, self.solids, self.middles, strict=True):
            first, last = (self.position[i, body.joint] + self.rotation[i, body.joint] @ middle for i in (k, -1))
            apart = np.linalg.norm(first - last)
            if (body.joint or resting) and not (body.joint and before and apart < SAME_PLACE):
                pose = np.eye(4)
                pose[:3, :3], pose[:3, 3] = self.rotation[k, body.joint], self.position[k, body.joint]
                yield faces.placed(pose), bool(body.joint)

    def _obstacles(self) -> list[tuple[Faces, float, int]]:
        """(faces, alpha, number) of every obstacle at rest, and of those that move at every instant."""
        found, middle = [], 0.5 * (self.low + self.high)
        half = 0.5 * float(np.max(self.high[:2] - self.low[:2])) + MARGIN
        self.finite = [k for k, shape in enumerate(self.problem.obstacles) if not isinstance(shape, HalfSpace)]
        walls = [wall for item in self.problem.workspace for wall in item.walls if isinstance(item.region, HalfSpace)]
        for number, shape in enumerate((*self.problem.obstacles, *walls)):
            times = self.times if shape.moves else self.times[:1]
            own = None if isinstance(shape, HalfSpace) else faces_of(shape).cut(COARSEST)
            for k, pose in enumerate(shape.pose_at(times)):
                faces = own.placed(pose) if own else plane_patch(shape, pose, middle, half).cut(COARSEST)
                alpha = SOLID * (0.25 + 0.75 * (k + 1) / len(times)) if own else 0.25 * SOLID
                found.append((self._kept(faces, pose[:3, 3], shape.bounding_radius), alpha, number))
        return found

    def _kept(self, faces: Faces, place: np.ndarray, radius: float) -> Faces:
        """What is near the arm: of a small solid all or nothing, of a large one some of its pieces."""
        points = [place if radius < SMALL else polygon.mean(axis=0) for polygon in faces.polygons]
        near = [self._near(point) for point in points]
        return Faces([p for p, here in zip(faces.polygons, near, strict=True) if here], faces.normals[np.array(near, bool)])

    def _near(self, points: np.ndarray) -> bool:
        return bool(np.all(points > self.shown[0]) and np.all(points < self.shown[1]))

    def _tool(self, t: np.ndarray) -> np.ndarray:
        robot = self.problem.robot
        frame = robot.model.frames[robot.frame_id(robot.tool_frame) if robot.tool_frame else robot.model.nframes - 1]
        rotation, position = joint_placements(robot.model, self.plan.trajectory(t))
        joint = frame.parentJoint
        return position[:, joint] + rotation[:, joint] @ frame.placement.translation

    def _instants(self, poses: int) -> np.ndarray:
        """Times at which the tool has gone equal parts of its way, mixed with equal times, which a tool at rest needs."""
        step = np.linalg.norm(np.diff(self.way, axis=0), axis=1)
        gone = np.append(0.0, np.cumsum(step + 0.2 * step.mean() + 1e-9))
        return np.interp(np.linspace(0.0, gone[-1], poses), gone, self.fine)

    def _ground(self, ax: Axes3D) -> None:
        low, high = GRID * np.floor(self.low[:2] / GRID), GRID * np.ceil(self.high[:2] / GRID)
        z = self.low[2]
        lines = [[(x, low[1], z), (x, high[1], z)] for x in np.arange(low[0], high[0] + 0.5 * GRID, GRID)]
        lines += [[(low[0], y, z), (high[0], y, z)] for y in np.arange(low[1], high[1] + 0.5 * GRID, GRID)]
        ax.add_collection3d(Line3DCollection(lines, colors=look.RULE, linewidths=0.7, zorder=1, clip_on=False), autolim=False)

    def _cells(self, ax: Axes3D) -> None:
        """The edges of boxes to stay inside of."""
        line = {"colors": NAME, "linewidths": 1.0, "linestyles": (0, (6, 3)), "zorder": 2.5, "clip_on": False}
        for edges in self.cells:
            ax.add_collection3d(Line3DCollection(edges, **line), autolim=False)

    def _paths(self, ax: Axes3D) -> None:
        segments = np.stack([self.way[:-1], self.way[1:]], axis=1)
        for colour, width, order in ((look.PAPER, 4.2, 3), (look.LIMIT, 2.2, 4)):
            line = {"colors": colour, "linewidths": width, "zorder": order, "capstyle": "round", "clip_on": False}
            ax.add_collection3d(Line3DCollection(segments, **line), autolim=False)
        for point, fill, words in ((self.way[0], look.PAPER, "start"), (self.way[-1], look.LIMIT, "goal")):
            mark = {"markerfacecolor": fill, "markersize": 7, "markeredgewidth": 1.8, "zorder": 5, "clip_on": False}
            ax.plot(*point[:, None], "o", color=look.LIMIT, **mark)
            below = point - [0, 0, 0.03 * np.max(self.high - self.low)]
            self._word(ax, below, words, color=look.LIMIT, fontsize=9, fontweight="bold", va="top")
        for k in self.finite:
            shape = self.problem.obstacles[k]
            if shape.moves:
                line = {"color": NAME, "linewidth": 1.2, "linestyle": (0, (2, 2)), "zorder": 3, "clip_on": False}
                ax.plot(*shape.pose_at(self.fine)[:, :3, 3].T, **line)

    def _names(self, ax: Axes3D) -> None:
        """Above the obstacles of finite size, ten of them at most; above one that moves where it ends."""
        names = obstacle_names(self.problem.obstacles)
        last = {number: faces for faces, _, number in self.obstacles if number in self.finite}
        for number in self.finite[:MOST_NAMES]:
            if last[number].polygons:
                corners = np.concatenate(last[number].polygons)
                top = np.append(corners[:, :2].mean(axis=0), corners[:, 2].max() + 0.02)
                self._word(ax, top, look.fitted(names[number]), color=NAME, fontsize=8)

    def _word(self, ax: Axes3D, place: np.ndarray, words: str, **font) -> None:
        halo = [Stroke(linewidth=2.5, foreground=look.PAPER), Normal()]
        ax.text(*place, words, ha="center", zorder=6, path_effects=halo, **font)

    def _frame(self, ax: Axes3D) -> None:
        ax.set_proj_type("ortho")
        ax.view_init(self.view.elevation, self.view.azimuth)
        size = self.high - self.low
        ax.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]), zlim=(self.low[2], self.high[2]))
        ax.set_box_aspect(size)
        ax.set_axis_off()


def _edges(box: Box) -> np.ndarray:
    """The twelve edges of a box [m], shape (12, 2, 3)."""
    corners = [np.array(signs) for signs in product((-0.5, 0.5), repeat=3)]
    pairs = [pair for pair in combinations(corners, 2) if np.count_nonzero(pair[0] != pair[1]) == 1]
    pose = box.pose_at(0.0)
    return np.array(pairs) * box.size @ pose[:3, :3].T + pose[:3, 3]


def _time_bar(figure: Figure, plan: Plan) -> None:
    figure.add_artist(Rectangle((0.26, 0.0), 0.42, 0.068, color=look.PAPER, alpha=0.8, linewidth=0, zorder=1))
    place = figure.add_axes((0.34, 0.045, 0.32, 0.014), zorder=2)
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, plan.duration), TIME), cax=place, orientation="horizontal")
    bar.outline.set_visible(False)
    bar.set_ticks([0.0, 0.5 * plan.duration, plan.duration])
    bar.ax.tick_params(length=0, labelsize=8, labelcolor=look.INK, labelfontfamily="DejaVu Sans")
    figure.text(0.33, 0.052, "time [s]", ha="right", va="center", fontsize=8.5, color=look.INK)
    figure.text(0.985, 0.02, f"squares of {GRID:g} m", ha="right", va="bottom", fontsize=8, color=look.QUIET)
