"""Symbolic dynamics: equal to Pinocchio, to Newton's and Euler's equations of added bodies, and to textbook closed forms."""

import arms
import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.dynamics import backend
from energyopt.dynamics.symbolic import inverse_dynamics
from energyopt.robots.catalogue import CATALOGUE

STATES = 10_000
SAME_FORMULA = 1e-9
"""Relative to the largest torque of the same state: rounding of π in URDF files that the graph cleans up (2e-11) included."""
ROUNDING = 1e-11
"""Two ways to write a short closed formula."""

try:
    from pinocchio import casadi as _  # noqa: F401

    PINOCCHIO_CASADI = True
except ImportError:
    PINOCCHIO_CASADI = False

missing = pytest.mark.skipif(not PINOCCHIO_CASADI, reason="this pinocchio has no casadi module (PyPI wheels have none)")
both_sources = pytest.mark.parametrize("source", ["recursion", pytest.param("pinocchio.casadi", marks=missing)])


def symbolic_torque(robot, states, source):
    """Torques (N, nv) of the CasADi graph, all states in one mapped call."""
    function = inverse_dynamics(robot.dynamics, source).map(len(states[0]))
    return np.array(function(*(x.T for x in states))).T


def rigid_torque(robot, states):
    """Pinocchio's own inverse dynamics (N, nv), state by state."""
    data = robot.model.createData()
    return np.array([pin.rnea(robot.model, data, *state) for state in zip(*states, strict=True)])


def worst_of_states(tau, expected):
    """Largest error relative to the largest torque of the same state."""
    return np.max(np.abs(tau - expected).max(axis=1) / np.abs(expected).max(axis=1))


def branched_tree():
    """Two arms on one turning base, a slider among them."""
    names = ["base", "link1", "link2", "link1", "link4"]
    kinds = ["revolute", "revolute", "prismatic", "revolute", "revolute"]
    axes = [(0, 0, 1), arms.UNALIGNED, (0, 1, 0), (1, 0, 0), (0, -0.6, 0.8)]
    return factory.chain(
        axes=axes, origins=[(0.1 * i, 0.2, 0.3 - 0.1 * i) for i in range(5)], rpys=[(0.2 * i, -0.3, 0.1 * i) for i in range(5)],
        types=kinds, parents=names, masses=[4.0, 3.0, 2.0, 2.5, 1.0], centers=[(0.05, -0.02 * i, 0.1) for i in range(5)],
        inertias=[arms.tilted(0.02, 0.03, 0.04)] * 5, tool=(0.1, 0, 0),
    )  # fmt: skip


def with_fixed_links():
    """A chain with a rigidly mounted, heavy, tilted link between its joints."""
    link, joint = factory.link, factory.joint
    return "\n".join([
        '<robot name="mounted">', '<link name="base"/>',
        link("a", 2.0, (0.1, 0, 0.2), arms.tilted(0.02, 0.03, 0.04)),
        link("bracket", 1.5, (0.0, 0.3, 0.1), arms.tilted(0.01, 0.02, 0.02)),
        link("b", 1.0, (0.2, 0.1, 0), arms.tilted(0.01, 0.01, 0.015)),
        joint("one", "revolute", "base", "a", (0, 0, 0.4), (0, 1, 0)),
        joint("mount", "fixed", "a", "bracket", (0.3, 0.1, 0), rpy=(0.5, 1.0, -0.4)),
        joint("two", "revolute", "bracket", "b", (0.1, 0.2, 0.3), arms.UNALIGNED), "</robot>",
    ])  # fmt: skip


FACTORY = {
    "unaligned and prismatic": lambda: arms.mixed_chain(),
    "branched": lambda: arms.from_urdf(branched_tree()),
    "fixed link between joints": lambda: arms.from_urdf(with_fixed_links()),
    "locked joint": lambda: arms.from_urdf(branched_tree(), locked={"joint2": 0.7}),
    "sideways gravity": lambda: arms.mixed_chain(gravity=(3.0, -5.0, 2.0)),
}


def test_the_backend_in_use_is_named():
    assert backend() == ("pinocchio.casadi" if PINOCCHIO_CASADI else "recursion")


@both_sources
@pytest.mark.parametrize("name", CATALOGUE)
def test_torques_equal_pinocchio_at_ten_thousand_random_states(name, source):
    robot = arms.catalogue_robot(name)
    states = arms.random_states(robot, STATES)
    expected = rigid_torque(robot, states) + robot.dynamics.friction(states[1])
    assert worst_of_states(symbolic_torque(robot, states, source), expected) < SAME_FORMULA


