"""MuJoCo against Pinocchio, closed forms, and itself."""

import os
import time

import arms
import numpy as np
import pinocchio as pin
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.errors import SimulationError
from energyopt.robots import catalogue
from energyopt.robots.catalogue import robots_folder
from energyopt.simulation import build_engine, check_inverse_dynamics, replay_trajectory
from energyopt.simulation.inverse import mujoco_torque

ROBOTS = ("panda", "ur5", "ur10", "ur3", "xarm7", "z1", "talos_arm", "baxter", "kinova")
SAME_TORQUE = 1e-6
"""Relative torque difference asked between the engines; 1e-9 is seen, from the inertia given to links without any."""


def middle(robot):
    return 0.5 * (robot.limits.lower + robot.limits.upper)


def swing(robot, amount=0.4, duration=1.5, **options):
    problem = eo.Problem(robot, middle(robot) - amount, middle(robot) + amount, duration, **options)
    return problem, eo.baseline(problem)


@pytest.fixture(scope="module")
def panda():
    return eo.load_robot("panda")


@pytest.fixture
def pendulum(tmp_path):
    return eo.load_robot(factory.write(tmp_path, factory.pendulum(inertia=0.05)))


@pytest.mark.parametrize("name", ROBOTS)
def test_mujoco_wants_the_same_torque(name):
    assert check_inverse_dynamics(eo.load_robot(name)) < SAME_TORQUE


@pytest.mark.parametrize("name", ["panda", "ur10", "baxter"])
def test_mujoco_wants_the_same_torque_with_payload_friction_armature_and_tilted_gravity(name):
    options = {"armature": 0.02, "viscous_friction": 0.5, "coulomb_friction": 0.3, "gravity": (1.0, 2.0, -9.0)}
    load = eo.Payload(1.5, center=(0.02, 0.01, 0.1), inertia=np.diag([0.01, 0.02, 0.015]))
    robot = eo.load_robot(name, payload=load, **options)
    assert check_inverse_dynamics(robot) < SAME_TORQUE
    # The check can fail: the same arm without its payload wants another torque.
    assert check_inverse_dynamics(eo.load_robot(name, **options)) < SAME_TORQUE
    q, zero = middle(robot)[None], np.zeros((1, robot.nv))
    light = eo.load_robot(name, **options)
    assert np.abs(mujoco_torque(build_engine(light), light, q, zero, zero) - robot.torque(q, zero, zero)).max() > 1e-3


def test_mujoco_wants_the_same_torque_of_locked_prismatic_branched_and_oddly_named_arms(tmp_path):
    links = [factory.link(f"link{i}", 0.5 + i, (0.1, 0.02, -0.1)) for i in range(1, 6)]
    joints = [
        factory.joint("b", "revolute", "base", "link1", (0, 0, 0.3), (0, 0.6, 0.8)),
        factory.joint("link3", "prismatic", "link1", "link2", (0.2, 0, 0), (0, 0, 1), rpy=(0.3, 0.1, -0.4)),
        factory.joint("a", "revolute", "link1", "link3", (-0.2, 0, 0), (1, 0, 0)),
        factory.joint("c", "revolute", "link3", "link4", (0, 0.3, 0), (0, -1, 0)),
        factory.joint("d", "fixed", "link4", "link5", (0, 0.1, 0), rpy=(0, 1, 0)),
        factory.joint("e", "revolute", "link5", "link6", (0.1, 0.1, 0), (0, 1, 0)),
    ]
    text = "\n".join(['<robot name="odd">', '<link name="base"/>', *links, factory.link("link6", 0.4), *joints, "</robot>"])
    robot = eo.load_robot(factory.write(tmp_path, text), locked={"c": 0.4})
    assert robot.nv == 4
    assert check_inverse_dynamics(robot) < SAME_TORQUE


