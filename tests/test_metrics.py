"""Metrics against integrals done by hand."""

import json

import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.metrics import metrics
from energyopt.parameterizations.trajectory import PolynomialTrajectory
from energyopt.verification import cost, unweighted_integrals

GRID = 1e-5
"""Trapezoidal sums of kinked powers on 2000 points: relative error h²-like, about 1e-6."""


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    """A unit mass on a horizontal rail: τ = q̈."""
    return eo.load_robot(factory.write(tmp_path_factory.mktemp("one"), factory.sliders(1)))


@pytest.fixture(scope="module")
def panda():
    return eo.load_robot("panda")


def test_energies_of_a_unit_mass_are_its_kinetic_energy_up_and_down_again(slider):
    """It speeds up to 15/8·d/T and stops: Σ∫|τq̇|dt = v², its positive half v²/2."""
    problem = eo.Problem(slider, [0.0], [1.2], 0.8)
    found = metrics(problem, eo.baseline(problem))
    top = 15 / 8 * 1.2 / 0.8
    assert found.mechanical_abs_J == pytest.approx(top**2, rel=GRID)
    assert found.mechanical_positive_J == pytest.approx(top**2 / 2, rel=GRID)
    assert found.peak_speed == pytest.approx(top, rel=GRID)
    assert abs(found.mechanical_abs_J - top**2) < 10 * found.energy_error_J + 1e-9


def test_square_integrals_of_a_cubic_are_the_closed_forms(slider):
    """∫q̈² = 12 d²/T³ and ∫q̇² = 6 d²/(5 T), weighted by w and λ in the cost."""
    problem = eo.Problem(slider, [0.0], [0.7], 1.7, velocity_weight=0.3, torque_weights=2.0)
    motion = eo.baseline(problem, "cubic")
    torque, velocity = 12 * 0.7**2 / 1.7**3, 6 * 0.7**2 / (5 * 1.7)
    plain = {"torque_squared": torque, "velocity_squared": velocity}
    assert unweighted_integrals(problem, motion) == pytest.approx(plain, rel=1e-12)
    assert cost(problem, motion) == pytest.approx({"torque_squared": 2 * torque, "velocity_squared": 0.3 * velocity}, rel=1e-12)
    found = metrics(problem, motion)
    assert (found.torque_squared, found.velocity_squared) == pytest.approx((torque, velocity), rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "figure"),
    [
        ("quintic", -np.log(720 * 64 / 225)),
        ("cubic", -np.log(144 * 4 / 9)),
        ("cycloid", -np.log((2 * np.pi) ** 4 / 2 / 4)),
    ],
)
def test_smoothness_is_the_closed_form_whatever_duration_and_amplitude(slider, kind, figure):
    for move, duration in ((1.0, 1.0), (-0.1, 7.0), (3.0, 0.2)):
        problem = eo.Problem(slider, [0.5], [0.5 + move], duration)
        assert metrics(problem, eo.baseline(problem, kind)).log_dimensionless_jerk == pytest.approx(figure, abs=1e-4)


def test_a_jump_of_acceleration_is_infinite_jerk_and_no_number_in_a_file(slider):
    problem = eo.Problem(slider, [0.0], [1.0], 1.0)
    found = metrics(problem, eo.baseline(problem, "trapezoidal"))
    assert found.jerk.largest == np.inf and found.log_dimensionless_jerk == -np.inf
    assert found.as_dict()["peak_jerk"] is None
    json.dumps(found.as_dict(), allow_nan=False)


def test_standing_still_has_defined_numbers(slider):
    problem = eo.Problem(slider, [0.4], [0.4], 1.0)
    found = metrics(problem, eo.baseline(problem))
    assert found.mechanical_abs_J == pytest.approx(0.0, abs=1e-20) and found.log_dimensionless_jerk is None
    json.dumps(found.as_dict(), allow_nan=False)


def test_peaks_and_rms_of_a_parabola(slider):
    """q = t² on [0, 2]: v from 0 to 4 with mean square 16/3, a = 2."""
    motion = PolynomialTrajectory(np.array([0.0, 2.0]), np.array([[[0.0], [0.0], [1.0]]]))
    found = metrics(slider, motion)
    assert found.velocity.largest == pytest.approx(4.0) and found.velocity.rms_norm == pytest.approx(np.sqrt(16 / 3), rel=GRID)
    assert found.acceleration.largest == pytest.approx(2.0) and found.acceleration.rms_norm == pytest.approx(2.0, rel=GRID)
    assert found.jerk.largest == 0.0


def test_energy_balance_closes_without_friction(panda):
    """∫τᵀq̇ dt is the change of kinetic and potential energy, though every joint's share has another sign."""
    middle = 0.5 * (panda.limits.lower + panda.limits.upper)
    problem = eo.Problem(panda, middle - 0.4, middle + 0.4, 1.2, goal_velocity=0.3)
    motion = eo.baseline(problem)
    series = metrics(panda, motion).series
    work = np.trapezoid(series.joint_power.sum(axis=1), series.t)
    energy = panda.dynamics.energy(motion(np.array([0.0, 1.2])), motion(np.array([0.0, 1.2]), 1))
    assert work == pytest.approx(energy[1] - energy[0], rel=GRID)


def test_friction_takes_what_the_balance_misses(tmp_path):
    robot = eo.load_robot(factory.write(tmp_path, factory.pendulum()), viscous_friction=0.4, coulomb_friction=0.2)
    problem = eo.Problem(robot, [-0.5], [0.8], 1.0)
    motion = eo.baseline(problem)
    series = metrics(robot, motion).series
    work = np.trapezoid(series.joint_power.sum(axis=1), series.t)
    v = motion(series.t, 1)
    lost = np.trapezoid((robot.dynamics.friction(v) * v).sum(axis=1), series.t)
    energy = robot.dynamics.energy(motion(np.array([0.0, 1.0])), motion(np.array([0.0, 1.0]), 1))
    assert work == pytest.approx(energy[1] - energy[0] + lost, rel=GRID)


def test_series_ends_at_the_energy_and_stays_inside_the_motion(panda):
    middle = 0.5 * (panda.limits.lower + panda.limits.upper)
    problem = eo.Problem(panda, middle - 0.4, middle + 0.4, 1.2)
    found = metrics(problem, eo.baseline(problem, "trapezoidal"))
    series = found.series
    assert series.cumulative_energy[-1] == pytest.approx(found.mechanical_abs_J, rel=1e-12)
    assert found.joint_energy_J.sum() == pytest.approx(found.mechanical_abs_J, rel=1e-12)
    assert (series.t[0], series.t[-1]) == (0.0, 1.2) and np.all(np.diff(series.t) >= 0)
    assert np.all(np.diff(series.cumulative_energy) >= 0)


def test_stated_energy_error_bounds_the_true_one(panda):
    middle = 0.5 * (panda.limits.lower + panda.limits.upper)
    problem = eo.Problem(panda, middle - 0.4, middle + 0.4, 1.2)
    motion = eo.baseline(problem)
    coarse, fine = metrics(problem, motion, n=160), metrics(problem, motion, n=8000)
    assert abs(coarse.mechanical_abs_J - fine.mechanical_abs_J) < 5 * coarse.energy_error_J
