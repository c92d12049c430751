"""Figures of energy and robustness: bars and curves are those of the account and the cases, and everything can be read."""

import io
from dataclasses import replace

import arms
import numpy as np
import pytest
from figure_plans import cycloid_plan
from matplotlib.container import BarContainer

import energyopt as eo
from energyopt.actuators import ActuatorModel, Actuators
from energyopt.plots.over_causes import short_names


@pytest.fixture(scope="module")
def plan():
    return cycloid_plan("panda")


@pytest.fixture(scope="module")
def drives():
    return Actuators([ActuatorModel(100.0, 0.1, 0.4, 0.85, 0.5)] * 7, standby_power=20.0)


def heights(ax, label=None):
    """Heights of the bars of one kind, or of all."""
    bars = [c for c in ax.containers if isinstance(c, BarContainer) and (label is None or c.get_label() == label)]
    return np.concatenate([[bar.get_height() for bar in container] for container in bars])


def test_bars_are_the_joules_of_the_account(plan, drives):
    account = eo.energy_account(plan, actuators=drives)
    joints, steps, power = eo.plot_energy(plan, drives).axes
    for cause in ("gravity", "copper", "gear"):
        np.testing.assert_allclose(heights(joints, cause), np.maximum(account.joules[cause], 0.0))
    values = [value for cause, value in account.totals().items() if value or cause == "kinetic"] + [account.electrical_J]
    np.testing.assert_allclose(heights(steps), values)
    # Every step begins where the one before it ends; the last one, the whole, ends there too.
    bars = [container[0] for container in steps.containers]
    ends = [bar.get_y() + bar.get_height() if value >= 0 else bar.get_y() for bar, value in zip(bars, values, strict=True)]
    assert ends[-1] == pytest.approx(account.electrical_J) == pytest.approx(sum(values[:-1]))
    (supply,) = [line for line in power.get_lines() if line.get_label() == "electrical input"]
    assert np.trapezoid(supply.get_ydata(), supply.get_xdata()) == pytest.approx(account.electrical_J, rel=1e-2)


def test_without_drives_the_figure_says_so_and_shows_mechanical_work(plan):
    figure = eo.plot_energy(plan)
    account = eo.energy_account(plan)
    assert any("drives are unknown" in text.get_text() for text in figure.texts)
    totals = account.totals()
    np.testing.assert_allclose(heights(figure.axes[1]), [totals["kinetic"], totals["gravity"], account.mechanical_J])
    assert not [line for line in figure.axes[2].get_lines() if line.get_label() == "electrical input"]


def test_robustness_shows_every_draw_corner_and_replay(plan):
    found = eo.robustness(plan, (0.0, 2.0), 10.0, samples=40)
    trials = eo.replay_trials(plan, (0.0, 2.0), trials=3, physics_step=1e-3, collisions=False)
    figure = eo.plot_robustness(plan, found, trials)
    energy, torque, tracking, _ = figure.axes
    assert heights(energy).sum() == 40 and heights(tracking).sum() == 3
    at = sorted(line.get_xdata()[0] for line in energy.get_lines())
    assert at == pytest.approx(sorted(r.mechanical_abs_J for r in (found.nominal, *found.corners)))
    shares = [line.get_ydata() for line in torque.get_lines() if line.get_marker() == "D"]
    np.testing.assert_allclose(shares[0], found.nominal.torque_share)
    assert len(eo.plot_robustness(plan, found).axes) == 2


def test_cases_without_spread_and_trials_that_all_diverge_are_drawn(plan):
    free = replace(plan, problem=replace(plan.problem, torque_limits=np.inf))
    certain = eo.robustness(plan, 1.0, samples=5)
    apart = {"stiffness": 4e5, "damping": 1200.0, "delay": 60, "physics_step": 1e-3, "trials": 1, "collisions": False}
    trials = eo.replay_trials(free, masses=5.0, **apart)
    assert trials.diverged == 1
    eo.plot_robustness(plan, certain, trials).savefig(io.BytesIO(), format="png")
    eo.plot_robustness(plan, eo.robustness(plan, samples=0)).savefig(io.BytesIO(), format="png")


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda plan: eo.plot_energy(plan.problem), r"expected an energyopt\.Plan"),
        (lambda plan: eo.plot_energy(plan, "strong"), "energy_account: .*actuators"),
        (lambda plan: eo.plot_robustness(plan, None), r"found is None: expected what energyopt\.robustness gives"),
        (
            lambda plan: eo.plot_robustness(plan, eo.robustness(plan, samples=1), 5),
            "trials is 5: expected",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused(plan, draw, words):
    with pytest.raises(eo.InputError, match=words):
        draw(plan)


def test_joint_names_lose_what_all_begin_with_and_no_more():
    assert short_names(("panda_joint1", "panda_joint2")) == ["joint1", "joint2"]
    assert short_names(("arm/shoulder", "arm/elbow_of_considerable_length")) == ["shoulder", "elbow_of_consi…"]
    assert short_names(("one",)) == ["one"]
    assert short_names(arms.catalogue_robot("ur5").joint_names)[:3] == ["shoulder_pan", "shoulder_lift", "elbow"]
