"""Every exported cost term: derivatives against complex steps and differences, smoothing, closed forms, input."""

from dataclasses import replace

import numpy as np
import pytest

import energyopt as eo
from energyopt import costs
from energyopt.actuators import ActuatorModel, Actuators
from energyopt.costs import smoothing
from energyopt.costs.cost import Samples
from energyopt.errors import ProblemError, RobotError
from energyopt.metrics import metrics
from energyopt.parameterizations.trajectory import SplineTrajectory

NV = 3
DRIVES = [
    ActuatorModel(100.0, 0.05, 0.8, efficiency=0.7, regeneration=0.3, brake_power=2.0),
    ActuatorModel(80.0, 0.04, 0.5, efficiency=0.9, regeneration=0.3),
    ActuatorModel(50.0, 0.03, 0.0, efficiency=1.0, regeneration=0.3, brake_power=1.0),
]
SPECIAL = {
    "electrical_energy": [
        {"actuators": Actuators(DRIVES, standby_power=5.0)},
        {"actuators": Actuators(DRIVES, shared_bus=True, standby_power=5.0)},
    ]
}
EVERY = [term(**arguments) for name, term in costs.COSTS.items() for arguments in SPECIAL.get(name, [{}])]
WEIGHTED = [term(weights=[1.0, 0.5, 3.0]) for term in costs.COSTS.values() if "weights" in term.__dataclass_fields__]
each_term = pytest.mark.parametrize("term", EVERY + WEIGHTED, ids=lambda term: term.name)


def samples(count=40, scale=1.0, seed=1, nv=NV):
    """Random motions whose powers lie on both sides of the kinks and on them."""
    rng = np.random.default_rng(seed)
    q, v, a, jerk, tau = (scale * rng.standard_normal((count, nv)) for _ in range(5))
    tau[0], v[1] = 0.0, 0.0
    return Samples(q, v, a, jerk, tau)


def nudged(at, key, joint, step):
    x = getattr(at, key).astype(complex if isinstance(step, complex) else float)
    x[:, joint] += step
    return replace(at, **{key: x})


def second(found, i, j, one, other):
    """∂²φ/∂oneᵢ∂otherⱼ from an `Integrand`, shape (N,)."""
    block = getattr(found, f"{one}_{other}", None)
    if block is None:
        block = getattr(found, f"{other}_{one}", None)
    own = 0.0 if i != j or block is None else block[:, i]
    if found.bus is None or {one, other} - {"tau", "v"}:
        return own
    d = {"tau": found.bus_tau, "v": found.bus_v}
    return own + found.bus * d[one][:, i] * d[other][:, j]


@each_term
@pytest.mark.parametrize("scale", [0.3, 1.5])
def test_first_derivatives_agree_with_complex_steps(term, scale):
    at, h = samples(scale=scale), 1e-30
    found = term.integrand(at, 1)
    for key in ("v", "a", "jerk", "tau"):
        given = getattr(found, key)
        assert (given is not None) == (key in term.uses)
        for joint in range(NV):
            oracle = term.integrand(nudged(at, key, joint, 1j * h)).value.imag / h
            own = 0.0 if given is None else given[:, joint]
            # A complex step has no truncation error: what is left is rounding.
            np.testing.assert_allclose(own, oracle, rtol=1e-11, atol=1e-12)


@each_term
@pytest.mark.parametrize("scale", [0.3, 1.5])
def test_second_derivatives_agree_with_complex_steps_of_the_first(term, scale):
    at, h = samples(scale=scale), 1e-30
    found = term.integrand(at, 2)
    for other in ("v", "a", "jerk", "tau"):
        for j in range(NV):
            step = term.integrand(nudged(at, other, j, 1j * h), 1)
            for one in ("v", "a", "jerk", "tau"):
                for i in range(NV):
                    oracle = 0.0 if getattr(step, one) is None else getattr(step, one)[:, i].imag / h
                    np.testing.assert_allclose(second(found, i, j, one, other) + np.zeros(40), oracle, rtol=1e-10, atol=1e-10)


