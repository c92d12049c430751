"""Figures of clearance and scene: the curves are exact distances, the solids are where they are, and everything can be read."""

from dataclasses import replace

import arms
import matplotlib as mpl
import numpy as np
import pytest
import urdf_factory as factory
from figure_plans import around
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import energyopt as eo
from energyopt.errors import InputError
from energyopt.geometry.exact import CollisionScene
from energyopt.plots.over_distance import COLOURS, ITSELF
from energyopt.plots.solids import faces_of, same_length
from energyopt.report import report_page

HOME = np.array([0, -0.7, 0, -2.3, 0, 1.6, 0.8])


def shapes():
    return [
        eo.Box((0.3, 0.3, 0.3), (0.6, 0.45, 0.3), name="crate $x$"),
        eo.Sphere(0.05, eo.Moving((0.6, -0.6, 0.7), velocity=(0, 0.2, 0)), name="part"),
        eo.Cylinder(0.05, 0.5, (-0.4, 0.0, 0.25)),
        eo.HalfSpace((0, 0, 1), -0.05, name="floor"),
    ]


@pytest.fixture(scope="module")
def plan():
    robot = arms.catalogue_robot("panda")
    problem = eo.Problem(
        robot, HOME, HOME + [0.5, 0.2, 0, 0.2, 0, 0.1, 0], 1.5, obstacles=shapes(), clearance=0.03, name="clutter"
    )
    return around(problem, eo.baseline(problem))


@pytest.fixture(scope="module")
def log(plan):
    return eo.replay(plan)


def lines(ax):
    return {line.get_label(): np.array(line.get_data()) for line in ax.get_lines() if not line.get_label().startswith("_")}


def test_every_curve_is_the_least_exact_distance_to_its_obstacle(plan):
    drawn = lines(eo.plot_clearance(plan).axes[0])
    q = lambda t: plan.trajectory(t)
    for shape, label in zip(plan.problem.obstacles, (r"crate \$x\$", "part", "cylinder 3", "floor"), strict=True):
        if label in drawn:
            t, millimetres = drawn[label][:, ::40]
            exact = CollisionScene(plan.problem.robot, [shape]).distances(q(t), t).min(axis=1)
            np.testing.assert_allclose(millimetres, 1e3 * exact, atol=5e-3)  # the distance search ends within a few µm
    assert len(drawn) >= 3 and ITSELF in drawn


def test_the_least_distance_is_stated_with_pair_and_time_and_the_clearance_asked_for_is_drawn(plan):
    figure = eo.plot_clearance(plan)
    words = " ".join(text.get_text() for text in figure.axes[0].texts)
    least = min(lines(figure.axes[0]).values(), key=lambda line: line[1].min())
    k = int(np.argmin(least[1]))
    assert (
        f"{least[1][k]:.1f} mm at {least[0][k]:.2f} s" in words and "clearance asked for: 30 mm" in words and "contact" in words
    )


def test_an_overlap_is_below_zero_inside_the_shaded_part_and_contacts_of_the_replay_are_marked(plan):
    block = eo.Box((0.2, 0.2, 0.2), plan.problem.robot.placement("panda_hand", plan.trajectory(0.75)).translation, name="block")
    hit = replace(plan, problem=replace(plan.problem, obstacles=(block,)))
    replayed = eo.replay(hit)
    figure = eo.plot_clearance(hit, replayed)
    drawn = lines(figure.axes[0])
    assert drawn["block"][1].min() < 0 and figure.axes[0].get_ylim()[0] < drawn["block"][1].min()
    marked = drawn["contact in the replay"]
    assert marked[0, 0] == replayed.touches[0].begin
    assert "−" in " ".join(text.get_text() for text in figure.axes[0].texts)


def test_many_obstacles_share_one_grey_entry():
    robot = arms.catalogue_robot("panda")
    around_it = [
        eo.Sphere(0.02, (0.7 * np.cos(a), 0.7 * np.sin(a), 0.5), name=f"ball {k}") for k, a in enumerate(np.linspace(-1, 1, 12))
    ]
    problem = eo.Problem(robot, HOME, HOME + 0.1, 1.0, obstacles=around_it)
    figure = eo.plot_clearance(around(problem, eo.baseline(problem)))
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(texts) == len(COLOURS) + 1 and texts[-1].endswith("more")


