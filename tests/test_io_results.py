"""Plans in files: they come back bit for bit, and no damaged or hostile file does anything but say so in one line."""

import csv
import io
import json
import os
import zipfile

import numpy as np
import pytest

import energyopt as eo
from energyopt.baselines import BASELINES, baseline
from energyopt.errors import FileError
from energyopt.io import write_atomic, write_csv, write_joint_trajectory
from energyopt.io.archive import npz_bytes, read_npz
from energyopt.plans import Plan, Status, Violations
from energyopt.verification import cost


def robot_with_everything():
    body = eo.Payload(mass=1.5, center=(0.01, 0.0, 0.05), inertia=(0.01, 0.01, 0.005), frame="tool0")
    friction = {"viscous_friction": 0.7, "coulomb_friction": [1, 2, 3, 1, 1, 1], "coulomb_velocity": 0.03}
    return eo.load_robot("ur5", payload=body, armature=0.1, gravity=(0, 1.0, -9.0), **friction)


def plan_of(problem, kind="quintic"):
    motion = baseline(problem, kind, goal=np.zeros(problem.robot.nv))
    terms = cost(problem, motion)
    found = Violations({"velocity": 0.0}, {"velocity": 3.25, "jerk": np.inf}, {"velocity": ("elbow_joint", 0.1)})
    options = {"parameterization": "BSpline", "knots": None, "seed": 3}
    return Plan(
        problem, Status.SOLVED, "fine", motion, sum(terms.values()), terms, found, None, 7, {"solve": 0.1}, 3, options, ("a",)
    )


@pytest.fixture(scope="module")
def plan():
    way = [([0.5, -1.1, 0.9, 0, 0.2, 0], 0.4), [0.7, -1.1, 0.9, 0, 0.2, 0]]
    limits = {"velocity_limits": [3, 3, 3, np.inf, 3, 3], "position_limits": (-3.0, [3, 3, 3, 3, 3, 2.0])}
    q0, q1 = [0, -1, 1, 0, 0.5, 0], [1.0, -1.2, 0.7, 0, 0, 0.3]
    problem = eo.Problem(robot_with_everything(), q0, q1, 1.1, [0.1] * 6, waypoints=way, goal_velocity=0.1, name="x", **limits)
    return plan_of(problem)


@pytest.fixture()
def saved(plan, tmp_path):
    path = tmp_path / "plan.npz"
    plan.save(path)
    return path


def test_a_saved_plan_loads_again_bit_for_bit(plan, saved):
    loaded = eo.load_plan(saved)
    t = np.linspace(0, plan.duration, 333)
    for order in range(4):
        assert loaded.trajectory(t, order).tobytes() == plan.trajectory(t, order).tobytes()
    assert loaded.torque(t).tobytes() == plan.torque(t).tobytes()
    for key in ("status", "message", "objective", "cost_terms", "violations", "iterations", "time_s", "seed", "options", "notes"):
        assert getattr(loaded, key) == getattr(plan, key)
    assert loaded.discretization_error is None


def test_robot_and_problem_of_a_loaded_plan_are_those_that_were_saved(plan, saved):
    ours, theirs = plan.problem, eo.load_plan(saved).problem
    assert theirs.robot.dynamics.digest == ours.robot.dynamics.digest
    for key in ("name", "joint_names", "tool_frame", "urdf", "notes", "package_dirs", "source", "srdf"):
        assert getattr(theirs.robot, key) == getattr(ours.robot, key)
    for robot_limits, other in ((ours.limits, theirs.limits), (ours.robot.limits, theirs.robot.limits)):
        for key, value in vars(robot_limits).items():
            assert np.asarray(value).tobytes() == np.asarray(getattr(other, key)).tobytes(), key
    for key in ("start", "goal", "velocity_weight", "torque_weights", "goal_velocity", "start_acceleration"):
        assert getattr(theirs, key).tobytes() == getattr(ours, key).tobytes()
    assert theirs.duration == ours.duration and theirs.name == "x"
    assert [w.time for w in theirs.waypoints] == [0.4, None]
    assert all(a.position.tobytes() == b.position.tobytes() for a, b in zip(ours.waypoints, theirs.waypoints, strict=True))