@each_term
def test_terms_are_finite_with_their_derivatives_at_powers_far_from_any_kink(term):
    found = term.integrand(samples(scale=1e4), 2)
    arrays = [x for x in vars(found).values() if x is not None]
    assert all(np.isfinite(x).all() for x in arrays)


@each_term
def test_smooth_and_exact_agree_away_from_the_kinks_and_at_rest(term):
    rng = np.random.default_rng(2)
    sign = rng.choice([-1.0, 1.0], (50, NV))
    tau, v = sign * rng.uniform(8, 20, (50, NV)), rng.choice([-1.0, 1.0], (50, NV)) * rng.uniform(2, 3, (50, NV))
    far = Samples(tau, v, v, v, tau)
    far = far if term.name != "electrical_energy" else _away_from_zero_supply(term, far)
    # |P| ≥ 16 W is 80 widths: what is left of 1 − tanh lies below rounding.
    np.testing.assert_allclose(term.integrand(far).value, term.exact(far), rtol=1e-12)
    still = replace(far, v=np.zeros_like(far.v), a=np.zeros_like(far.v), jerk=np.zeros_like(far.v))
    np.testing.assert_allclose(term.integrand(still).value, term.exact(still), rtol=1e-2)


def _away_from_zero_supply(term, at):
    """The samples at which no electrical power, and no sum of them, lies near zero."""
    electrical = term.actuators.flow(at.tau, at.v).electrical
    keep = (np.abs(electrical).min(axis=1) > 10) & (np.abs(electrical.sum(axis=1)) > 10)
    assert keep.sum() > 20
    return Samples(*(x[keep] for x in (at.q, at.v, at.a, at.jerk, at.tau)))


@pytest.mark.parametrize("width", [0.01, 0.5, 4.0])
def test_smoothing_takes_away_no_more_than_its_stated_share(width):
    x = np.linspace(-10 * width, 10 * width, 200_001)
    lost = np.abs(x) - smoothing.smooth_abs(x, width)[0]
    assert lost.min() >= -1e-15
    np.testing.assert_allclose(lost.max(), smoothing.WORST_SHARE * width, rtol=1e-6)  # grid of 1e-4 widths
    half = np.maximum(x, 0) - smoothing.smooth_positive(x, width)[0]
    np.testing.assert_allclose(half.max(), 0.5 * lost.max(), rtol=1e-12)


@pytest.mark.parametrize("name", ["mechanical_power", "positive_power"])
def test_smoothing_error_of_a_power_stays_within_its_bound(name):
    share = {"mechanical_power": 1.0, "positive_power": 0.5}[name]
    term = costs.COSTS[name](smoothing=0.2)
    at = samples(500, seed=3)
    lost = term.exact(at) - term.integrand(at).value
    assert lost.min() >= 0 and lost.max() <= share * smoothing.WORST_SHARE * 0.2 * NV


@pytest.mark.parametrize("shared", [False, True])
def test_smoothing_error_of_electrical_energy_without_resistance_stays_within_its_bound(shared):
    eta, rho, width = 0.8, 0.4, 0.3
    drives = Actuators([ActuatorModel(10, 1, 0, efficiency=eta, regeneration=rho)] * NV, shared_bus=shared)
    term = costs.ElectricalEnergy(drives, smoothing=width)
    at = samples(500, seed=4)
    bound = (NV * -np.log(eta) / eta + (1 - rho) / 2 * (1 if shared else NV)) * smoothing.WORST_SHARE * width
    assert np.abs(term.exact(at) - term.integrand(at).value).max() <= bound


@each_term
def test_a_narrower_smoothing_comes_closer_to_the_exact_term(term):
    if "smoothing" not in term.__dataclass_fields__:
        assert np.array_equal(term.exact(samples()), term.integrand(samples()).value)
        return
    at = samples(2000, seed=5)
    errors = [np.abs(term.exact(at) - replace(term, smoothing=w).integrand(at).value).mean() for w in (0.4, 0.04, 0.004)]
    assert errors[2] < 0.3 * errors[1] < 0.09 * errors[0]