@both_sources
@pytest.mark.parametrize("kind", FACTORY)
def test_torques_of_every_kind_of_joint_equal_pinocchio(kind, source):
    robot = FACTORY[kind]()
    states = arms.random_states(robot, 1000, seed=1)
    expected = rigid_torque(robot, states)
    assert worst_of_states(symbolic_torque(robot, states, source), expected) < SAME_FORMULA


@both_sources
def test_a_locked_joint_is_the_same_arm_with_that_joint_held_still(source):
    whole, locked = arms.from_urdf(branched_tree()), FACTORY["locked joint"]()
    moving = [whole.joint_names.index(name) for name in locked.joint_names]
    states = arms.random_states(locked, 200, seed=2)
    full = [np.zeros((200, whole.nv)) for _ in range(3)]
    for x, part in zip(full, states, strict=True):
        x[:, moving] = part
    full[0][:, whole.joint_names.index("joint2")] = 0.7
    expected = symbolic_torque(whole, full, source)[:, moving]
    assert worst_of_states(symbolic_torque(locked, states, source), expected) < SAME_FORMULA


@both_sources
def test_a_pendulum_has_its_textbook_torque(source):
    m, length, inertia, g = 1.7, 0.6, 0.04, 9.81
    robot = arms.from_urdf(factory.pendulum(m, length, inertia))
    q, v, a = arms.random_states(robot, 100)
    expected = (m * length**2 + inertia) * a + m * g * length * np.cos(q)
    assert worst_of_states(symbolic_torque(robot, (q, v, a), source), expected) < ROUNDING


@both_sources
def test_a_planar_two_link_arm_has_its_textbook_torques(source):
    """M. W. Spong, S. Hutchinson, M. Vidyasagar, "Robot Modeling and Control", 2006, sec. 7.4."""
    (l1, _), (m1, m2), (c1, c2), (i1, i2), g = (0.5, 0.4), (2.0, 1.5), (0.2, 0.3), (0.03, 0.05), 9.81
    robot = arms.from_urdf(factory.planar_arm([0.5, 0.4], [m1, m2], centers=[c1, c2], inertias=[i1, i2]))
    q, v, a = arms.random_states(robot, 100)
    c, h = np.cos(q[:, 1]), -m2 * l1 * c2 * np.sin(q[:, 1])
    m11 = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * c) + i1 + i2
    m12, m22 = m2 * (c2**2 + l1 * c2 * c) + i2, m2 * c2**2 + i2
    g2 = m2 * c2 * g * np.cos(q.sum(axis=1))
    g1 = (m1 * c1 + m2 * l1) * g * np.cos(q[:, 0]) + g2
    first = m11 * a[:, 0] + m12 * a[:, 1] + 2 * h * v[:, 0] * v[:, 1] + h * v[:, 1] ** 2 + g1
    second = m12 * a[:, 0] + m22 * a[:, 1] - h * v[:, 0] ** 2 + g2
    assert worst_of_states(symbolic_torque(robot, (q, v, a), source), np.stack([first, second], axis=1)) < ROUNDING


@both_sources
def test_sliders_obey_newtons_second_law_each_for_itself(source):
    robot = arms.sliders(3, (1.0, 2.5, 4.0))
    q, v, a = arms.random_states(robot, 50)
    assert worst_of_states(symbolic_torque(robot, (q, v, a), source), a * np.array([1.0, 2.5, 4.0])) < ROUNDING


def payload_torque(robot, payload, q, v, a):
    """What a body held by the bare robot adds: Jᵀ of the force and moment that its own Newton–Euler equations ask for."""
    model = robot.model.copy()
    model.armature = np.zeros(robot.nv)
    frame = robot.frame_id(payload.frame)
    placement = model.frames[frame].placement * pin.SE3(np.eye(3), payload.center)
    center = model.addFrame(pin.Frame("center", model.frames[frame].parentJoint, frame, placement, pin.OP_FRAME))
    data, added = model.createData(), []
    for qi, vi, ai in zip(q, v, a, strict=True):
        pin.forwardKinematics(model, data, qi, vi, ai)
        pin.computeJointJacobians(model, data, qi)
        pin.updateFramePlacements(model, data)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        spin = pin.getFrameVelocity(model, data, center, axes).angular
        acceleration = pin.getFrameClassicalAcceleration(model, data, center, axes)
        R = data.oMf[center].rotation
        inertia = R @ payload.inertia @ R.T
        force = payload.mass * (acceleration.linear - model.gravity.linear)
        moment = inertia @ acceleration.angular + np.cross(spin, inertia @ spin)
        J = pin.getFrameJacobian(model, data, center, axes)
        added.append(J[:3].T @ force + J[3:].T @ moment)
    return np.array(added)