def test_saving_a_loaded_plan_gives_the_same_file(saved, tmp_path):
    eo.load_plan(saved).save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == saved.read_bytes()


@pytest.mark.parametrize("kind", list(BASELINES))
def test_every_kind_of_trajectory_is_saved_exactly(kind, tmp_path):
    problem = eo.Problem(eo.load_robot("ur5"), [0, -1, 1, 0, 0.5, 0], np.zeros(6), 1.0)
    plan = plan_of(problem, kind)
    plan.save(tmp_path / "p.npz")
    t = np.linspace(0, 1, 100)
    assert eo.load_plan(tmp_path / "p.npz").trajectory(t, 1).tobytes() == plan.trajectory(t, 1).tobytes()


@pytest.mark.parametrize("rotation", [None, [1, 0, 0, 0]])
def test_a_cartesian_goal_is_saved(rotation, tmp_path):
    goal = eo.FramePose("tool0", [0.4, 0.1, 0.3], rotation)
    plan_of(eo.Problem(eo.load_robot("ur5"), [0, -1, 1, 0, 0.5, 0], goal, 1.0)).save(tmp_path / "p.npz")
    loaded = eo.load_plan(tmp_path / "p.npz").problem.goal
    assert loaded.frame == "tool0"
    np.testing.assert_array_equal(loaded.position, goal.position)
    np.testing.assert_array_equal(loaded.rotation, goal.rotation)


def rewritten(path, **changes):
    """The archive with some members replaced, or left out where the new value is None."""
    arrays = read_npz(path) | changes
    path.write_bytes(npz_bytes({key: value for key, value in arrays.items() if value is not None}))


def meta_with(path, change):
    meta = json.loads(read_npz(path)["meta"].tobytes())
    change(meta)
    rewritten(path, meta=np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8))


def as_urdf(text):
    return np.frombuffer(text.encode(), dtype=np.uint8)


