"""Where the joules go, against closed forms, energies of states, and a plain dense sum of the drives' power."""

import dataclasses

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.actuators import ActuatorModel, Actuators
from energyopt.simulation import replay_trajectory
from energyopt.validation import validate_motion

CLOSES = 1e-6
"""Share of the energy moved by which work, energies of states and friction may differ; quadrature gives 1e-12."""
IN_SUM = 1e-3
"""Share of the electrical input that its causes may leave unexplained."""


def drives(nv, **options):
    """Drives of unlike joints: every way for power to go is taken."""
    share = options.pop("regeneration", 0.5)
    models = [ActuatorModel(50.0 + 10 * k, 0.1, 0.4, 0.75 + 0.02 * k, share, 0.5) for k in range(nv)]
    return Actuators(models, standby_power=20.0, **options)


def rich_motion(robot, duration=1.3, seed=0):
    """Between two velocities, through two waypoints: powers change sign many times."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(robot.limits.lower, -1.5), np.minimum(robot.limits.upper, 1.5)
    points = rng.uniform(0.8 * low + 0.2 * high, 0.2 * low + 0.8 * high, (4, robot.nv))
    speeds = {"start_velocity": rng.uniform(-0.3, 0.3, robot.nv), "goal_velocity": rng.uniform(-0.3, 0.3, robot.nv)}
    return eo.baseline(eo.Problem(robot, points[0], points[3], duration, waypoints=list(points[1:3]), **speeds), "cubic")


ROBOTS = {
    "panda": lambda: arms.catalogue_robot("panda"),
    "ur5": lambda: arms.catalogue_robot("ur5"),
    "talos_arm": lambda: arms.catalogue_robot("talos_arm"),
    "rubbing_two_link": arms.rubbing_two_link,
    "rubbing_chain": arms.rubbing_chain,
}


@pytest.mark.parametrize("name", ROBOTS)
def test_work_is_change_of_energy_plus_friction(name):
    robot = ROBOTS[name]()
    account = eo.energy_account(rich_motion(robot), robot)
    moved = sum(np.abs(values).sum() for values in account.joules.values())
    assert abs(account.balance_error_J) < CLOSES * moved
    assert account.electrical_J is None and "load_robot(..., actuators=...)" in account.why
    whole = robot.dynamics.energy(*(rich_motion(robot)(np.array([0.0, 1.3]), order) for order in (0, 1)))
    assert account.kinetic_change_J + account.potential_change_J == pytest.approx(np.diff(whole)[0], abs=1e-9)


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("regeneration", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("name", ROBOTS)
def test_causes_add_up_to_the_electrical_input(name, regeneration, shared):
    """The input beside is a plain sum of 4001 samples, which knows nothing of roots and nodes."""
    robot = ROBOTS[name]()
    motion, models = rich_motion(robot), drives(robot.nv, regeneration=regeneration, shared_bus=shared)
    account = eo.energy_account(motion, robot, models)
    assert abs(account.unaccounted_J) < IN_SUM * account.electrical_J
    t = np.linspace(0.0, motion.duration, 4001)
    states = [motion(t, order) for order in range(3)]
    supply = models.flow(robot.torque(*states), states[1]).supply
    assert account.electrical_J == pytest.approx(np.trapezoid(supply, t), rel=IN_SUM)
    assert sum(account.totals().values()) == pytest.approx(account.electrical_J, rel=1e-9)


def test_quadrature_splits_at_sign_changes_of_power():
    """A slow slider lifts m by 2A against gravity and lowers it: +2 m g A, of which the gear takes (1/η − 1), then (1 − η).

    With |a| < g the power changes sign with the velocity alone, and the kinetic energy is the same at each turn.
    """
    robot = arms.from_urdf(arms.factory.sliders(1, [2.0]), gravity=(-9.81, 0, 0))
    lift, duration, eta = 0.1, 2.0, 0.7
    motion = eo.parameterizations.SinusoidTrajectory(duration, np.array([[lift]]), np.zeros((1, 1)), np.array([[-lift]]))
    account = eo.energy_account(motion, robot, ActuatorModel(10.0, 1.0, 0.0, eta))
    work = 2.0 * 9.81 * 2 * lift  # the axis is x: gravity along −x is lifted against, then lowered
    assert account.joules["gear"][0] == pytest.approx(work * (1 / eta - eta), rel=1e-9)
    assert account.electrical_J == pytest.approx(work / eta, rel=1e-9)
    assert account.braking_J == pytest.approx(work * eta, rel=1e-9) and account.returned_J == pytest.approx(0.0, abs=1e-12)


def test_holding_a_pendulum_costs_copper_and_standby_only():
    """R (m g l cos q / (N k_t))² T + P₀ T, q above the horizontal; standing still, no gear loss enters."""
    robot = arms.pendulum(2.0, 0.5)
    still = eo.baseline(eo.Problem(robot, [0.6], [0.6], 3.0))
    model = Actuators([ActuatorModel(20.0, 0.05, 0.8, 0.9)], standby_power=5.0)
    account = eo.energy_account(still, robot, model)
    copper = 0.8 * (2.0 * 9.81 * 0.5 * np.cos(0.6) / (20.0 * 0.05)) ** 2 * 3.0
    assert account.joules["copper"][0] == pytest.approx(copper, rel=1e-9)
    assert account.electrical_J == pytest.approx(copper + 15.0, rel=1e-9)
    assert account.mechanical_J == pytest.approx(0.0, abs=1e-12)
    assert account.supply_power.mean == pytest.approx(account.electrical_J / 3.0)


def test_viscous_and_coulomb_friction_have_their_closed_forms():
    """From 0 to D in T by the cubic 3s² − 2s³: ∫ v² dt = 6D²/5T, and f D where v_s is far below the velocity."""
    robot = arms.from_urdf(arms.factory.sliders(1), gravity=(0, 0, 0), viscous_friction=3.0, coulomb_friction=2.0,
                           coulomb_velocity=1e-5)  # fmt: skip
    motion = eo.baseline(eo.Problem(robot, [0.0], [0.4], 2.0), "cubic")
    account = eo.energy_account(motion, robot)
    assert account.joules["viscous friction"][0] == pytest.approx(3.0 * 6 * 0.4**2 / (5 * 2.0), rel=1e-9)
    assert account.joules["coulomb friction"][0] == pytest.approx(2.0 * 0.4, rel=1e-6)
    assert account.joules["kinetic"][0] == pytest.approx(0.0, abs=1e-9)


def test_lifting_is_potential_energy_and_accelerating_kinetic():
    """A pendulum from rest at the horizontal to 2 rad/s upright: m g l and ½ m l² ω²."""
    robot = arms.pendulum(1.5, 0.8)
    motion = eo.baseline(eo.Problem(robot, [0.0], [np.pi / 2], 1.0, goal_velocity=2.0))
    account = eo.energy_account(motion, robot)
    assert account.joules["gravity"][0] == pytest.approx(1.5 * 9.81 * 0.8, rel=1e-9)
    assert account.joules["kinetic"][0] == pytest.approx(0.5 * 1.5 * 0.8**2 * 4.0, rel=1e-9)


def test_a_shared_bus_that_returns_all_saves_against_drives_that_burn_all():
    robot = arms.catalogue_robot("ur5")
    motion = rich_motion(robot)
    alone, bus, back = (
        eo.energy_account(motion, robot, drives(6, regeneration=share, shared_bus=shared)).electrical_J
        for share, shared in ((0.0, False), (0.0, True), (1.0, True))
    )
    assert back < bus < alone


def test_the_table_and_the_numbers_for_files_say_the_same():
    robot = arms.catalogue_robot("ur5")
    account = eo.energy_account(rich_motion(robot), robot, drives(6))
    text, numbers = str(account), account.as_dict()
    assert all(name in text for name in robot.joint_names) and "copper" in text and f"{account.electrical_J:.5g} J" in text
    assert sum(numbers["totals"].values()) == pytest.approx(numbers["electrical_J"])
    assert "no electrical joules" in str(eo.energy_account(rich_motion(robot), robot))


@pytest.fixture(scope="module")
def driven_swing():
    """A motion of an arm with drives that claims to solve its problem, and its replay."""
    robot = dataclasses.replace(arms.rubbing_two_link(), actuators=drives(2, regeneration=0.3))
    problem = eo.Problem(robot, [-1.2, 0.4], [0.3, -0.8], 1.2)
    motion = eo.baseline(problem, "cycloid")
    log = replay_trajectory(problem, motion)
    return problem, motion, log, validate_motion(problem, motion, log)


def test_validation_states_what_is_saved_in_joules_at_the_same_duration(driven_swing):
    problem, motion, _, report = driven_swing
    ours = eo.energy_account(motion, problem.robot).electrical_J
    assert report.account.electrical_J == ours
    for kind, other in report.baselines.items():
        theirs = eo.energy_account(eo.baseline(problem, kind), problem.robot).electrical_J
        assert other.account.electrical_J == pytest.approx(theirs) and other.account.duration_s == motion.duration
        assert other.electrical_saving_percent == pytest.approx(100 * (1 - ours / theirs))
    numbers = report.as_dict()
    assert numbers["energy"]["electrical_J"] == ours and numbers["energy"]["account"]["totals"]["standby"] == pytest.approx(24.0)
    assert numbers["baseline"]["quintic"]["electrical_J"] == report.baselines["quintic"].account.electrical_J
    text = str(report)
    assert f"electrical {ours:.4g} J" in text and "of the same duration (saved): quintic" in text


def test_a_replay_draws_what_its_plan_draws(driven_swing):
    """The replay is sampled at its steps, and tracks to 1e-3 of the energy."""
    _, _, log, report = driven_swing
    assert report.replay_electrical_J == pytest.approx(report.account.electrical_J, rel=5e-3)
    assert report.as_dict()["replay"]["energy_electrical_J"] == report.replay_electrical_J
    assert len(log.t) > 1000


def test_validation_without_drives_has_the_mechanical_part(driven_swing):
    problem, motion, _, _ = driven_swing
    bare = dataclasses.replace(problem, robot=dataclasses.replace(problem.robot, actuators=None))
    report = validate_motion(bare, motion)
    assert report.account.electrical_J is None and report.as_dict()["energy"]["electrical_J"] is None
    assert all(other.account is None for other in report.baselines.values())
    assert report.as_dict()["energy"]["account"]["why"] in str(report)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (lambda m, r: (None, r), "motion is None: expected a plan or a trajectory"),
        (lambda m, r: (m, None), "robot is None: expected what energyopt.load_robot gives"),
        (lambda m, r: (m, arms.pendulum()), "the motion has 6 joints and the robot 1"),
        (lambda m, r: (m, r, "strong"), "energy_account: .*actuators"),
        (lambda m, r: (m, r, drives(5)), "energy_account: actuators has 5 models; expected 6"),
    ],
)
def test_senseless_requests_are_refused(given, words):
    robot = arms.catalogue_robot("ur5")
    with pytest.raises(eo.InputError, match=words):
        eo.energy_account(*given(rich_motion(robot), robot))
