"""Arms that differ from their model: against Pinocchio with the payload appended, a URDF read anew, and a model compiled anew."""

import arms
import numpy as np
import pinocchio as pin
import pytest

import energyopt as eo
from energyopt.robots.variation import Variation, varied_dynamics, vary
from energyopt.simulation import build_engine, check_inverse_dynamics, replay_trajectory
from energyopt.simulation.bodies import with_bodies
from energyopt.simulation.inverse import mujoco_torque
from energyopt.simulation.rig import make_rig, run

LOAD = eo.Payload(1.7, center=(0.03, -0.02, 0.1), inertia=arms.tilted(0.01, 0.02, 0.015))
SAME = 1e-9
"""Relative difference of torques that two models computed from the same numbers."""
ROBOTS = {
    "panda": lambda: arms.catalogue_robot("panda"),
    "baxter": lambda: arms.catalogue_robot("baxter"),
    "rubbing_chain": arms.rubbing_chain,
    "pendulum": lambda: arms.pendulum(2.0, 0.7, 0.05),
    "sliders": lambda: arms.sliders(3, (1.0, 2.0, 3.0)),
}


def everything(robot, seed=0):
    rng = np.random.default_rng(seed)
    return Variation(LOAD, rng.uniform(0.8, 1.2, robot.nv), rng.uniform(0.5, 1.5, robot.nv))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_variation_is_the_same_in_numbers_and_in_its_urdf(name):
    robot = ROBOTS[name]()
    changed = vary(robot, everything(robot))
    states = arms.random_states(robot, 20)
    again = pin.buildModelFromXML(changed.urdf)
    again.gravity, again.armature = robot.model.gravity, robot.model.armature
    data = again.createData()
    expected = [pin.rnea(again, data, *row) + changed.dynamics.friction(row[1]) for row in zip(*states, strict=True)]
    assert arms.relative(changed.torque(*states), expected) < SAME


def test_payload_at_the_tool_is_a_body_appended_to_the_model():
    robot = arms.catalogue_robot("panda")
    states = arms.random_states(robot, 20)
    expected = eo.load_robot("panda", payload=LOAD).torque(*states)
    assert arms.relative(varied_dynamics(robot, Variation(LOAD)).torque(*states), expected) < SAME


def test_masses_scale_what_is_no_rotor_and_no_friction():
    """τ = (bodies) + rotors + friction: doubling the masses doubles the first and leaves the others."""
    robot = arms.rubbing_chain()
    q, v, a = arms.random_states(robot, 20)
    bodies = robot.torque(q, v, a) - robot.dynamics.friction(v) - robot.dynamics.armature * a
    heavy = varied_dynamics(robot, Variation(masses=2.0)).torque(q, v, a)
    assert arms.relative(heavy, robot.torque(q, v, a) + bodies) < SAME
    rough = varied_dynamics(robot, Variation(friction=(3.0, 1.0, 0.0))).torque(q, v, a)
    assert arms.relative(rough, robot.torque(q, v, a) + robot.dynamics.friction(v) * [2.0, 0.0, -1.0]) < SAME


@pytest.mark.parametrize("name", ROBOTS)
def test_bodies_exchanged_in_a_compiled_model_are_those_of_a_model_compiled_anew(name):
    robot = ROBOTS[name]()
    variation, states = everything(robot), arms.random_states(robot, 20)
    changed = vary(robot, variation)
    exchanged = with_bodies(build_engine(robot), robot.dynamics, changed.dynamics)
    assert arms.relative(mujoco_torque(exchanged, changed, *states), changed.torque(*states)) < 1e-7
    assert check_inverse_dynamics(changed) < 1e-7
    # They are other bodies: the model as it was wants other torques.
    assert arms.relative(mujoco_torque(build_engine(robot), changed, *states), changed.torque(*states)) > 1e-3


def test_an_exchanged_model_moves_as_one_compiled_anew():
    """Forward dynamics take other ways through MuJoCo than inverse dynamics do."""
    for robot in (arms.catalogue_robot("ur5"), arms.pendulum(2.0, 0.7, 0.05), arms.sliders(2)):
        start = np.clip(robot.home, robot.limits.lower + 0.2, robot.limits.upper - 0.2)
        problem = eo.Problem(robot, start, start + 0.1, 0.4, torque_limits=np.inf)
        motion, changed = eo.baseline(problem), vary(robot, everything(robot))
        ours = run(make_rig(problem, motion, collisions=False).with_arm(changed.dynamics))
        np.testing.assert_allclose(ours.q, replay_trajectory(problem, motion, plant=changed, collisions=False).q, atol=1e-8)
        assert ours.tracking_max > 1e-4


def test_no_variation_replays_bit_for_bit():
    robot = arms.catalogue_robot("panda")
    problem = eo.Problem(robot, robot.home, robot.home + 0.2, 0.4)
    rig = make_rig(problem, eo.baseline(problem))
    nominal, same = run(rig), run(rig.with_arm(varied_dynamics(robot, Variation())))
    for name, values in nominal.arrays().items():
        np.testing.assert_array_equal(values, same.arrays()[name])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"payload": 2.0}, r"payload is 2.0; expected an energyopt.Payload"),
        ({"masses": 0.0}, "masses is 0.0; expected factors > 0"),
        ({"masses": "heavy"}, "masses is 'heavy'"),
        ({"friction": -0.1}, "friction is -0.1; expected factors ≥ 0"),
        ({"friction": np.nan}, "friction is nan"),
        ({"masses": (1.0, 2.0)}, "masses has 2 factors; expected one, or 7"),
        ({"payload": eo.Payload(1.0, frame="nowhere")}, "no frame named 'nowhere'"),
    ],
)
def test_senseless_variations_are_refused(options, words):
    with pytest.raises(eo.InputError, match=words):
        varied_dynamics(arms.catalogue_robot("panda"), Variation(**options))