def test_a_point_mass_on_a_massless_rod_is_accepted(tmp_path):
    """The links' inertia is zero, below what MuJoCo takes; m l² + armature remains."""
    robot = eo.load_robot(factory.write(tmp_path, factory.pendulum(2.0, 0.7)))
    assert check_inverse_dynamics(robot) < SAME_TORQUE


def test_static_link_with_impossible_inertia_on_a_moving_body_keeps_the_dynamics(tmp_path):
    text = '<robot name="covered"><link name="base"/>' + factory.link("link1", 2.0, (0.3, 0, 0))
    text += factory.joint("joint1", "revolute", "base", "link1", axis=(0, -0.6, 0.8))
    cover = factory.link("cover", 0.005, (0.1, 0, 0), np.diag([1e-6, 1e-6, 5e-4]))
    robot = eo.load_robot(factory.write(tmp_path, text + cover + factory.joint("glue", "fixed", "link1", "cover") + "</robot>"))
    assert check_inverse_dynamics(robot) < SAME_TORQUE


def arms_of_other_robots():
    """Arms with light wrists, the rest of the robot locked."""
    left = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_prosup", "wrist_pitch", "wrist_yaw")
    icub = robots_folder() / "icub_description" / "robots" / "icub.urdf"
    yield "tiago_pro", eo.load_robot("tiago_pro")
    yield "icub", eo.load_robot(icub, joints=[f"l_{name}" for name in left])


@pytest.mark.parametrize("name", catalogue())
def test_default_gains_follow_random_motions_of_every_catalogue_arm(name):
    follow_random_motions(eo.load_robot(name, torque_limits=np.inf))


def test_default_gains_follow_random_motions_of_arms_whose_wrists_stand_upright():
    for name, robot in arms_of_other_robots():
        slope = max(gravity_slope(robot, q) for q in np.random.default_rng(0).uniform(*usual_range(robot), (200, robot.nv)))
        assert slope > 1000, f"{name}: gravity is to pull harder than the feedback's 400 1/s²"
        follow_random_motions(robot.with_limits(torque=np.full(robot.nv, np.inf)))


def follow_random_motions(robot, duration=0.6):
    rng = np.random.default_rng(1)
    low, high = usual_range(robot)
    for start, goal in rng.uniform(low, high, (2, 2, robot.nv)):
        problem = eo.Problem(robot, start, start + 0.3 * (goal - start), duration)
        log = replay_trajectory(problem, eo.baseline(problem), collisions=False)
        # 3e-6 is seen from the Euler rule on quick motions; an arm that is not held is off by a radian.
        assert log.tracking_max < 1e-5


def usual_range(robot):
    """The middle 80 % of the ranges, and of ±2.5 rad where they are wider."""
    low, high = np.maximum(robot.limits.lower, -2.5), np.minimum(robot.limits.upper, 2.5)
    return 0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high


def gravity_slope(robot, q):
    """Largest eigenvalue of −M⁻¹ ∂g/∂q [1/s²]: how strongly gravity pulls the arm away from a posture."""
    model, data, rest = robot.model, robot.model.createData(), np.zeros(robot.nv)
    stiffness = pin.computeRNEADerivatives(model, data, q, rest, rest)[0].copy()
    mass = np.array([pin.rnea(model, data, q, rest, e) - pin.rnea(model, data, q, rest, rest) for e in np.eye(robot.nv)]).T
    return np.linalg.eigvals(-np.linalg.solve(mass, stiffness)).real.max()


@pytest.mark.parametrize("length", [0.001, 0.004, 1.0])
def test_an_upright_pendulum_is_held_however_short_it_is(tmp_path, length):
    """Upright it falls as exp(√(g/l) t): at 1 mm gravity's 9810 1/s² stand against the feedback's 400 1/s²."""
    robot = eo.load_robot(factory.write(tmp_path, factory.pendulum(1.0, length)), torque_limits=np.inf)
    problem = eo.Problem(robot, [np.pi], [np.pi], 1.0, position_limits=([-4.0], [4.0]))
    log = replay_trajectory(problem, eo.baseline(problem), initial_error=0.02, physics_step=1e-4)
    expected = 0.02 * (1 + 20 * log.t) * np.exp(-20 * log.t)
    np.testing.assert_allclose(log.tracking_error[:, 0], expected, atol=8e-5)