def test_nothing_to_keep_clear_of_is_said(tmp_path):
    robot = eo.load_robot(factory.write(tmp_path, factory.pendulum()))
    problem = eo.Problem(robot, [0.0], [1.0], 1.0)
    bare = around(problem, eo.baseline(problem))
    with pytest.raises(InputError, match="nothing to keep clear of"):
        eo.plot_clearance(bare)
    with pytest.raises(InputError, match="nothing to draw"):
        eo.plot_scene(bare)


@pytest.mark.parametrize("poses", [1, 25, 2.5, "six"])
def test_senseless_numbers_of_poses_are_refused(plan, poses):
    with pytest.raises(InputError, match=r"poses is .*expected a whole number from 2 to 24"):
        eo.plot_scene(plan, poses=poses)


def test_the_scene_shows_every_finite_obstacle_by_name_and_the_way_of_the_tool_from_start_to_goal(plan):
    panel = eo.plot_scene(plan).axes[0]
    words = {text.get_text() for text in panel.texts}
    assert {r"crate \$x\$", "part", "cylinder 3", "start", "goal"} <= words and "floor" not in words
    ends = [np.array(line.get_data_3d()).ravel() for line in panel.get_lines() if line.get_marker() == "o"]
    for end, t in zip(ends, (0.0, plan.duration), strict=True):
        robot = plan.problem.robot
        np.testing.assert_allclose(end, robot.placement(robot.tool_frame, plan.trajectory(t)).translation, atol=1e-12)


def test_the_scene_fills_the_page_and_stays_on_it(plan):
    figure = eo.plot_scene(plan)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    painted = np.any(np.asarray(canvas.buffer_rgba())[:, :, :3] < 250, axis=2)
    rows, columns = np.flatnonzero(painted.any(axis=1)), np.flatnonzero(painted.any(axis=0))
    height, width = painted.shape
    assert rows[0] >= 0 and rows[-1] < height and columns[-1] < width
    inside = painted[int(0.1 * height) : int(0.88 * height)]
    assert np.ptp(np.flatnonzero(inside.any(axis=0))) > 0.6 * width or np.ptp(np.flatnonzero(inside.any(axis=1))) > 0.6 * height


def test_the_scene_can_be_drawn_into_a_panel_of_the_callers(plan):
    figure = Figure(figsize=(4, 4))
    ax = figure.add_subplot(projection="3d")
    before = dict(mpl.rcParams)
    assert eo.plot_scene(plan, ax, poses=3) is figure
    assert len(figure.axes) == 1 and ax.collections and dict(mpl.rcParams) == before


@pytest.mark.parametrize("shape", [eo.Sphere(0.2), eo.Box((0.1, 0.2, 0.3)), eo.Capsule(0.1, 0.4), eo.Cylinder(0.1, 0.4)])
def test_faces_lie_on_the_surface_look_outwards_and_have_its_area(shape):
    faces = faces_of(shape)
    corners = np.concatenate(faces.polygons)
    # Enclosing points of round shapes stand out by a few per cent.
    assert np.abs(shape.distance(corners)).max() < 0.12 * shape.bounding_radius
    middles = np.array([polygon.mean(axis=0) for polygon in faces.polygons])
    assert np.all(np.sum(middles * faces.normals, axis=1) > 0)
    volume = sum(_area(p) * (p[0] @ n) / 3 for p, n in zip(faces.polygons, faces.normals, strict=True))
    exact = {
        "sphere": 4 / 3 * np.pi * 0.008,
        "box": 0.006,
        "capsule": np.pi * 0.01 * (0.4 + 0.4 / 3),
        "cylinder": np.pi * 0.01 * 0.4,
    }
    assert volume == pytest.approx(exact[shape.kind], rel=0.2 if shape.kind != "box" else 1e-9)
    cut = faces.cut(0.05)
    assert sum(map(_area, cut.polygons)) == pytest.approx(sum(map(_area, faces.polygons)), rel=1e-9)
    assert same_length(cut.polygons).shape[0] == len(cut.polygons)


def _area(polygon):
    fans = np.cross(polygon[1:-1] - polygon[0], polygon[2:] - polygon[0])
    return 0.5 * np.linalg.norm(fans.sum(axis=0))


def test_the_report_shows_the_scene_inside_the_page_and_only_where_there_is_one(plan, log):
    page = report_page(plan, log, eo.validate(plan, log))
    assert "Among obstacles" in page and 'src="data:image/png;base64,' in page and "How far it stays away" in page
    assert page.count(" src=") == 1
    alone = replace(plan, problem=replace(plan.problem, obstacles=()))
    assert "Among obstacles" not in report_page(alone, log, eo.validate(alone, log))
