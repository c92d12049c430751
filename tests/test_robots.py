"""Robots: every catalogue entry, and preparation against independent dynamics."""

from importlib import import_module
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.robots import catalogue, resolve_mesh
from energyopt.robots.catalogue import CATALOGUE, robots_folder
from energyopt.robots.preparation import rotation_from_rpy, rpy_from_rotation

EXACT = 1e-10
"""Same rigid-body formula on equal numbers: only rounding differs (torques are of order 1 to 1e3 N·m)."""


def random_states(robot, count=5, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.nv))
    return q, rng.normal(size=q.shape), rng.normal(size=q.shape)


def full_model_torque(robot, values, q, v, a):
    """Torques from the untouched URDF, every joint kept, those not in ``robot`` held at ``values`` (default 0).

    Continuous joints have the coordinates (cos θ, sin θ) there. An oracle that shares no step with preparation.
    """
    model = pin.buildModelFromUrdf(str(robot.source))
    where, angles = {}, {}
    full_q, full_v, full_a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    for joint, name in zip(model.joints[1:], list(model.names)[1:], strict=True):
        if name in robot.joint_names:
            i = robot.joint_names.index(name)
            where[name], angles[name] = joint.idx_v, q[i]
            full_v[joint.idx_v], full_a[joint.idx_v] = v[i], a[i]
        angle = angles.get(name, values.get(name, 0.0))
        full_q[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(angle), np.sin(angle)] if joint.nq == 2 else [angle]
    tau = pin.rnea(model, model.createData(), full_q, full_v, full_a)
    return np.array([tau[where[name]] for name in robot.joint_names])


@pytest.mark.parametrize("name", catalogue())
def test_every_catalogue_robot_is_ready_to_plan_with(name):
    robot = eo.load_robot(name)
    limits = robot.limits
    assert robot.name == name
    assert robot.model.nq == robot.model.nv == robot.nv == len(robot.joint_names)
    for array in (limits.lower, limits.upper, limits.velocity, limits.torque):
        assert array.shape == (robot.nv,) and np.isfinite(array).all()
    assert (limits.lower < limits.upper).all() and (limits.velocity > 0).all() and (limits.torque > 0).all()
    assert np.array_equal(robot.home, CATALOGUE[name].home), "home is outside the limits, so it was moved"
    assert robot.tool_frame in robot.frame_names
    assert robot.srdf is None or robot.srdf.is_file()


@pytest.mark.parametrize("name", catalogue())
def test_home_lets_the_tool_move_in_every_direction_it_can(name):
    robot = eo.load_robot(name)
    jacobian = pin.computeFrameJacobian(robot.model, robot.model.createData(), robot.home, robot.frame_id(robot.tool_frame))
    assert np.linalg.svd(jacobian, compute_uv=False)[min(robot.nv, 6) - 1] > 0.02  # a singular arm has 0 here


@pytest.mark.parametrize("name", catalogue())
def test_prepared_robot_has_the_torques_of_the_untouched_urdf(name):
    robot = eo.load_robot(name)
    for state in zip(*random_states(robot), strict=True):
        np.testing.assert_allclose(robot.torque(*state), full_model_torque(robot, {}, *state), atol=EXACT, rtol=EXACT)


@pytest.mark.parametrize(
    ("name", "locked"),
    [
        ("panda", {"panda_finger_joint1": 0.03, "panda_finger_joint2": 0.02, "panda_joint5": -0.7}),
        ("baxter", {"left_s1": 0.6, "right_e0": -1.3, "head_pan": 0.4}),
        ("tiago", {"torso_lift_joint": 0.21, "arm_3_joint": -1.0, "wheel_left_joint": 2.0}),
        ("kinova", {"j2s6s200_joint_1": 4.0, "j2s6s200_joint_3": 1.3}),
        ("z1", {"jointGripper": -0.9}),
        ("ur5", {"elbow_joint": np.pi / 2}),
    ],
)
def test_joints_locked_away_from_zero_keep_the_torques(name, locked):
    robot = eo.load_robot(name, locked=locked)
    assert not set(locked) & set(robot.joint_names)
    for state in zip(*random_states(robot, seed=1), strict=True):
        np.testing.assert_allclose(robot.torque(*state), full_model_torque(robot, locked, *state), atol=EXACT, rtol=EXACT)


