"""Moves that share a cycle time."""

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.errors import ProblemError
from energyopt.parameterizations import BSpline
from energyopt.sequence import plan_sequence

KNOTS = BSpline(control_points=14, accuracy=None)
STOPS = np.array([0.0, 1.0, 0.5, 0.3])


def slides(duration=(0.05, 20.0)):
    slider = arms.sliders(1)
    ways = zip(STOPS[:-1], STOPS[1:], strict=True)
    return [eo.Problem(slider, [a], [b], duration=duration, velocity_weight=0.0) for a, b in ways]


@pytest.fixture(scope="module")
def shared():
    return plan_sequence(slides(), 3.0, [0.1, 0.2, 0.0], KNOTS)


def test_sliders_share_the_time_as_the_roots_of_their_ways(shared):
    """Σ c d²/T³ is least for a given ΣT where d²/T⁴ is the same for all."""
    ways = np.abs(np.diff(STOPS)) ** 0.5
    np.testing.assert_allclose(shared.durations, 2.7 * ways / ways.sum(), rtol=1e-2)
    assert shared.cycle_time == pytest.approx(3.0, rel=1e-9)
    np.testing.assert_allclose(shared.waits, [0.1, 0.2, 0.0], atol=1e-9)


def test_the_price_is_what_another_second_saves(shared):
    more = plan_sequence(slides(), 3.1, [0.1, 0.2, 0.0], KNOTS)
    assert 10 * (shared.objective - more.objective) == pytest.approx(shared.price, rel=0.15)


def test_the_whole_is_one_continuous_motion(shared):
    t = np.linspace(0.0, 3.0, 3001)
    assert np.max(np.abs(np.diff(shared(t), axis=0))) < 5e-3
    resting = (t > shared.starts[1] - 0.09) & (t < shared.starts[1])
    np.testing.assert_allclose(shared(t[resting]), 1.0, atol=1e-9)
    np.testing.assert_allclose(shared(t[resting], 1), 0.0)
    assert "another second would save" in str(shared)


def test_time_to_spare_is_spent_where_holding_is_cheapest():
    arm = arms.two_link()
    up, down = [0.0, 0.0], [0.4, 0.3]
    holding = [float(np.sum(arm.torque(np.array(q), np.zeros(2), np.zeros(2)) ** 2)) for q in (down, up)]
    moves = [eo.Problem(arm, a, b, duration=(0.3, 1.5)) for a, b in ((up, down), (down, up))]
    found = plan_sequence(moves, 10.0)
    assert found.waits[int(np.argmin(holding))] > 6.9 and np.count_nonzero(found.waits) == 1


def test_a_move_of_given_duration_keeps_it():
    moves = slides()
    moves[1] = moves[1].lasting(0.7)
    found = plan_sequence(moves, 3.0, 0.0, KNOTS)
    assert found.durations[1] == 0.7 and found.cycle_time == pytest.approx(3.0)


@pytest.mark.parametrize(
    "moves, time, dwells, words",
    [
        ([], 3.0, 0.0, "expected a list of problems"),
        (slides()[::-1], 3.0, 0.0, "does not start where moves\\[0\\] ends"),
        (slides(), -1.0, 0.0, "cycle_time is -1.0: expected seconds > 0"),
        (slides(), 3.0, [1.0, 2.0], "dwells is"),
        (slides((1.5, 2.0)), 3.0, 0.0, "take 4.5 s at least"),
        (slides(), 3.0, 1.5, "take 4.65 s at least"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(moves, time, dwells, words):
    with pytest.raises((eo.InputError, ProblemError), match=words):
        plan_sequence(moves, time, dwells)
