"""Published friction: the numbers are those of the publication, up to an offset whose size is stated; friction speeds a joint."""

import numpy as np
import pytest

import energyopt as eo
from energyopt.errors import RobotError
from energyopt.io.parts import robot_arrays, robot_from_arrays
from energyopt.robots.identified import FRICTION


@pytest.fixture(scope="module")
def panda():
    return eo.load_robot("panda", coulomb_friction="gaz2019")


def published(v):
    """τ_f of the publication: φ₁/(1 + exp(−φ₂(q̇ + φ₃))) − φ₁/(1 + exp(−φ₂φ₃)), as it stands there."""
    size, steepness, offset = (np.array(row) for row in FRICTION["gaz2019"].sigmoid)
    return size / (1 + np.exp(-steepness * (v + offset))) - size / (1 + np.exp(-steepness * offset))


def test_friction_is_the_published_sigmoid_but_for_the_stated_offset(panda):
    v = np.linspace(-2.5, 2.5, 4001)[:, None] * np.ones(7)
    gap = panda.dynamics.friction(v) - published(v)
    assert 0.07 < np.abs(gap).max() < 0.074
    size, steepness, offset = (np.array(row) for row in FRICTION["gaz2019"].sigmoid)
    x, b = 0.5 * steepness * v, 0.5 * steepness * offset
    # tanh(x + b) − tanh b − tanh x = −tanh x · tanh b · tanh(x + b)
    np.testing.assert_allclose(gap, 0.5 * size * np.tanh(x) * np.tanh(b) * np.tanh(x + b), atol=1e-14)


def test_symbolic_and_numeric_torques_agree_where_every_joint_has_its_own_friction_velocity(panda):
    rng = np.random.default_rng(1)
    q, v, a = rng.standard_normal((3, 20, 7))
    symbolic = np.array([panda.inverse_dynamics(*row).full().ravel() for row in zip(q, v, a, strict=True)])
    np.testing.assert_allclose(symbolic, panda.torque(q, v, a), atol=1e-11)  # rounding at torques up to 100 N·m


def test_every_joint_may_have_its_own_friction_velocity():
    speeds = np.linspace(0.02, 0.2, 6)
    by_name = dict(zip(eo.load_robot("ur5").joint_names, speeds, strict=True))
    listed, named = (eo.load_robot("ur5", coulomb_friction=2.0, coulomb_velocity=value) for value in (speeds, by_name))
    v = np.random.default_rng(2).standard_normal((5, 6))
    np.testing.assert_allclose(listed.dynamics.friction(v), 2.0 * np.tanh(v / speeds), rtol=1e-14)
    assert listed.dynamics.digest == named.dynamics.digest
    one = eo.load_robot("ur5", coulomb_friction=2.0, coulomb_velocity=0.1)
    same = eo.load_robot("ur5", coulomb_friction=2.0, coulomb_velocity=[0.1] * 6)
    assert one.dynamics.digest == same.dynamics.digest != listed.dynamics.digest
    part = eo.load_robot("ur5", coulomb_friction=2.0, coulomb_velocity={"elbow_joint": 0.3}).dynamics.coulomb_velocity
    assert part.tolist() == [0.05, 0.05, 0.3, 0.05, 0.05, 0.05]


def test_friction_velocities_come_back_from_a_plan_file(panda):
    arrays = {}
    meta = robot_arrays(panda, arrays)
    own = {key.removeprefix("robot."): value for key, value in arrays.items()}
    back = robot_from_arrays(meta, panda.urdf, own)
    assert back.dynamics.coulomb_velocity.tobytes() == panda.dynamics.coulomb_velocity.tobytes()
    assert back.dynamics.digest == panda.dynamics.digest


def test_the_source_is_among_the_notes_and_friction_of_the_file_is_not_called_unused(panda):
    assert any("Gaz" in note and "2019" in note for note in panda.notes)


def test_a_replay_of_a_plan_with_published_friction_needs_the_planned_torque():
    problem = eo.Problem(
        eo.load_robot("panda", coulomb_friction="gaz2019"), [0, 0, 0, -1.5, 0, 1.5, 0], [0.5, 0.3, 0, -1.2, 0, 1.5, 0.3], 1.5
    )
    plan = eo.plan(problem)
    log = eo.replay(plan)
    assert np.abs(log.q - plan.trajectory(np.clip(log.t, 0, plan.duration))).max() < 2e-3


def test_a_problem_file_can_name_a_published_set(tmp_path):
    path = tmp_path / "task.toml"
    text = '[robot]\nname = "panda"\ncoulomb_friction = "%s"\n[problem]\nstart = "home"\ngoal = "home"\nduration = 1\n'
    path.write_text(text % "gaz2019")
    robot = eo.load_problem(path).robot
    assert robot.dynamics.coulomb_friction[3] == 0.5 * 1.2794
    path.write_text(text % "gaz2018")
    with pytest.raises(eo.InputError, match=r"task\.toml:3: robot\.coulomb_friction is .*or one of gaz2019"):
        eo.load_problem(path)


BAD = [
    (
        "panda",
        {"coulomb_friction": "gaz"},
        "panda: coulomb_friction is 'gaz'; expected numbers, 'urdf', or a published set: 'gaz2019'",
    ),
    (
        "ur5",
        {"coulomb_friction": "gaz2019"},
        "ur5: coulomb_friction 'gaz2019' has no joint 'shoulder_pan_joint'; it is for panda_joint1",
    ),
    ("panda", {"coulomb_friction": "gaz2019", "coulomb_velocity": 0.1}, "panda: coulomb_velocity is given beside"),
    ("ur5", {"coulomb_velocity": [0.1, 0.2]}, "ur5: coulomb_velocity has shape (2,); expected 6 numbers"),
    ("ur5", {"coulomb_velocity": [0.1, 0.2, 0, 1, 1, 1]}, "ur5: coulomb_velocity is 0; expected a positive number"),
    ("ur5", {"coulomb_velocity": {"elbow": 1}}, "ur5: coulomb_velocity: no moving joint named 'elbow'"),
]


@pytest.mark.parametrize("name, arguments, message", BAD)
def test_bad_friction_is_refused_in_one_line(name, arguments, message):
    with pytest.raises(RobotError) as error:
        eo.load_robot(name, **arguments)
    assert str(error.value).startswith(message) and "\n" not in str(error.value)