@pytest.mark.parametrize("name", ["panda", "xarm7", "z1", "tiago_no_hand"])
def test_locking_agrees_with_pinocchio_reduced_models(name):
    robot = eo.load_robot(name)
    full = pin.buildModelFromUrdf(str(robot.source))
    held = [full.getJointId(n) for n in list(full.names)[1:] if n not in robot.joint_names]
    reduced = pin.buildReducedModel(full, held, pin.neutral(full))
    assert tuple(reduced.names)[1:] == robot.joint_names
    data = reduced.createData()
    for q, v, a in zip(*random_states(robot, seed=2), strict=True):
        np.testing.assert_allclose(robot.torque(q, v, a), pin.rnea(reduced, data, q, v, a), atol=EXACT, rtol=EXACT)


def test_frames_of_locked_links_stay_where_they_were():
    robot = eo.load_robot("panda", locked={"panda_finger_joint1": 0.03})
    full = pin.buildModelFromUrdf(str(robot.source))
    q = np.array([*robot.home, 0.03, 0.03])
    data = full.createData()
    pin.framesForwardKinematics(full, data, q)
    for finger in ("panda_leftfinger", "panda_rightfinger"):
        expected = data.oMf[full.getFrameId(finger)]
        np.testing.assert_allclose(robot.placement(finger, robot.home).homogeneous, expected.homogeneous, atol=1e-12)


def test_rpy_survives_any_rotation_and_the_singular_ones():
    rng = np.random.default_rng(3)
    angles = [
        *rng.uniform(-np.pi, np.pi, (200, 3)),
        *([r, s * (np.pi / 2 - d), y] for r in (0.3, 2.0) for s in (1, -1) for d in (0, 1e-9) for y in (0.0, -2.5)),
    ]
    for rpy in angles:
        rotation = rotation_from_rpy(rpy)
        np.testing.assert_allclose(rotation_from_rpy(rpy_from_rotation(rotation)), rotation, atol=1e-14)


def test_prepared_text_makes_the_same_model_again():
    robot = eo.load_robot("tiago_dual", torque_limits={"arm_left_1_joint": 11.0}, velocity_limits=1.5)
    again = pin.buildModelFromXML(robot.urdf)
    assert list(again.names) == list(robot.model.names)
    assert all(x.isApprox(y) for x, y in zip(again.inertias, robot.model.inertias, strict=True))
    np.testing.assert_array_equal(again.lowerPositionLimit, robot.limits.lower)
    np.testing.assert_array_equal(again.effortLimit, robot.limits.torque)
    np.testing.assert_array_equal(again.velocityLimit, np.full(14, 1.5))


def test_prepared_text_keeps_the_collision_geometry():
    robot = eo.load_robot("panda")
    root = ElementTree.fromstring(robot.urdf)
    meshes = [mesh.get("filename") for mesh in root.iterfind("link/collision/geometry/mesh")]
    assert len(meshes) >= 9
    assert all(resolve_mesh(robot, uri).is_file() for uri in meshes)


# --- what a joint can be -------------------------------------------------------------------------------------------


def test_continuous_joints_get_the_stated_range_and_a_note():
    robot = eo.load_robot("kinova", continuous_range={"j2s6s200_joint_4": (-1.0, 2.0)})
    i = robot.joint_names.index("j2s6s200_joint_4")
    assert (robot.limits.lower[i], robot.limits.upper[i]) == (-1.0, 2.0)
    assert robot.limits.upper[0] == pytest.approx(2 * np.pi)
    assert any("j2s6s200_joint_4 [-1, 2]" in note for note in robot.notes)


def test_mimic_joints_are_locked_where_their_master_puts_them(tmp_path):
    mimic = '<mimic joint="master" multiplier="-2" offset="0.1"/>'
    links = [factory.link("a", 1.0, (0.2, 0, 0)), factory.link("b", 2.0, (0.1, 0.3, 0)), factory.link("c", 1.0, (0, 0, 0.2))]
    joints = [
        factory.joint("arm", "revolute", "base", "a", axis=(0, 1, 0)),
        factory.joint("master", "revolute", "a", "b", (0.3, 0, 0), (1, 1, 0)),
        factory.joint("follower", "revolute", "a", "c", (0.1, 0, 0), (0, 0, 1), extra=mimic),
    ]
    text = "\n".join(['<robot name="r"><link name="base"/>', *links, *joints, "</robot>"])
    path = factory.write(tmp_path, text)
    robot = eo.load_robot(path, locked={"master": 0.4})
    assert robot.joint_names == ("arm",)
    state = np.array([0.3]), np.array([1.0]), np.array([-2.0])
    expected = full_model_torque(robot, {"master": 0.4, "follower": -0.7}, *state)
    np.testing.assert_allclose(robot.torque(*state), expected, atol=EXACT)
    assert any("'follower' mimics 'master' and is locked at -0.7." in note for note in robot.notes)
    free = eo.load_robot(path)
    assert set(free.joint_names) == {"arm", "master"}
    assert any("'follower' mimics 'master' and is locked at 0.1, though its master moves" in note for note in free.notes)