def test_holding_a_torque_costs_what_the_winding_burns_and_the_brakes_and_standby_draw():
    drives = Actuators([ActuatorModel(100.0, 0.05, 0.8, efficiency=0.7, brake_power=2.0)], standby_power=7.0)
    tau, still = np.full((1, 1), 30.0), np.zeros((1, 1))
    expected = 0.8 * (30.0 / (0.05 * 100.0)) ** 2 + 9.0
    at = Samples(still, still, still, still, tau)
    term = costs.ElectricalEnergy(drives)
    assert term.exact(at)[0] == pytest.approx(expected, rel=1e-14)
    # κτ² lies 144 widths above zero: smoothing has no part in it.
    assert term.integrand(at).value[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("direction, factor", [(1.0, 1 / 0.8), (-1.0, 0.8)])
def test_the_gear_divides_by_its_efficiency_when_driving_and_multiplies_when_driven(direction, factor):
    drives = Actuators([ActuatorModel(50.0, 0.1, 0.3, efficiency=0.8, regeneration=1.0)])
    tau, v = np.array([[20.0]]), np.array([[2.0 * direction]])
    tau_m = 20.0 * factor / 50.0
    assert drives.motor_torque(tau, v)[0, 0] == pytest.approx(tau_m, rel=1e-14)
    supply = tau_m * 50.0 * v[0, 0] + 0.3 * (tau_m / 0.1) ** 2
    assert drives.flow(tau, v).supply[0] == pytest.approx(supply, rel=1e-14)
    at = Samples(v, v, v, v, tau)
    assert costs.ElectricalEnergy(drives).integrand(at).value[0] == pytest.approx(supply, rel=1e-12)


def test_power_flow_adds_up_and_no_loss_is_negative():
    at = samples(300, scale=5.0, seed=6)
    for shared in (False, True):
        flow = Actuators(DRIVES, shared_bus=shared, standby_power=5.0).flow(at.tau, at.v)
        parts = flow.mechanical + flow.gear_loss + flow.copper_loss
        np.testing.assert_allclose(parts, flow.electrical, rtol=1e-12)
        np.testing.assert_allclose(flow.electrical.sum(1) + flow.burnt.sum(1) + 8.0, flow.supply, rtol=1e-12)
        assert min(flow.gear_loss.min(), flow.copper_loss.min(), flow.burnt.min()) >= 0


def test_a_shared_bus_never_costs_more_than_drives_on_their_own():
    at = samples(300, scale=5.0, seed=7)
    own, shared = (Actuators(DRIVES, shared_bus=s).flow(at.tau, at.v).supply for s in (False, True))
    assert np.all(shared <= own + 1e-12) and np.any(shared < own - 1.0)


def test_a_lossless_drive_that_returns_all_braking_power_needs_nothing_over_a_closed_cycle():
    robot = eo.load_robot("ur5", actuators=ActuatorModel(100.0, 0.1, 0.0, regeneration=1.0))
    cycle = closed_cycle(robot)
    net = costs.integral(costs.ElectricalEnergy(), robot, cycle)
    moved = costs.integral(costs.MechanicalPower(), robot, cycle, exact=True)
    assert moved > 10.0 and abs(net) < 1e-9 * moved
    lossy = eo.load_robot("ur5", actuators=ActuatorModel(100.0, 0.1, 0.0, regeneration=0.0))
    burnt = costs.integral(costs.ElectricalEnergy(), lossy, cycle, exact=True)
    assert burnt == pytest.approx(costs.integral(costs.PositivePower(), robot, cycle, exact=True), rel=1e-12)


def closed_cycle(robot):
    """There and back between two rests."""
    rng = np.random.default_rng(8)
    inner = robot.home + 0.8 * rng.standard_normal((8, robot.nv))
    points = np.vstack([[robot.home] * 3, inner, [robot.home] * 3])
    knots = np.concatenate([np.zeros(3), np.linspace(0, 2.0, len(points) - 2), np.full(3, 2.0)])
    return SplineTrajectory(knots, points, 3)


def test_smoothing_error_is_the_exact_integral_less_the_smooth_one():
    robot = eo.load_robot("ur5", actuators=ActuatorModel(100.0, 0.1, 0.2, efficiency=0.8, regeneration=0.3))
    cycle = closed_cycle(robot)
    for term in (costs.MechanicalPower(smoothing=1.0), costs.PositivePower(smoothing=1.0), costs.ElectricalEnergy(smoothing=1.0)):
        gap = costs.integral(term, robot, cycle, exact=True) - costs.integral(term, robot, cycle)
        error = costs.smoothing_error(term, robot, cycle)
        assert error == pytest.approx(gap, abs=1e-10) and error != 0
    power = costs.smoothing_error(costs.MechanicalPower(smoothing=1.0), robot, cycle)
    assert 0 < power < smoothing.WORST_SHARE * 1.0 * robot.nv * cycle.duration
    assert costs.smoothing_error(costs.TorqueSquared(), robot, cycle) == 0


def test_the_mechanical_terms_are_the_metrics_of_the_motion():
    robot = eo.load_robot("ur5")
    cycle = closed_cycle(robot)
    found = metrics(robot, cycle)
    for name, own in (("mechanical_abs_J", costs.MechanicalPower()), ("mechanical_positive_J", costs.PositivePower())):
        value = costs.integral(own, robot, cycle, exact=True)
        assert value == pytest.approx(getattr(found, name), abs=max(1e-3 * value, 2 * found.energy_error_J))
    # Torques are no polynomials of time: the two quadratures differ by 7e-9 on this motion.
    assert costs.integral(costs.TorqueSquared(), robot, cycle) == pytest.approx(found.torque_squared, rel=1e-7)
    assert costs.integral(costs.VelocitySquared(), robot, cycle) == pytest.approx(found.velocity_squared, rel=1e-9)


def test_a_factor_multiplies_the_weight_whatever_kind_of_number_it_is():
    term = 0.5 * costs.TorqueSquared(weight=3.0)
    assert isinstance(term, costs.TorqueSquared) and term.weight == 1.5
    assert (np.float64(2) * term).weight == 3.0
    with pytest.raises(TypeError):
        "2" * term


BAD_TERMS = [
    (lambda: costs.TorqueSquared(weight=-1), "torque_squared: weight is -1"),
    (lambda: costs.TorqueSquared(weight=float("nan")), "torque_squared: weight is nan"),
    (lambda: costs.TorqueSquared(weight="much"), "torque_squared: weight is 'much'"),
    (lambda: -2 * costs.TorqueSquared(), "torque_squared: factor is -2"),
    (lambda: costs.VelocitySquared([1, -1]), "velocity_squared: weights is -1"),
    (lambda: costs.VelocitySquared([[1, 1]]), "velocity_squared: weights is an array of shape (1, 2)"),
    (lambda: costs.JerkSquared("all"), "jerk_squared: weights is 'all'"),
    (lambda: costs.MechanicalPower(smoothing=0), "mechanical_power: smoothing is 0"),
    (lambda: costs.PositivePower(smoothing=None), "positive_power: smoothing is None"),
    (lambda: costs.ElectricalEnergy([1.0]), "electrical_energy: actuators is [1.0]"),
]


@pytest.mark.parametrize("make, message", BAD_TERMS)
def test_bad_terms_are_refused_in_one_line(make, message):
    with pytest.raises(ProblemError) as error:
        make()
    assert str(error.value).startswith(message) and "expected" in str(error.value) and "\n" not in str(error.value)


def test_terms_that_do_not_fit_the_robot_are_refused():
    robot = eo.load_robot("ur5")
    cases = [
        (costs.TorqueSquared([1.0, 2.0]), "torque_squared: weights: expected 6 numbers, one for each of shoulder_pan_joint"),
        (costs.ElectricalEnergy(), "electrical_energy: ur5 has no actuator models: give them"),
        (costs.ElectricalEnergy(Actuators(DRIVES)), "electrical_energy: actuators has 3 models: expected 6"),
        ([costs.TorqueSquared(), costs.TorqueSquared()], "costs[1] is a second torque_squared"),
        (
            [0.0 * costs.TorqueSquared(), costs.VelocitySquared(0)],
            "costs: the weights of torque_squared, velocity_squared are all",
        ),
        ([], "costs: there is none"),
        ("energy", "costs is 'energy'"),
        ([costs.TorqueSquared], "costs[0] is"),
    ]
    for given, message in cases:
        with pytest.raises(ProblemError) as error:
            costs.checked_costs(given, robot)
        assert str(error.value).startswith(message) and "\n" not in str(error.value)
    fitted = costs.checked_costs(costs.TorqueSquared(2.0), robot)
    assert fitted[0].weights.shape == (6,)


BAD_DRIVES = [
    (lambda: ActuatorModel(0, 0.1, 1), "actuator: gear_ratio is 0; expected a number above 0"),
    (lambda: ActuatorModel(1, float("inf"), 1), "actuator: torque_constant is inf"),
    (lambda: ActuatorModel(1, 0.1, -1), "actuator: resistance is -1; expected a number from 0"),
    (lambda: ActuatorModel(1, 0.1, 1, efficiency=0), "actuator: efficiency is 0; expected a number above 0, at most 1"),
    (lambda: ActuatorModel(1, 0.1, 1, regeneration=1.5), "actuator: regeneration is 1.5; expected a number from 0 to 1"),
    (lambda: ActuatorModel(1, 0.1, 1, brake_power="on"), "actuator: brake_power is 'on'; expected a number from 0"),
    (lambda: ActuatorModel(True, 0.1, 1), "actuator: gear_ratio is True"),
    (lambda: Actuators([]), "actuators: there is none"),
    (lambda: Actuators([1]), "actuators: entry 0 is 1"),
    (lambda: Actuators("two"), "actuators: entry 0 is 'two'"),
    (lambda: Actuators(DRIVES, shared_bus="yes"), "actuators: shared_bus is 'yes'"),
    (lambda: Actuators(DRIVES, standby_power=-3), "actuators: standby_power is -3"),
    (lambda: Actuators(DRIVES, source=3), "actuators: source is 3"),
    (
        lambda: Actuators([DRIVES[0], replace(DRIVES[1], regeneration=0.5)], shared_bus=True),
        "actuators: regeneration is 0.3, 0.5 on one shared bus",
    ),
    (lambda: eo.load_robot("ur5", actuators=DRIVES), "ur5: actuators has 3 models; expected 6, for shoulder_pan_joint"),
    (lambda: eo.load_robot("ur5", actuators={"elbow": DRIVES[0]}), "ur5: actuators: no moving joint named 'elbow'"),
    (lambda: eo.load_robot("ur5", actuators={"elbow_joint": DRIVES[0]}), "ur5: actuators: joint 'shoulder_pan_joint' has none"),
    (lambda: eo.load_robot("ur5", actuators=3), "ur5: actuators: entry 0 is 3"),
]


@pytest.mark.parametrize("make, message", BAD_DRIVES)
def test_bad_drives_are_refused_in_one_line(make, message):
    with pytest.raises(RobotError) as error:
        make()
    assert str(error.value).startswith(message) and "expected" in str(error.value) and "\n" not in str(error.value)


def test_a_robot_takes_its_drives_in_any_of_four_forms():
    one = DRIVES[0]
    names = eo.load_robot("ur5").joint_names
    for given in (one, [one] * 6, dict.fromkeys(names, one), Actuators([one] * 6)):
        robot = eo.load_robot("ur5", actuators=given)
        assert robot.actuators.models == (one,) * 6
    assert eo.load_robot("ur5").actuators is None


def test_the_formula_names_every_term_with_its_weight():
    terms = [costs.ElectricalEnergy(), 0.01 * costs.TorqueSquared(), costs.JerkSquared([1.0, 2.0], weight=2e-5)]
    assert costs.formula(terms) == "∫(supply power + 0.01 Στ² + 2e-05 Σw(d³q/dt³)²)dt"
    assert all(costs.formula([term()]) == f"∫({term.symbol})dt" for term in costs.COSTS.values())