@pytest.mark.parametrize("name", ROBOTS)
def test_replay_follows_a_quintic_within_a_hundred_thousandth_of_a_radian(name):
    """Torque limits are lifted: in the middle of their ranges some arms cannot carry themselves."""
    robot = eo.load_robot(name, torque_limits=np.inf)
    problem, motion = swing(robot, amount=0.05 * (robot.limits.upper - robot.limits.lower), duration=1.0)
    log = replay_trajectory(problem, motion)
    assert log.tracking_max < 1e-5
    assert log.t[-1] == motion.duration and log.physics_step <= 5e-4 * (1 + 1e-12)


def test_replay_logs_agree_with_each_other_and_with_the_plan(panda):
    problem, motion = swing(panda)
    log = replay_trajectory(problem, motion)
    assert log.tracking_max < 1e-5 and log.saturated_steps == 0
    np.testing.assert_allclose(log.power, log.tau * log.v)
    np.testing.assert_allclose(log.tau_planned, panda.torque(motion(log.t), motion(log.t, 1), motion(log.t, 2)))
    # Inverse dynamics of the simulated motion is the logged torque: step by step the physics is Pinocchio's.
    np.testing.assert_allclose(panda.torque(log.q, log.v, log.a), log.tau, atol=1e-6)
    # The velocity is the integral of the acceleration by the Euler rule.
    np.testing.assert_allclose(np.diff(log.v, axis=0), log.a[:-1] * log.physics_step, atol=1e-10)
    assert set(log.arrays()) >= {"t", "q", "v", "a", "tau", "power", "q_ref", "v_ref", "tau_planned", "saturated"}


def test_replay_is_reproducible_bit_for_bit(panda):
    problem, motion = swing(panda, duration=0.3, amount=0.05)
    first, second = (replay_trajectory(problem, motion) for _ in range(2))
    np.testing.assert_array_equal(first.q, second.q)


def test_error_falls_with_the_square_of_the_physics_step(panda):
    problem, motion = swing(panda, duration=0.8)
    coarse, fine = (replay_trajectory(problem, motion, physics_step=h).tracking_rms for h in (1e-3, 5e-4))
    assert coarse / fine == pytest.approx(4.0, rel=0.05)


def test_torque_of_the_replay_tends_to_the_planned_torque_with_the_step(panda):
    problem, motion = swing(panda, duration=0.8)
    logs = [replay_trajectory(problem, motion, physics_step=h) for h in (1e-3, 5e-4)]
    coarse, fine = (np.abs(log.tau - log.tau_planned).max() for log in logs)
    assert fine < 0.6 * coarse < 0.02 * np.abs(logs[0].tau_planned).max()


def test_simulated_work_is_the_change_of_energy(panda):
    """∫τᵀq̇ dt of the replay against kinetic plus potential energy by Pinocchio; the Euler rule leaves an O(h) share."""
    problem, motion = swing(panda, goal_velocity=0.5)
    log = replay_trajectory(problem, motion, physics_step=1e-4)
    work = np.trapezoid(log.power.sum(axis=1), log.t)
    energy = panda.dynamics.energy(log.q[[0, -1]], log.v[[0, -1]])
    assert work == pytest.approx(energy[1] - energy[0], abs=1e-3 * np.trapezoid(np.abs(log.power).sum(axis=1), log.t))


def test_replay_takes_a_start_velocity(panda):
    problem, motion = swing(panda, start_velocity=0.6, goal_velocity=-0.3, duration=1.0)
    log = replay_trajectory(problem, motion)
    np.testing.assert_allclose(log.v[0], 0.6)
    np.testing.assert_allclose(log.v[-1], -0.3, atol=5e-3)
    assert log.tracking_max < 1e-3