def test_prismatic_unaligned_and_branched_joints_are_prepared(tmp_path):
    rng = np.random.default_rng(4)
    axes = rng.normal(size=(5, 3))
    text = factory.chain(
        axes=axes,
        origins=rng.normal(size=(5, 3)),
        rpys=rng.uniform(-3, 3, (5, 3)),
        masses=rng.uniform(0.5, 3, 5),
        centers=rng.normal(size=(5, 3)),
        inertias=[0.1 * np.eye(3)] * 5,
        types=["revolute", "prismatic", "revolute", "continuous", "prismatic"],
        parents=["base", "link1", "link1", "link2", "link4"],
    )
    robot = eo.load_robot(factory.write(tmp_path, text), locked={"joint2": 0.7, "joint3": -1.1})
    assert robot.joint_names == ("joint1", "joint4", "joint5")
    assert sum("made a unit vector" in note for note in robot.notes) == 5
    for state in zip(*random_states(robot, seed=5), strict=True):
        expected = full_model_torque(robot, {"joint2": 0.7, "joint3": -1.1}, *state)
        np.testing.assert_allclose(robot.torque(*state), expected, atol=EXACT, rtol=EXACT)


def test_joint_and_link_of_one_name_do_not_confuse_loading(tmp_path):
    text = factory.pendulum(1.5, 0.7).replace('"joint1"', '"link1"')
    robot = eo.load_robot(factory.write(tmp_path, text), payload=eo.Payload(0.5, (0.7, 0, 0), None, "link1"))
    assert robot.torque([0.2], [0.0], [0.0])[0] == pytest.approx(2.0 * 9.81 * 0.7 * np.cos(0.2), rel=1e-12)


def test_a_selection_of_joints_keeps_their_home():
    robot = eo.load_robot("panda", joints=["panda_joint1", "panda_joint4"])
    assert robot.joint_names == ("panda_joint1", "panda_joint4")
    np.testing.assert_allclose(robot.home, [0.0, -3 * np.pi / 4])


# --- payload, gravity, armature, friction --------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "frame"), [("panda", "panda_hand_tcp"), ("panda", "panda_joint6"), ("baxter", "right_gripper")])
def test_payload_adds_the_wrench_newton_and_euler_give(name, frame):
    rng = np.random.default_rng(6)
    spread = rng.normal(size=(3, 3))
    moments = np.trace(spread @ spread.T) * np.eye(3) - spread @ spread.T  # of a cloud of points: always possible
    load = eo.Payload(2.3, (0.05, -0.1, 0.2), 0.01 * moments, frame)
    gravity = np.array([1.0, -2.0, -9.0])
    bare, loaded = eo.load_robot(name, gravity=gravity), eo.load_robot(name, gravity=gravity, payload=load)
    link = "panda_link6" if frame == "panda_joint6" else frame
    for q, v, a in zip(*random_states(bare, seed=7), strict=True):
        expected = payload_torque(bare, link, load, gravity, q, v, a)
        np.testing.assert_allclose(loaded.torque(q, v, a) - bare.torque(q, v, a), expected, atol=1e-9)


def payload_torque(robot, link, load, gravity, q, v, a):
    """τ = Jᵀ [f; n]: force m (a_c − g) and moment I α + ω × I ω + r × f at the link's origin, in world axes."""
    model, data, frame = robot.model, robot.model.createData(), robot.frame_id(link)
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    axes = pin.LOCAL_WORLD_ALIGNED
    omega = pin.getFrameVelocity(model, data, frame, axes).angular
    acceleration = pin.getFrameClassicalAcceleration(model, data, frame, axes)
    rotation = data.oMf[frame].rotation
    r, inertia, alpha = rotation @ load.center, rotation @ load.inertia @ rotation.T, acceleration.angular
    force = load.mass * (acceleration.linear + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r)) - gravity)
    moment = inertia @ alpha + np.cross(omega, inertia @ omega) + np.cross(r, force)
    jacobian = pin.computeFrameJacobian(model, data, q, frame, axes)
    return jacobian.T @ np.concatenate([force, moment])


