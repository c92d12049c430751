"""How much work plans take, counted in iterations and evaluations: a guard that no clock and no other program disturbs."""

import json

import make_effort
import numpy as np
import pytest

REFERENCE = json.loads(make_effort.FILE.read_text())


@pytest.mark.skipif(make_effort.kind() != "compiled", reason="without a C compiler another solver works, with counts of its own")
def test_plans_take_no_more_iterations_and_evaluations_than_they_did():
    now = {name: make_effort.counted(problem, options) for name, problem, options in make_effort.suite()}
    assert make_effort.more(now, REFERENCE) == [], "python tests/make_effort.py renews the reference"


def test_a_quarter_more_of_any_count_is_noticed_and_rounding_is_not():
    rng, reference = np.random.default_rng(0), REFERENCE
    scaled = lambda factor: {name: {key: factor(key) * value for key, value in row.items()} for name, row in reference.items()}
    for key in make_effort.COUNTS:
        (found,) = make_effort.more(scaled(lambda other, key=key: 1.25 if other == key else 1.0), reference)
        assert found.startswith(f"{key}: 25 % more")
    for _ in range(100):
        assert make_effort.more(scaled(lambda key: rng.uniform(0.85, 1.15)), reference) == []


def test_a_single_problem_that_takes_three_times_the_work_is_noticed():
    reference = REFERENCE
    name = "panda_clutter"
    now = {**reference, name: {**reference[name], "hessian": 3 * reference[name]["hessian"]}}
    assert make_effort.more(now, reference) == [f"hessian of {name}: 3.0 times the reference"]


def test_the_reference_covers_the_suite():
    assert list(REFERENCE) == [name for name, _, _ in make_effort.suite()]
    assert all(set(row) == set(make_effort.COUNTS) and min(row.values()) > 0 for row in REFERENCE.values())
