"""Figures: the curves are the right ones, the limits are drawn where they are, and everything can be read."""

import io
import itertools
import os
import subprocess
import sys
from dataclasses import replace

import arms
import matplotlib as mpl
import numpy as np
import pytest
from figure_plans import around, cycloid_plan, replayed, slider_plan
from matplotlib.backends.backend_agg import FigureCanvasAgg

import energyopt as eo
from energyopt.errors import InputError
from energyopt.metrics import metrics, metrics_of_log
from energyopt.plots import look
from energyopt.plots.over_time import SPIKE


def curve(ax, words):
    """Data of the one line whose legend text begins with ``words``."""
    (line,) = [line for line in ax.get_lines() if line.get_label().startswith(words)]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def test_the_cycloid_is_drawn_with_its_closed_form():
    """‖q̇‖ = ‖Δ‖ (1 − cos 2πs)/T and ‖q̈‖ = ‖Δ‖ 2π |sin 2πs|/T² (1e-12: the same formula up to rounding)."""
    plan = cycloid_plan("panda")
    figure = eo.plot_metrics(plan)
    _, acceleration, _, velocity = figure.axes
    distance, T = np.linalg.norm(plan.problem.goal - plan.problem.start), plan.duration
    t, speed = curve(velocity, "planned")
    np.testing.assert_allclose(speed, distance * (1 - np.cos(2 * np.pi * t / T)) / T, atol=1e-12 * distance)
    t, size = curve(acceleration, "planned")
    np.testing.assert_allclose(size, distance * 2 * np.pi * np.abs(np.sin(2 * np.pi * t / T)) / T**2, atol=1e-11)


def test_the_quintic_beside_it_is_the_minimum_jerk_motion_of_the_same_duration():
    """‖q̇‖ = ‖Δ‖ 30 s²(1 − s)²/T."""
    plan = cycloid_plan("panda")
    t, speed = curve(eo.plot_metrics(plan).axes[3], "quintic")
    s, distance = t / plan.duration, np.linalg.norm(plan.problem.goal - plan.problem.start)
    assert t[0] == 0 and t[-1] == plan.duration
    np.testing.assert_allclose(speed, distance * 30 * s**2 * (1 - s) ** 2 / plan.duration, atol=1e-11)


def test_energy_curves_end_at_the_metrics_and_the_legend_states_them():
    plan, log = cycloid_plan("panda"), replayed("panda")
    figure = eo.plot_metrics(plan, log)
    energy = figure.axes[2]
    expected = {"planned": metrics(plan.problem, plan.trajectory), "replayed": metrics_of_log(log)}
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    for (words, numbers), text in zip(expected.items(), texts, strict=False):
        _, joules = curve(energy, words)
        assert joules[-1] == pytest.approx(numbers.mechanical_abs_J, rel=1e-9)
        assert text.startswith(words) and f"{numbers.mechanical_abs_J:.3g} J" in text
    assert f"objective {plan.objective:.4g}" in texts[0]
    assert len(texts) == 3 and texts[2].startswith("quintic")


def test_power_integrates_to_the_energy_beside_it():
    """Trapezoidal sum of the drawn power, 1e-3: the curves are drawn with fewer points than are integrated."""
    power, _, energy, _ = eo.plot_metrics(cycloid_plan("panda")).axes
    t, watts = curve(power, "planned")
    assert np.trapezoid(watts, t) == pytest.approx(curve(energy, "planned")[1][-1], rel=1e-3)


@pytest.mark.parametrize("name", ["ur5", "panda", "baxter"])
def test_limits_are_drawn_at_the_limits_of_the_robot(name):
    plan = cycloid_plan(name)
    limits, nv = plan.problem.limits, plan.problem.robot.nv
    figure = eo.plot_joints(plan)
    bounds = [(limits.lower, limits.upper), (-limits.velocity, limits.velocity), (-limits.torque, limits.torque)]
    assert len(figure.axes) == 3 * nv
    for i, k in itertools.product(range(nv), range(3)):
        ax, (lower, upper) = figure.axes[3 * i + k], bounds[k]
        lines = sorted(line.get_ydata()[0] for line in ax.get_lines() if line.get_color() == look.LIMIT)
        words = [text.get_text() for text in ax.texts]
        assert lines == [lower[i], upper[i]] or (lines == [] and words[0].startswith("limits"))
        if lines:
            low, high = ax.get_ylim()
            assert low < lower[i] and high > upper[i]


