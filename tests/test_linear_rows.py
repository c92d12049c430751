"""Linear rows: none is lost beside others of another size, and each holds to a small share of its own limit."""

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.parameterizations.bspline import SplineSpace
from energyopt.refinement import shortest_span
from energyopt.transcription.linear import TOLERATED, linear_rows
from energyopt.transcription.program import boundary_states

T = 1.0
KEPT = 1e-6
"""Largest excess, as a share of the limit, that the dense check accepts of a jerk."""


def rows(first_span, **limits):
    """Problem, space with a span of the given length at either end, unknowns, rows."""
    request = eo.Problem(arms.two_link(), [-0.4, 0.6], [1.2, -0.8], T, **limits)
    inner = np.geomspace(first_span, 0.1, 5)
    space = SplineSpace(np.concatenate([[0.0], inner, np.linspace(0.2, 0.8, 7), T - inner[::-1], [T]]), 3)
    unknowns = space.unknowns(*boundary_states(request))
    return request, space, unknowns, linear_rows(request, space, unknowns)


def test_bounds_on_positions_stay_beside_jerk_rows_of_short_spans():
    """On spans of 1e-5 s the entries of jerk rows are 1e15 times those of positions."""
    request, _, unknowns, linear = rows(1e-5, jerk_limits=500.0)
    low, high = linear.x_lower.reshape(unknowns.count, 2), linear.x_upper.reshape(unknowns.count, 2)
    assert np.all(low >= request.limits.lower) and np.all(high <= request.limits.upper)


@pytest.mark.parametrize("key, limit", [("velocity", 4.0), ("acceleration", 900.0), ("jerk", 500.0), ("jerk", 20.0)])
def test_what_the_solver_leaves_of_a_row_is_a_small_share_of_the_limit(key, limit):
    """x goes to where a row is violated by what the solver tolerates; the spline's own derivative says how much that is."""
    order = ("velocity", "acceleration", "jerk").index(key) + 1
    limits = {"velocity_limits": np.inf, f"{key}_limits": limit}
    least = shortest_span(eo.Problem(arms.two_link(), [-0.4, 0.6], [1.2, -0.8], T, **limits))
    _, space, unknowns, linear = rows(least, **limits)
    curve = space.bounding_rows(order)
    touched = {tuple(np.unique(b[b >= 0])): r for r in range(curve.count) for b in [unknowns.block[curve.column[curve.row == r]]]}
    assert len(linear.lower) >= 20
    for r in range(len(linear.lower)):
        entries = slice(linear.start[r], linear.start[r + 1])
        column, value = linear.column[entries], linear.value[entries]
        x = np.zeros(unknowns.count * 2)
        x[column] = value * (linear.upper[r] + TOLERATED - linear.offset[r]) / (value @ value)
        derivative = curve @ (unknowns.offset + np.vstack([x.reshape(-1, 2), np.zeros((1, 2))])[unknowns.block])
        excess = derivative[touched[tuple(np.unique(column // 2))], column[0] % 2] - limit
        assert -5e-3 * limit < excess < KEPT * limit