@pytest.mark.parametrize("coulomb", [0.3, 20.0])
def test_friction_of_the_plan_is_the_friction_of_the_replay(panda, coulomb):
    """The stiff case has friction slopes of 400 N·m·s/rad on wrists of 0.01 kg·m²: explicit integration would explode."""
    robot = eo.load_robot("panda", viscous_friction=0.8, coulomb_friction=coulomb, torque_limits=np.inf)
    problem, motion = swing(robot)
    log = replay_trajectory(problem, motion)
    assert log.tracking_max < 1e-3
    # It matters: a plant without the friction is pushed ahead of the plan.
    assert replay_trajectory(problem, motion, plant=panda).tracking_max > 5 * log.tracking_max


def test_errors_decay_as_the_gains_say(pendulum):
    """ë + 40 ė + 400 e = 0 from e₀ at rest: e(t) = e₀ (1 + 20 t) exp(−20 t)."""
    problem = eo.Problem(pendulum, [0.3], [0.3], 0.5)
    log = replay_trajectory(problem, eo.baseline(problem), initial_error=0.01, physics_step=1e-4)
    expected = 0.01 * (1 + 20 * log.t) * np.exp(-20 * log.t)
    # The Euler rule leaves 20 t h of the error, at its largest 4e-3 of 0.01.
    np.testing.assert_allclose(log.tracking_error[:, 0], expected, atol=4e-5)


def test_another_plant_shows_in_the_error(panda):
    heavy = eo.load_robot("panda", payload=eo.Payload(2.0))
    problem, motion = swing(panda)
    assert replay_trajectory(problem, motion, plant=heavy).tracking_max > 10 * replay_trajectory(problem, motion).tracking_max


def held(robot, **options):
    """A replay of standing still, and what its controller sees."""
    problem = eo.Problem(robot, [0.3], [0.3], 0.4)
    return replay_trajectory(problem, eo.baseline(problem), **options)


def test_a_delayed_loop_is_the_difference_equation_with_delay():
    """m ẍ = u(t − d h), u = −m (k_p x + k_d ẋ): velocities by the Euler rule, positions by the mean velocity."""
    h, delay, kp, kd = 5e-4, 20, 400.0, 40.0
    log = held(arms.sliders(1), delay=delay, initial_error=0.01)
    x, v, commands = [0.01], [0.0], []
    for _ in log.t[1:]:
        commands.append(-(kp * x[-1] + kd * v[-1]))
        v.append(v[-1] + h * commands[max(len(commands) - 1 - delay, 0)])
        x.append(x[-1] + 0.5 * h * (v[-1] + v[-2]))
    np.testing.assert_allclose(log.tracking_error[:, 0], x, atol=1e-12)
    assert np.abs(log.tracking_error - held(arms.sliders(1), initial_error=0.01).tracking_error).max() > 1e-4