def test_a_limit_far_off_is_stated_in_words():
    robot = arms.pendulum()
    wide = robot.with_limits(torque=np.array([5000.0]))
    problem = eo.Problem(wide, [0.0], [0.1], 2.0)
    torque = eo.plot_joints(around(problem, eo.baseline(problem))).axes[2]
    assert [text.get_text() for text in torque.texts] == ["limits ±5000"]
    assert np.abs(torque.get_ylim()).max() < 100


def test_a_broken_limit_stays_in_sight_and_is_ringed():
    """A pendulum of 1 rad in 0.2 s has a peak velocity of 1.875 Δ/T = 9.4 rad/s, beyond a limit of 3 rad/s."""
    robot = arms.pendulum().with_limits(velocity=np.array([3.0]))
    problem = eo.Problem(robot, [0.0], [1.0], 0.2)
    plan = around(problem, eo.baseline(problem), eo.Status.LIMITS_VIOLATED)
    figure = eo.plot_joints(plan)
    velocity = figure.axes[1]
    assert velocity.get_ylim()[1] > 1.875 / 0.2
    (ring,) = [line for line in velocity.get_lines() if line.get_marker() == "o"]
    assert ring.get_xdata()[0] == pytest.approx(0.1, abs=1e-3) and ring.get_ydata()[0] == pytest.approx(9.375, rel=1e-3)
    assert "LIMITS_VIOLATED" in figure.texts[0].get_text()


def test_a_spike_is_cut_and_its_height_stated():
    """A trapezoidal motion whose ramps take 1 % of the time: its acceleration is a spike, its velocity is not."""
    from energyopt.baselines import trapezoidal

    problem = eo.Problem(arms.pendulum(), [0.0], [1.0], 1.0)
    motion = trapezoidal(problem, np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), share=0.01)
    _, acceleration, _, velocity = eo.plot_metrics(around(problem, motion), baselines=()).axes
    peak = 1.0 / (0.01 * 0.99)
    assert f"peak {peak:.3g}" in acceleration.texts[0].get_text()
    assert acceleration.get_ylim()[1] < peak / (SPIKE / 2) and not velocity.texts


@pytest.mark.parametrize("name", ["ur5", "panda", "baxter"])
@pytest.mark.parametrize("draw", [eo.plot_metrics, eo.plot_joints])
def test_no_words_leave_the_figure_or_cover_each_other(draw, name):
    """Boxes of all words as drawn: inside the figure, and no two of them overlap by more than a pixel."""
    figure = draw(cycloid_plan(name), replayed(name))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    words = [t for t in figure.findobj(mpl.text.Text) if t.get_text().strip() and t.get_visible()]
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in words]
    width, height = canvas.get_width_height()
    for text, box in boxes:
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width + 1 and box.y1 <= height + 1, text
    for (a, one), (b, two) in itertools.combinations(boxes, 2):
        across = min(one.x1, two.x1) - max(one.x0, two.x0)
        along = min(one.y1, two.y1) - max(one.y0, two.y0)
        assert across < 1 or along < 1, f"{a!r} covers {b!r}"


