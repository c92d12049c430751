"""Stages are timed by one clock: whoever puts another in its place times all of them by it."""

import time

import arms
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.clock import now, timed_by
from energyopt.rescaling import rescale
from energyopt.search_state import Spent

QUICK = eo.BSpline(control_points=12, accuracy=None)


def swing(duration=0.7):
    return eo.Problem(arms.two_link(), [-0.4, 0.6], [0.8, -0.5], duration)


def gate():
    """A swing whose way from start to goal leads past a ball."""
    arm = arms.from_urdf(factory.planar_arm([0.5, 0.4], [2.0, 1.5], velocity=20.0, effort=200.0))
    ball = eo.Sphere(0.05, [0.6, 0.0, 0.75])
    held = (eo.Attached(eo.Sphere(0.05), name="ball"),)
    return eo.Problem(arm, [-0.4, 0.6], [0.8, -0.5], 0.7, obstacles=[ball], attached=held)


def ticking(*readings):
    left = iter(readings)
    return lambda: next(left)


def test_building_inside_of_solving_counts_as_building():
    spent = Spent()
    with timed_by(ticking(100.0, 101.0, 104.0, 110.0)), spent.solving(), spent.building():
        pass
    assert (spent.build_s, spent.solve_s) == (3.0, 7.0)


def test_what_breaks_off_is_counted_and_the_clock_put_back():
    spent = Spent()
    with pytest.raises(KeyError), timed_by(ticking(1.0, 3.5)), spent.solving():
        raise KeyError
    assert spent.solve_s == 2.5
    before = time.perf_counter()
    assert before <= now() <= time.perf_counter()


@pytest.mark.parametrize(
    "made",
    [
        lambda: eo.plan(swing(), eo.BSpline(accuracy=0.01)),
        lambda: eo.plan(swing(duration=(0.6, 0.9)), QUICK),
        lambda: eo.plan(gate(), QUICK),
        lambda: eo.what_if(eo.plan(swing(), QUICK)).solve(mass=0.5),
        lambda: eo.retime([[0.0, 0.0], [0.4, 0.3]], arms.two_link(), 1.0, self_collision=False),
        lambda: rescale(eo.plan(swing(), QUICK), 0.8),
    ],
    ids=["refined", "free duration", "obstacle", "what-if", "retimed", "rescaled"],
)
def test_no_stage_passes_by_a_clock_that_stands_still(made):
    with timed_by(lambda: 5.0):
        plan = made()
    assert plan.solved and set(plan.time_s.values()) == {0.0}