DAMAGE = {
    "a start with too few joints": lambda p: rewritten(p, **{"problem.start": np.zeros(5)}),
    "a start that is nan": lambda p: rewritten(p, **{"problem.start": np.full(6, np.nan)}),
    "no start": lambda p: rewritten(p, **{"problem.start": None}),
    "whole numbers for a start": lambda p: rewritten(p, **{"problem.start": np.zeros(6, dtype=np.int64)}),
    "a negative duration": lambda p: rewritten(p, **{"problem.duration": np.array(-1.0)}),
    "inverted limits": lambda p: rewritten(p, **{"robot.limits.lower": np.full(6, 9.0)}),
    "an infinite armature": lambda p: rewritten(p, **{"robot.armature": np.full(6, np.inf)}),
    "a negative degree": lambda p: rewritten(p, **{"trajectory.degree": np.array(-3)}),
    "a degree of a billion": lambda p: rewritten(p, **{"trajectory.degree": np.array(10**9)}),
    "coefficients that are nan": lambda p: rewritten(p, **{"trajectory.coefficients": np.full((9, 6), np.nan)}),
    "coefficients of another robot": lambda p: rewritten(p, **{"trajectory.coefficients": np.zeros((12, 7))}),
    "knots out of order": lambda p: rewritten(p, **{"trajectory.knots": read_npz(p)["trajectory.knots"][::-1].copy()}),
    "no knots": lambda p: rewritten(p, **{"trajectory.knots": np.zeros(0)}),
    "waypoints of another shape": lambda p: rewritten(p, **{"problem.waypoints": np.zeros((2, 5))}),
    "no metadata": lambda p: rewritten(p, meta=None),
    "metadata that is no JSON": lambda p: rewritten(p, meta=as_urdf("{")),
    "metadata nested too deeply": lambda p: rewritten(p, meta=as_urdf("[" * 200_000)),
    "metadata that is a list": lambda p: rewritten(p, meta=as_urdf("[]")),
    "metadata of a later version": lambda p: meta_with(p, lambda m: m.update(version=99)),
    "an unknown status": lambda p: meta_with(p, lambda m: m["plan"].update(status="GREAT")),
    "an objective in words": lambda p: meta_with(p, lambda m: m["plan"].update(objective="low")),
    "violations that are a list": lambda p: meta_with(p, lambda m: m["plan"].update(violations=[1])),
    "an unknown trajectory": lambda p: meta_with(p, lambda m: m.update(kind="magic")),
    "a tool that is not there": lambda p: meta_with(p, lambda m: m["robot"].update(tool_frame="nose")),
    "a urdf that is no xml": lambda p: rewritten(p, urdf=as_urdf("<robot")),
    "a urdf with entities": lambda p: rewritten(p, urdf=as_urdf('<!DOCTYPE r [<!ENTITY a "b">]><robot name="&a;"/>')),
    "a urdf without joints": lambda p: rewritten(p, urdf=as_urdf('<robot name="r"><link name="a"/></robot>')),
    "a urdf of another robot": lambda p: rewritten(p, urdf=as_urdf(eo.load_robot("panda").urdf)),
    "no zip": lambda p: p.write_bytes(b"hello"),
    "an empty file": lambda p: p.write_bytes(b""),
    "half a zip": lambda p: p.write_bytes(p.read_bytes()[: p.stat().st_size // 2]),
    "an empty zip": lambda p: p.write_bytes(npz_bytes({})),
    "another archive": lambda p: p.write_bytes(npz_bytes({"x": np.zeros(3)})),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_plan_is_refused_in_one_line(damage, saved):
    DAMAGE[damage](saved)
    with pytest.raises(FileError) as caught:
        eo.load_plan(saved)
    message = str(caught.value)
    assert str(saved) in message and "\n" not in message and len(message) < 600


def test_any_single_flipped_byte_is_refused_or_harmless(saved):
    data, rng = saved.read_bytes(), np.random.default_rng(5)
    for position in rng.integers(0, len(data), 120):
        changed = bytearray(data)
        changed[position] ^= 1 << int(rng.integers(8))
        saved.write_bytes(bytes(changed))
        try:
            eo.load_plan(saved)
        except FileError as error:
            assert "\n" not in str(error)


def member(header, content=b""):
    """A zip with one .npy member of a handmade header."""
    text = header.encode() + b"\n"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content)
    return buffer.getvalue()


HOSTILE = {
    "pickled objects": member("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"cos\nsystem\n(S'echo'\ntR."),
    "a terabyte in the header": member("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}", b"12345678"),
    "a negative shape": member("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}", b"12345678"),
    "an overflowing shape": member("{'descr': '<f8', 'fortran_order': False, 'shape': (4294967296, 4294967296)}"),
    "a record type": member("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,)}", b"12345678"),
    "code in the header": member("__import__('os').getcwd()"),
    "many dimensions": member("{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1, 1, 1)}", b"12345678"),
    "a header longer than any": member("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}" + " " * 20_000, b"12345678"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_lying_archive_is_refused_before_it_is_believed(case, tmp_path):
    path = tmp_path / "x.npz"
    path.write_bytes(HOSTILE[case])
    with pytest.raises(FileError):
        read_npz(path)


def test_an_archive_that_would_unpack_to_gigabytes_is_refused_unread(tmp_path):
    path, block = tmp_path / "bomb.npz", bytes(10_000_000)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w", force_zip64=True) as stream:
        for _ in range(45):
            stream.write(block)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(FileError, match="would unpack to 450 MB"):
        read_npz(path)


CHANGED = {
    "motion": ("trajectory.coefficients", lambda c: np.where(np.arange(len(c))[:, None] == 4, c + 1e-4, c)),
    "weight": ("problem.velocity_weight", lambda w: 1.001 * w),
    "gravity": ("robot.gravity", lambda g: g + [0.0, 0.0, 1e-3]),
    "friction": ("robot.viscous_friction", lambda d: 1.01 * d),
}


@pytest.mark.parametrize("what", CHANGED)
def test_a_plan_changed_in_its_file_no_longer_gives_the_cost_it_states(what, saved):
    name, change = CHANGED[what]
    arrays = read_npz(saved)
    saved.write_bytes(npz_bytes(arrays | {name: change(arrays[name])}))
    with pytest.raises(FileError, match=r"of J is stated as .*, its motion gives .*: the file was changed") as caught:
        eo.load_plan(saved)
    assert "\n" not in str(caught.value)


def test_a_stated_cost_that_is_not_the_sum_of_its_terms_is_refused(saved):
    arrays = read_npz(saved)
    meta = json.loads(arrays["meta"].tobytes())
    meta["plan"]["objective"] *= 0.99
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    saved.write_bytes(npz_bytes(arrays))
    with pytest.raises(FileError, match=r"J is stated as .*the file was changed"):
        eo.load_plan(saved)


def test_a_name_without_suffix_gets_one_and_is_found_again(plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plan.save("swing")
    plan.save(tmp_path / "other.plan")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other.plan", "swing.npz"]
    (tmp_path / "swing").mkdir()
    for name in ("swing", "swing.npz", tmp_path / "swing", "other.plan"):
        assert eo.load_plan(name).objective == plan.objective
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileError, match="folder: is not a regular file"):
        plan.save("folder")
    with pytest.raises(FileError, match="none: no such file"):
        eo.load_plan("none")


@pytest.mark.parametrize("path", [5, None, "", b"plan", np.zeros((2, 1))])
def test_what_is_no_file_name_is_refused_for_saving(plan, path):
    with pytest.raises(FileError, match=r"^.*: expected the name of a file$"):
        plan.save(path)
    with pytest.raises(FileError, match="expected the name of a file"):
        eo.load_plan(path)


def test_names_that_are_no_plan_file_are_refused(tmp_path):
    for path in (tmp_path / "none.npz", tmp_path, "", "a\0b"):
        with pytest.raises(FileError):
            eo.load_plan(path)


def test_an_archive_gives_back_arrays_of_any_order_and_shape(tmp_path):
    arrays = {"f": np.asfortranarray(np.arange(6.0).reshape(2, 3)), "s": np.array(3), "e": np.zeros((0, 2))}
    (tmp_path / "a.npz").write_bytes(npz_bytes(arrays))
    ours, theirs = read_npz(tmp_path / "a.npz"), np.load(tmp_path / "a.npz")
    for name, array in arrays.items():
        np.testing.assert_array_equal(ours[name], array)
        np.testing.assert_array_equal(theirs[name], array)
        assert ours[name].shape == array.shape


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "plan.npz"
    write_atomic(path, b"old")

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileError, match="No space left"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["plan.npz"]


def test_writing_to_a_folder_that_is_not_there_is_refused(tmp_path):
    for path in (tmp_path / "no" / "plan.npz", tmp_path, ""):
        with pytest.raises(FileError):
            write_atomic(path, b"")


def test_the_csv_holds_the_motion_with_units(plan, tmp_path):
    write_csv(plan, tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    names = plan.problem.robot.joint_names
    assert rows[0][:2] == ["t [s]", f"q_{names[0]} [rad]"]
    assert rows[0][-1] == f"tau_{names[-1]} [N m]"
    table = np.array(rows[1:], dtype=float)
    t = table[:, 0]
    assert t[0] == 0 and t[-1] == plan.duration
    assert np.all(np.diff(t) > 0) and np.diff(t).max() <= 0.01 * (1 + 1e-9)
    expected = np.column_stack([t, *(plan.trajectory(t, k) for k in range(3)), plan.torque(t)])
    np.testing.assert_array_equal(table, expected)


def test_the_joint_trajectory_has_the_shape_of_the_ros_message(plan, tmp_path):
    write_joint_trajectory(plan, tmp_path / "t.json", sample_time=0.25)
    message = json.loads((tmp_path / "t.json").read_text())
    assert message["joint_names"] == list(plan.problem.robot.joint_names)
    assert message["header"]["frame_id"] in plan.problem.robot.frame_names
    times = []
    for point in message["points"]:
        assert set(point) == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
        assert all(len(point[key]) == 6 for key in point if key != "time_from_start")
        stamp = point["time_from_start"]
        assert isinstance(stamp["sec"], int) and 0 <= stamp["nanosec"] < 1_000_000_000
        times.append(stamp["sec"] + 1e-9 * stamp["nanosec"])
    np.testing.assert_allclose(times, [0, 0.25, 0.5, 0.75, 1.0, 1.1], atol=1e-9)
    np.testing.assert_array_equal(message["points"][-1]["positions"], plan.trajectory(plan.duration))