@both_sources
@pytest.mark.parametrize("name", ["panda", "ur5", "mixed chain"])
def test_payload_armature_and_friction_add_what_their_own_equations_say(name, source):
    nv = {"panda": 7, "ur5": 6, "mixed chain": 3}[name]
    frame = {"panda": "panda_hand", "ur5": "tool0", "mixed chain": "tool"}[name]
    load = lambda **options: arms.mixed_chain.__wrapped__(**options) if name == "mixed chain" else eo.load_robot(name, **options)
    payload = eo.Payload(1.8, (0.03, -0.05, 0.12), arms.tilted(0.004, 0.005, 0.006), frame)
    armature, viscous, coulomb, v_s = 0.1 + 0.05 * np.arange(nv), 0.3 * np.ones(nv), 1.0 + 0.2 * np.arange(nv), 0.08
    bare = load()
    loaded = load(payload=payload, armature=armature, viscous_friction=viscous, coulomb_friction=coulomb, coulomb_velocity=v_s)
    q, v, a = arms.random_states(bare, 200, seed=3)
    expected = rigid_torque(bare, (q, v, a))
    expected += payload_torque(bare, payload, q, v, a) + armature * a + viscous * v + coulomb * np.tanh(v / v_s)
    assert worst_of_states(symbolic_torque(loaded, (q, v, a), source), expected) < SAME_FORMULA
    assert worst_of_states(loaded.torque(q, v, a), expected) < SAME_FORMULA


@pytest.mark.parametrize("name", ["panda", "baxter", "kinova", "so101", "branched"])
def test_frame_placements_equal_pinocchio(name):
    robot = FACTORY["branched"]() if name == "branched" else arms.catalogue_robot(name)
    q = arms.random_states(robot, 20, seed=4)[0]
    frames = dict.fromkeys([robot.tool_frame, *robot.frame_names[:: max(1, len(robot.frame_names) // 6)]])
    for frame in filter(None, frames):
        function = robot.frame_placement(frame)
        for qi in q:
            R, p = function(qi)
            expected = robot.placement(frame, qi)
            np.testing.assert_allclose(np.array(R), expected.rotation, atol=1e-10)
            np.testing.assert_allclose(np.array(p).ravel(), expected.translation, atol=1e-10)


@pytest.mark.parametrize("name", ["panda", "ur5", "baxter", "z1", "rubbing"])
def test_the_mass_matrix_is_pinocchios_plus_the_rotors(name):
    robot = arms.rubbing_chain() if name == "rubbing" else arms.catalogue_robot(name)
    bare, data = robot.model.copy(), robot.model.createData()
    bare.armature = np.zeros(robot.nv)
    for q in arms.random_states(robot, 20, seed=5)[0]:
        M = pin.crba(bare, data, q)
        M = np.triu(M) + np.triu(M, 1).T + np.diag(robot.dynamics.armature)
        assert arms.relative(robot.mass_matrix(q), M) < SAME_FORMULA


def test_inverse_dynamics_can_be_used_in_somebody_elses_casadi_problem():
    """The power balance d/dt(kinetic + potential) = τᵀq̇ holds along an expression of time differentiated by CasADi itself."""
    robot, t = arms.two_link(), ca.MX.sym("t")
    q = ca.vertcat(ca.sin(t), 0.5 * ca.cos(2 * t))
    v = ca.jacobian(q, t)
    tau = robot.inverse_dynamics(q, v, ca.jacobian(v, t))
    kinetic = 0.5 * ca.dot(v, robot.mass_matrix(q) @ v)
    heights = [robot.frame_placement(f"link{i}")(q) for i in (1, 2)]
    middle = lambda pose, half: (pose[1] + pose[0] @ ca.DM([half, 0, 0]))[2]
    potential = 9.81 * (2.0 * middle(heights[0], 0.25) + 1.5 * middle(heights[1], 0.2))
    imbalance = ca.Function("imbalance", [t], [ca.jacobian(kinetic + potential, t) - ca.dot(tau, v), ca.dot(tau, v)])
    for time in np.linspace(0.0, 3.0, 13):
        gap, power = (float(x) for x in imbalance(time))
        assert abs(gap) < 1e-11 * (1.0 + abs(power))
