"""The energy–time curve of a problem."""

import json
from dataclasses import replace

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.parameterizations import BSpline
from energyopt.sweep_files import write_sweep


@pytest.fixture(scope="module")
def slide():
    problem = eo.Problem(arms.sliders(1), [0.0], [1.0], duration=1.0, velocity_weight=0.0)
    return eo.sweep(problem, np.linspace(0.5, 2.0, 7)[::-1], BSpline(accuracy=1e-3))


def test_a_slider_costs_as_the_inverse_cube_of_its_time(slide):
    np.testing.assert_allclose(slide.curve() * slide.durations**3, slide.curve()[0] * 0.125, rtol=1e-3)
    assert slide.durations.tolist() == sorted(slide.durations) and slide.recommended == pytest.approx(2.0, rel=1e-6)
    assert "a longer one may be cheaper still" in str(slide)
    quintic = slide.baseline_curve("quintic")
    np.testing.assert_allclose(quintic / slide.curve(), 120 / 7 / 12, rtol=2e-3)


def test_every_point_is_what_a_plan_of_its_own_finds():
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=1.0)
    curve = eo.sweep(problem, [0.6, 0.9, 1.2, 1.5])
    for point in curve.points:
        own = eo.plan(problem.lasting(point.duration))
        assert point.solved and point.plan.objective <= own.objective * 1.015
    assert curve.best.objective <= np.nanmin(curve.curve()) * (1 + 1e-9)


def test_two_processes_give_the_same_curve(monkeypatch):
    monkeypatch.setattr("energyopt.following.WORTH_PROCESSES", 0.0)
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=1.0)
    one, two = (eo.sweep(problem, [0.6, 0.9, 1.2], processes=n) for n in (1, 2))
    np.testing.assert_array_equal(one.curve(), two.curve())


@pytest.mark.parametrize("told", ["by its status", "by an exception"])
def test_ctrl_c_ends_a_sweep_and_keeps_what_there_is(monkeypatch, told, tmp_path):
    from energyopt import following

    planned, calls = following.planned, []

    def interrupted(*arguments, **options):
        calls.append(arguments)
        if len(calls) == 3 and told == "by an exception":
            raise KeyboardInterrupt
        plan, search = planned(*arguments, **options)
        return (replace(plan, status=eo.Status.INTERRUPTED, message="interrupted") if len(calls) == 3 else plan), search

    monkeypatch.setattr(following, "planned", interrupted)
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=1.0)
    curve = eo.sweep(problem, [0.6, 0.9, 1.2, 1.5, 1.8], eo.BSpline(accuracy=None), starts=1)
    assert curve.interrupted and len(calls) == 3
    assert [point.solved for point in curve.points] == [False, True, True, False, False]
    assert curve.best is min((point.plan for point in curve.points if point.solved), key=lambda plan: plan.objective)
    assert str(curve).count("INTERRUPTED: interrupted") == 3 and "IMPOSSIBLE" not in str(curve)
    files = write_sweep(curve, tmp_path, figures=True)
    assert json.loads(files[1].read_text())["interrupted"] is True
    calls[:] = [None, None]
    with pytest.raises(KeyboardInterrupt):
        eo.sweep(problem, [0.6, 0.9], eo.BSpline(accuracy=None), starts=1)


@pytest.mark.parametrize("processes", ["x", 0, -5, 1.5, True])
def test_processes_are_a_whole_number(processes):
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=1.0)
    with pytest.raises(eo.InputError, match="sweep: processes is"):
        eo.sweep(problem, [0.6, 0.9], processes=processes)


def test_durations_that_are_impossible_say_so_and_the_others_are_planned():
    problem = eo.Problem(arms.sliders(1), [0.0], [1.0], duration=1.0, velocity_limits=2.0)
    curve = eo.sweep(problem, [0.3, 0.8, 1.2])
    assert [point.solved for point in curve.points] == [False, True, True]
    assert "needs at least 0.5 s" in curve.points[0].why and np.isnan(curve.curve()[0])
    assert "IMPOSSIBLE" in str(curve)
    with pytest.raises(eo.EnergyOptError, match=r"needs at least 0\.5 s"):
        eo.sweep(problem, [0.2, 0.3])


def test_files_hold_the_curve(slide, tmp_path):
    files = write_sweep(slide, tmp_path / "out")
    assert [path.name for path in files] == ["sweep.csv", "sweep.json", "sweep.png"]
    content = json.loads(files[1].read_text())
    assert [row["duration_s"] for row in content["points"]] == slide.durations.tolist()
    assert files[0].read_text().splitlines()[0].startswith("duration_s,status,objective")
    assert files[2].read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize("durations", [[], [-1.0], "fast", [np.nan], [0.0]])
def test_durations_that_make_no_sense_are_refused(durations):
    problem = eo.Problem(arms.sliders(1), [0.0], [1.0], duration=1.0)
    with pytest.raises(eo.InputError, match="sweep: durations"):
        eo.sweep(problem, durations)