def _seen_by(colour, kind):
    """CIE Lab of a colour as a dichromat sees it (Viénot, Brettel and Mollon, Color Res. Appl. 24, 1999)."""
    linear = ((np.array(mpl.colors.to_rgb(colour)) + 0.055) / 1.055) ** 2.4
    views = {
        "normal": np.eye(3),
        "protan": [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]],
        "deutan": [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]],
    }
    rgb = np.clip(np.array(views[kind]) @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ rgb
    f = np.cbrt(np.maximum(xyz / [0.9505, 1.0, 1.089], 0.008856))
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("kind", ["normal", "protan", "deutan"])
def test_colours_are_told_apart_without_red_green_vision(kind):
    """ΔE ≥ 20 in CIE Lab between any two of plan, replay, baseline and limit (2.3 is just noticeable), and with the paper."""
    colours = [look.PLANNED, look.REPLAYED, look.BASELINE_COLOURS[0], look.LIMIT, look.PAPER]
    for one, two in itertools.combinations(colours, 2):
        assert np.linalg.norm(_seen_by(one, kind) - _seen_by(two, kind)) > 20, (one, two)


def test_settings_of_the_caller_stay_and_pyplot_is_not_touched():
    code = (
        "import sys, matplotlib as mpl\n"
        "from figure_plans import cycloid_plan\n"
        "import energyopt as eo\n"
        "mpl.rcParams['axes.grid'], mpl.rcParams['font.size'] = False, 17.0\n"
        "settings = lambda: {k: mpl.rcParams[k] for k in mpl.rcParams if k != 'backend'}\n"
        "before = settings()\n"
        "plan = cycloid_plan('ur5')\n"
        "eo.plot_metrics(plan); eo.plot_joints(plan)\n"
        "assert settings() == before\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    paths = os.pathsep.join([os.path.dirname(__file__), *filter(None, sys.path)])
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_look_does_not_depend_on_the_settings_of_the_caller():
    plan = cycloid_plan("ur5")

    def image():
        buffer = io.BytesIO()
        eo.plot_metrics(plan).savefig(buffer, format="png")
        return buffer.getvalue()

    usual = image()
    with mpl.rc_context({"font.size": 19.0, "axes.grid": False, "lines.linewidth": 7.0, "axes.facecolor": "black"}):
        assert image() == usual


def test_names_with_signs_of_mathematics_are_drawn_as_they_are():
    plan = cycloid_plan("ur5")
    named = replace(plan, problem=replace(plan.problem, name="costs $5_0 and \\frac{"))
    figure = eo.plot_metrics(named)
    FigureCanvasAgg(figure).draw()
    assert r"costs \$5_0" in figure.texts[0].get_text()


@pytest.mark.filterwarnings("error")
def test_characters_the_font_lacks_are_boxes_and_no_warning():
    plan = cycloid_plan("ur5")
    figure = eo.plot_metrics(replace(plan, problem=replace(plan.problem, name="机 \x07 Größe")))
    FigureCanvasAgg(figure).draw()  # warnings are errors here
    assert figure.texts[0].get_text().startswith("□ □ Größe · ur5")


def test_sliding_joints_have_metres_on_their_axes():
    figure = eo.plot_joints(slider_plan(arms.sliders(1)))
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["Position q [m]", "Velocity q̇ [m/s]", "Torque τ [N]"]
    mixed = arms.mixed_chain()
    problem = eo.Problem(mixed, np.zeros(3), np.full(3, 0.2), 2.0)
    figure = eo.plot_joints(around(problem, eo.baseline(problem)))
    assert "[rad or m]" in figure.axes[0].get_title(loc="left")
    assert [ax.get_ylabel().split("\n")[1] for ax in figure.axes[::3]] == [
        "[rad, rad/s, N·m]",
        "[m, m/s, N]",
        "[rad, rad/s, N·m]",
    ]


def test_wrong_arguments_are_named():
    plan = cycloid_plan("ur5")
    for draw in (eo.plot_metrics, eo.plot_joints):
        with pytest.raises(InputError, match="a replay of 7 joints; expected 6"):
            draw(plan, replayed("panda"))
        with pytest.raises(InputError, match=r"plan is None: expected an energyopt\.Plan"):
            draw(None)
        with pytest.raises(InputError, match=r"plan is <Problem: .*solve it first"):
            draw(plan.problem)
        with pytest.raises(InputError, match=r"log is 5: expected what energyopt\.replay gives"):
            draw(plan, 5)
    with pytest.raises(InputError, match="'straight' is unknown"):
        eo.plot_metrics(plan, baselines=("straight",))
    with pytest.raises(InputError, match="baselines is 5: expected a list of kinds"):
        eo.plot_metrics(plan, baselines=5)
    with pytest.raises(InputError, match="4 kinds at most"):
        eo.plot_metrics(plan, baselines=("quintic",) * 5)
    assert len(eo.plot_metrics(plan, baselines=()).axes[0].get_lines()) == 1


SILENT = "import os, energyopt.plotting as p, matplotlib; print(os.environ.get('MPLCONFIGDIR'), matplotlib.get_cachedir())"


@pytest.mark.parametrize("own", [True, False])
def test_a_home_that_cannot_be_written_is_no_reason_to_complain(tmp_path, own):
    """Matplotlib would say so in two lines; a folder the user has chosen is used as it is."""
    (tmp_path / "file").write_text("a file is no home, not even for root")
    chosen = {"MPLCONFIGDIR": str(tmp_path / "chosen")} if own else {}
    home = {"HOME": str(tmp_path / "file"), "ENERGYOPT_CACHE": str(tmp_path / "cache")}
    left_out = ("MPLCONFIGDIR", "XDG_CONFIG_HOME", "XDG_CACHE_HOME")
    environment = {key: value for key, value in os.environ.items() if key not in left_out} | home | chosen
    done = subprocess.run(
        [sys.executable, "-c", SILENT], env=environment, capture_output=True, text=True, timeout=120, check=True
    )
    expected = tmp_path / ("chosen" if own else "cache/matplotlib")
    assert done.stdout.split() == [str(expected)] * 2
    assert "temporary" not in done.stderr and "writable" not in done.stderr