def test_static_torque_is_the_slope_of_potential_energy_for_any_gravity():
    gravity = np.array([3.0, -5.0, 4.0])
    robot = eo.load_robot("ur5", gravity=gravity)
    data, total = robot.model.createData(), pin.computeTotalMass(robot.model)
    potential = lambda q: -total * gravity @ pin.centerOfMass(robot.model, data, q)
    q, step = robot.home + 0.3, 1e-5
    slope = [(potential(q + d) - potential(q - d)) / (2 * step) for d in step * np.eye(robot.nv)]
    np.testing.assert_allclose(robot.torque(q, 0 * q, 0 * q), slope, atol=1e-7)  # central differences: error of order step²


def test_armature_and_friction_add_their_own_terms():
    friction = {"viscous_friction": 0.7, "coulomb_friction": [1, 2, 3, 4, 5, 6], "coulomb_velocity": 0.1}
    bare, rich = eo.load_robot("ur5"), eo.load_robot("ur5", armature={"elbow_joint": 0.3}, **friction)
    q, v, a = random_states(bare, seed=8)
    inertia = np.array([0, 0, 0.3, 0, 0, 0])
    expected = bare.torque(q, v, a) + inertia * a + 0.7 * v + np.arange(1, 7) * np.tanh(v / 0.1)
    np.testing.assert_allclose(rich.torque(q, v, a), expected, atol=EXACT)


def test_friction_of_the_file_is_used_only_on_request():
    silent, rubbing = eo.load_robot("z1"), eo.load_robot("z1", viscous_friction="urdf", coulomb_friction="urdf")
    assert not silent.dynamics.viscous_friction.any() and any("not used" in note for note in silent.notes)
    np.testing.assert_array_equal(rubbing.dynamics.viscous_friction, [1, 2, 1, 1, 1, 1])
    np.testing.assert_array_equal(rubbing.dynamics.coulomb_friction, [1, 2, 1, 1, 1, 1])
    assert "<dynamics" not in rubbing.urdf


# --- limits --------------------------------------------------------------------------------------------------------


def test_limits_can_be_replaced_by_number_list_or_joint_and_then_scaled():
    robot = eo.load_robot(
        "ur5",
        position_limits={"elbow_joint": (-1.0, 2.0)},
        velocity_limits={"wrist_3_joint": 1.0},
        torque_limits=[10, 20, 30, 40, 50, 60],
        acceleration_limits=8.0,
        limit_scale={"velocity": 0.5, "torque": {"elbow_joint": 0.1}},
    )
    np.testing.assert_allclose(robot.limits.velocity, [1.575, 1.575, 1.575, 1.6, 1.6, 0.5])
    np.testing.assert_allclose(robot.limits.torque, [10, 20, 3, 40, 50, 60])
    assert (robot.limits.lower[2], robot.limits.upper[2]) == (-1.0, 2.0)
    assert (
        (robot.limits.acceleration == 8.0).all()
        and np.isinf(robot.limits.jerk).all()
        and np.isinf(robot.limits.torque_rate).all()
    )


def test_a_urdf_without_limits_loads_once_they_are_given():
    path = robots_folder() / "double_pendulum_description/urdf/double_pendulum_simple.urdf"
    with pytest.raises(eo.InputError, match=r"joint1.*position_limits"):
        eo.load_robot(path)
    with pytest.raises(eo.InputError, match=r"joint1.*effort=\"0\".*torque_limits"):
        eo.load_robot(path, position_limits=(-3, 3), velocity_limits=5)
    robot = eo.load_robot(path, position_limits=(-3, 3), velocity_limits=5, torque_limits=2)
    assert robot.name == "2dof_planar" and (robot.limits.torque == 2).all()


def test_infinite_limits_are_allowed_where_they_mean_something(tmp_path):
    path = factory.write(tmp_path, factory.pendulum(velocity=np.inf, effort=np.inf))
    robot = eo.load_robot(path)
    assert np.isinf(robot.limits.velocity).all() and np.isinf(robot.limits.torque).all()
    assert pin.buildModelFromXML(robot.urdf).nv == 1
    with pytest.raises(eo.InputError, match=r"joint1.*not finite"):
        eo.load_robot(path, position_limits=(-np.inf, np.inf))


def test_the_catalogue_without_its_data_says_what_to_install(monkeypatch):
    monkeypatch.setattr(import_module("energyopt.robots.catalogue"), "_share_folders", list)
    with pytest.raises(eo.EnergyOptError, match="pip install example-robot-data"):
        eo.load_robot("panda")


def test_loaded_arrays_cannot_be_changed_by_accident():
    robot = eo.load_robot("ur3")
    for array in (*vars(robot.limits).values(), robot.home, robot.dynamics.viscous_friction):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
