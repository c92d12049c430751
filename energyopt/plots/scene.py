"""`plot_scene`: the sweep of the arm past the obstacles, in space.

A few poses of the arm, light at the start and dark at the goal; obstacles, those that move at the same instants; the way of
the tool. The eye looks from where least of that way is hidden.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import Normal, Stroke
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from energyopt.arguments import check_plan
from energyopt.errors import InputError
from energyopt.geometry.bodies import collision_bodies
from energyopt.geometry.exact import obstacle_names
from energyopt.geometry.kinematics import joint_placements
from energyopt.geometry.shapes import HalfSpace
from energyopt.plots import look
from energyopt.plots.solids import COARSEST, Faces, faces_of, plane_patch, same_length

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
FARTHEST = 0.6
"""How far beyond the arm's reach [m] obstacles are drawn."""
MOST_POSES, MOST_NAMES = 24, 10
FILLED = (0.04, 0.14, 0.96, 0.90)
"""Left, lower, right and upper edge of the scene, as shares of the figure."""


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
            _fill(panel, picture.corners)
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
        self.obstacles = self._obstacles()
        finite = [faces for faces, _, number in self.obstacles if number in self.finite]
        inside = [p for faces in finite for p in faces.polygons if self._near(p)]
        self.corners = np.concatenate([points, *inside])
        self.low, self.high = np.minimum(self.low, self.corners.min(axis=0)), self.corners.max(axis=0)
        self.elevation, self.azimuth, self.eye = self._view()

    def paint(self, ax: Axes3D) -> None:
        polygons, colours = [], []
        ax.computed_zorder = False
        self._ground(ax)
        for faces, colour, alpha in self._everything():
            seen = faces.seen_from(self.eye)
            polygons += seen.polygons
            colours.append(seen.colours(colour, alpha))
        filled = np.concatenate(colours)
        edges = filled * [1.0, 1.0, 1.0, 0.0]
        edges[filled[:, 3] >= 1.0, 3] = 1.0  # closes the hair lines between faces; between translucent ones it would draw them
        style = {"facecolors": filled, "edgecolors": edges, "linewidths": 0.4, "zorder": 2, "clip_on": False}
        ax.add_collection3d(Poly3DCollection(same_length(polygons), **style), autolim=False)
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
            near = [self._near(p) for p in faces.polygons]
            shown = [p for p, here in zip(faces.polygons, near, strict=True) if here]
            yield Faces(shown, faces.normals[np.array(near, bool)]), OBSTACLE, alpha

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
                found.append((faces, alpha, number))
        return found

    def _near(self, polygon: np.ndarray) -> bool:
        middle = polygon.mean(axis=0)
        return bool(np.all(middle > self.low - FARTHEST) and np.all(middle < self.high + FARTHEST))

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

    def _view(self) -> tuple[float, float, np.ndarray]:
        """Elevation and azimuth [degrees] from which the tool's way is least hidden and most spread out, and the direction."""
        best = None
        solids = [s for s in self.problem.obstacles if not isinstance(s, HalfSpace)]
        points, times = self.way[::16], self.fine[::16]
        for elevation, azimuth in product((22.0, 32.0), range(-170, 180, 20)):
            a, e = np.radians(azimuth), np.radians(elevation)
            eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
            rays = points[:, None] + np.linspace(0.03, 1.2, 24)[:, None] * eye
            hidden = np.zeros(rays.shape[:2], bool)
            for shape in solids:
                hidden |= (shape.distance(rays.reshape(-1, 3), np.repeat(times, 24)) < 0).reshape(hidden.shape)
            flat = self.way - (self.way @ eye)[:, None] * eye
            spread = np.sqrt(np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)[:2].prod() / len(flat))
            body = 0.5 * (self.low + self.high) - self.way.mean(axis=0)
            score = spread - 1.0 * hidden.any(axis=1).mean() - 0.1 * (body @ eye)
            if best is None or score > best[0]:
                best = (score, elevation, float(azimuth), eye)
        return best[1:]

    def _ground(self, ax: Axes3D) -> None:
        low, high = GRID * np.floor(self.low[:2] / GRID), GRID * np.ceil(self.high[:2] / GRID)
        z = self.low[2]
        lines = [[(x, low[1], z), (x, high[1], z)] for x in np.arange(low[0], high[0] + 0.5 * GRID, GRID)]
        lines += [[(low[0], y, z), (high[0], y, z)] for y in np.arange(low[1], high[1] + 0.5 * GRID, GRID)]
        ax.add_collection3d(Line3DCollection(lines, colors=look.RULE, linewidths=0.7, zorder=1, clip_on=False), autolim=False)

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
            shown = [p for p in last[number].polygons if self._near(p)]
            if shown:
                corners = np.concatenate(shown)
                top = np.append(corners[:, :2].mean(axis=0), corners[:, 2].max() + 0.02)
                self._word(ax, top, look.fitted(names[number]), color=NAME, fontsize=8)

    def _word(self, ax: Axes3D, place: np.ndarray, words: str, **font) -> None:
        halo = [Stroke(linewidth=2.5, foreground=look.PAPER), Normal()]
        ax.text(*place, words, ha="center", zorder=6, path_effects=halo, **font)

    def _frame(self, ax: Axes3D) -> None:
        ax.set_proj_type("ortho")
        ax.view_init(self.elevation, self.azimuth)
        size = self.high - self.low
        ax.set(xlim=(self.low[0], self.high[0]), ylim=(self.low[1], self.high[1]), zlim=(self.low[2], self.high[2]))
        ax.set_box_aspect(size)
        ax.set_axis_off()


def _fill(ax: Axes3D, points: np.ndarray) -> None:
    """Scale and move the panel so that the points, shape (N, 3), fill the figure."""
    size, shape = ax.figure.bbox.size, np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
    left, lower, right, upper = FILLED
    low, high = _on_page(ax, points)
    zoom = float(np.min(np.array([right - left, upper - lower]) * size / (high - low)))
    ax.set_box_aspect(shape, zoom=zoom)
    low, high = _on_page(ax, points)
    shift = np.array([left + right, lower + upper]) / 2 - (low + high) / 2 / size
    place = ax.get_position(original=True)
    ax.set_position((place.x0 + shift[0], place.y0 + shift[1], place.width, place.height))


def _on_page(ax: Axes3D, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner of the points on the page [pixels]."""
    ax.apply_aspect()
    flat = proj_transform(*points.T, ax.get_proj())
    page = ax.transData.transform(np.column_stack(flat[:2]))
    return page.min(axis=0), page.max(axis=0)


def _time_bar(figure: Figure, plan: Plan) -> None:
    figure.add_artist(Rectangle((0.26, 0.0), 0.42, 0.068, color=look.PAPER, alpha=0.8, linewidth=0, zorder=1))
    place = figure.add_axes((0.34, 0.045, 0.32, 0.014), zorder=2)
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, plan.duration), TIME), cax=place, orientation="horizontal")
    bar.outline.set_visible(False)
    bar.set_ticks([0.0, 0.5 * plan.duration, plan.duration])
    bar.ax.tick_params(length=0, labelsize=8, labelcolor=look.INK, labelfontfamily="DejaVu Sans")
    figure.text(0.33, 0.052, "time [s]", ha="right", va="center", fontsize=8.5, color=look.INK)
    figure.text(0.985, 0.02, f"squares of {GRID:g} m", ha="right", va="bottom", fontsize=8, color=look.QUIET)