def test_noise_enters_through_the_gains_and_repeats_with_its_seed():
    """An arm held at rest is pushed by m (k_p n_q + k_d n_v): over many steps the commands show the asked deviation."""
    options = {"position_noise": 1e-5, "velocity_noise": 1e-4}
    log, again, other = (held(arms.sliders(1), **options, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(log.q, again.q)
    assert np.abs(log.q - other.q).max() > 0
    first = np.array([held(arms.sliders(1), **options, seed=seed).tau[0, 0] for seed in range(60)])
    # 60 draws give a deviation within 25 % in more than 99 % of all cases; the seeds are fixed.
    assert np.std(first) == pytest.approx(np.hypot(400 * 1e-5, 40 * 1e-4), rel=0.25)


def test_torque_limits_saturate_and_are_counted(panda):
    problem, motion = swing(panda, torque_limits=[87, 15, 87, 87, 12, 12, 12])
    log = replay_trajectory(problem, motion)
    assert log.saturated_steps > 100
    assert np.all(np.abs(log.tau) <= problem.limits.torque)
    assert log.tracking_max > 0.01


def test_position_limits_exert_no_force(panda):
    """Held a little beyond a limit, the arm needs its weight's torque only; MuJoCo's own limits would push it back."""
    there = middle(panda)
    there[3] = panda.limits.upper[3] + 0.01
    problem = eo.Problem(panda, there, there, 0.2)
    log = replay_trajectory(problem, eo.baseline(problem))
    weight = panda.torque(there, np.zeros(7), np.zeros(7))
    np.testing.assert_allclose(log.tau, np.tile(weight, (len(log.t), 1)), atol=1e-6)


@pytest.mark.parametrize(
    "gains", [{"stiffness": 1e9, "damping": 0.0}, {"damping": 1e200, "initial_error": 0.1}, {"damping": 9e3}]
)
def test_a_diverging_replay_is_one_clear_line_and_leaves_no_file(panda, gains, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot = eo.load_robot("panda", torque_limits=np.inf)
    problem, motion = swing(robot)
    with pytest.raises(SimulationError, match=r"diverged at .* s .*softer gains") as caught:
        replay_trajectory(problem, motion, **gains)
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"physics_step": 2e-3}, "at most 0.001"),
        ({"physics_step": 0.0}, "above 0"),
        ({"physics_step": np.nan}, "above 0"),
        ({"physics_step": 1e-8}, "expected at most 2000000"),
        ({"stiffness": -1.0}, "stiffness"),
        ({"damping": np.inf}, "damping"),
        ({"physics_step": "1 ms"}, "physics_step is '1 ms'"),
        ({"stiffness": "stiff"}, "stiffness is 'stiff'"),
        ({"damping": None}, "damping is None: expected one finite number"),
        ({"initial_error": [1.0, 2.0]}, "initial_error: expected 7 numbers, got 2 numbers"),
        ({"collisions": "yes"}, "collisions is 'yes': expected True, False, or None"),
        ({"initial_error": 1e300}, "initial_error is 1e.300: expected none beyond 10"),
        ({"initial_error": "none"}, "initial_error is 'none': expected one number or 7 numbers"),
        ({"initial_error": np.nan}, r"initial_error\[0\] is nan"),
        ({"plant": "panda"}, "expected a robot with the joints"),
        ({"delay": -1}, "delay is -1: expected a whole number of physics steps"),
        ({"delay": 0.5}, "delay is 0.5"),
        ({"position_noise": np.nan}, "position_noise is nan: expected a standard deviation"),
        ({"velocity_noise": -1.0}, "velocity_noise is -1.0"),
        ({"seed": "x"}, "seed is 'x'"),
    ],
)
def test_senseless_options_are_refused(panda, options, words):
    problem, motion = swing(panda)
    with pytest.raises(eo.InputError, match=words):
        replay_trajectory(problem, motion, **options)


def test_replay_names_what_is_no_plan_and_what_is_no_option(panda):
    for wrong in (None, 5, swing(panda)[0]):
        with pytest.raises(eo.InputError, match=r"replay: plan is .*: expected an energyopt\.Plan"):
            eo.replay(wrong)
    with pytest.raises(eo.InputError, match="replay: no option 'phys_step'; nearest: physics_step"):
        eo.replay(eo.plan(eo.Problem(panda, panda.home, panda.home + 0.1, 1.0), eo.BSpline(accuracy=None)), phys_step=1e-3)


def test_a_second_and_a_half_of_panda_takes_a_fraction_of_a_second_of_a_processor(panda):
    problem, motion = swing(panda)
    replay_trajectory(problem, motion)  # reads or makes the collision geometry, which is cached
    spent = []
    for _ in range(3):
        began = time.process_time()
        replay_trajectory(problem, motion)
        spent.append(time.process_time() - began)
    # 0.2 s is seen, contacts looked for at each of 3001 steps; other processes slow a processor down too.
    assert min(spent) < 0.6
