"""Plans among obstacles in files: everything they keep clear of comes back bit for bit, and is judged and replayed the same."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_io_results import plan_of

import energyopt as eo
from energyopt.errors import FileError
from energyopt.geometry.shapes import Sphere as SphereShape
from energyopt.io.archive import npz_bytes, read_npz
from energyopt.verification import verify

START, GOAL = np.array([0.0, -1, 1, 0, 0.5, 0]), np.zeros(6)


def pose(seed):
    """A pose whose numbers have all their digits."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.uniform(2, 3, 3)
    return matrix


def everything():
    """Every kind of shape and of motion, workspaces, a tool, a potential."""
    rng = np.random.default_rng(0)
    turning = eo.Moving(pose(1), velocity=(0.1, 0.2, 0.3), angular_velocity=(1, 2, 3))
    stations = eo.Moving([pose(2), pose(3), pose(4)], times=(0.0, 0.3, 0.9))
    curve = eo.Moving(lambda t: (2 + np.sin(t), 2, 2 + np.cos(3 * t)), times=1.1)
    obstacles = [
        eo.Sphere(0.1, pose(5), "ball"),
        eo.Capsule(0.1, 1 / 3, turning),
        eo.Box((0.1, 0.2, 1 / 7), stations, name="part"),
        eo.Cylinder(0.05, 0.4, curve),
        eo.HalfSpace((1, 2, 3), -4.0, pose(6)),
        eo.ConvexMesh(points=rng.normal(size=(40, 3)), pose=pose(7) + 3 * np.eye(4, k=3), name="stone"),
    ]
    workspace = [eo.Box((9, 9, 9), pose(8)), eo.Workspace(eo.HalfSpace((-1, 0, 0.3), -2.0, name="window"), ["tool0", "ee_link"])]
    attached = [eo.Attached(eo.Box((0.1, 0.1, 0.02), (0, 0, 0.1 / 3)), "tool0", "tray")]
    return {
        "obstacles": obstacles, "workspace": workspace, "attached": attached, "clearance": 0.1 / 3,
        "potential": eo.RepulsivePotential(1 / 3, 0.15), "self_collision": False,
    }  # fmt: skip


@pytest.fixture(scope="module")
def plan():
    return plan_of(eo.Problem(eo.load_robot("ur5"), START, GOAL, 1.1, **everything()))


@pytest.fixture()
def saved(plan, tmp_path):
    plan.save(tmp_path / "plan.npz")
    return tmp_path / "plan.npz"


def same_bits(ours, theirs):
    return np.asarray(ours).tobytes() == np.asarray(theirs).tobytes()


def test_obstacles_come_back_bit_for_bit(plan, saved):
    loaded = eo.load_plan(saved).problem
    assert len(loaded.obstacles) == 6
    for ours, theirs in zip(plan.problem.obstacles, loaded.obstacles, strict=True):
        assert (type(ours), ours.name, ours.moves) == (type(theirs), theirs.name, theirs.moves)
        for key in ("radius", "length", "size", "normal", "offset", "points"):
            assert same_bits(getattr(ours, key, 0), getattr(theirs, key, 0)), key
        for key in ("pose", "velocity", "angular_velocity", "times", "smooth") if ours.moves else ():
            assert same_bits(getattr(ours.pose, key), getattr(theirs.pose, key)), key
        for t in (0.0, 0.123, 0.77, 5.0):
            assert same_bits(ours.pose_at(t), theirs.pose_at(t))


def test_all_else_that_a_problem_keeps_clear_of_comes_back_too(plan, saved):
    ours, theirs = plan.problem, eo.load_plan(saved).problem
    for a, b in zip(ours.workspace, theirs.workspace, strict=True):
        assert a.frames == b.frames and a.region.name == b.region.name and same_bits(a.region.pose, b.region.pose)
        for key in ("size", "normal", "offset"):
            assert same_bits(getattr(a.region, key, 0), getattr(b.region, key, 0))
    (a,), (b,) = ours.attached, theirs.attached
    assert (a.name, a.frame) == (b.name, b.frame) == ("tray", "tool0")
    assert same_bits(a.shape.pose, b.shape.pose) and same_bits(a.shape.size, b.shape.size)
    assert (theirs.clearance, theirs.self_collision) == (ours.clearance, False)
    for key in ("gain", "safe_distance", "minimum_distance"):
        assert getattr(ours.potential, key) == getattr(theirs.potential, key)


def test_saving_a_loaded_plan_gives_the_same_file(saved, tmp_path):
    eo.load_plan(saved).save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == saved.read_bytes()


def test_a_loaded_plan_is_judged_and_replayed_the_same(tmp_path):
    """A motion that passes a board and hits a part that comes by."""
    part = eo.Box(0.2, eo.Moving((0.9, -0.5, 0.4), velocity=(-0.2, 1.0, 0)), name="part")
    obstacles = [eo.Box((0.5, 0.5, 0.02), (0.5, 0.2, 0.02), "board"), part]
    plan = plan_of(eo.Problem(eo.load_robot("ur5"), START, GOAL, 1.1, obstacles=obstacles, clearance=0.02))
    plan.save(tmp_path / "plan.npz")
    loaded = eo.load_plan(tmp_path / "plan.npz")
    assert verify(loaded.problem, loaded.trajectory) == verify(plan.problem, plan.trajectory)
    ours, theirs = eo.replay(plan, physics_step=1e-3), eo.replay(loaded, physics_step=1e-3)
    assert {touch.second for touch in ours.touches} >= {"part"}
    assert theirs.touches == ours.touches
    assert same_bits(ours.contacts, theirs.contacts) and same_bits(ours.q, theirs.q)
    a, b = (eo.validate(p, log).as_dict() for p, log in ((plan, ours), (loaded, theirs)))
    assert a == b and a["clearance"]["pair"] == b["clearance"]["pair"] != ""


@dataclass(frozen=True, eq=False)
class Egg(SphereShape):
    """A shape that the package does not know."""


def test_a_shape_that_no_file_can_hold_is_refused_before_anything_is_written(plan, tmp_path):
    problem = eo.Problem(eo.load_robot("ur5"), START, GOAL, 1.1, obstacles=[Egg(0.1, (2, 0, 0), "easter")])
    with pytest.raises(FileError, match="'easter' is a Egg; a file can hold sphere, capsule, box"):
        plan_of(problem).save(tmp_path / "plan.npz")
    assert list(tmp_path.iterdir()) == []


def test_a_plan_with_a_potential_is_read_where_the_meshes_are_gone(saved, tmp_path):
    """Then the potential's part of J cannot be recomputed; the rest is."""
    moved(saved, lambda meta: meta["robot"].update(package_dirs=[str(tmp_path / "none")], source=None))
    assert eo.load_plan(saved).problem.potential is not None


def moved(path, change):
    arrays = read_npz(path)
    meta = json.loads(arrays["meta"].tobytes())
    change(meta)
    path.write_bytes(npz_bytes(arrays | {"meta": np.frombuffer(json.dumps(meta).encode(), np.uint8)}))


def first_obstacle(change):
    return lambda path: moved(path, lambda meta: change(meta["problem"]["obstacles"][0]))


def numbers(change):
    return lambda path: path.write_bytes(npz_bytes(read_npz(path) | {"problem.shapes": change(read_npz(path)["problem.shapes"])}))


DAMAGE = {
    "an unknown shape": first_obstacle(lambda shape: shape.update(kind="pyramid")),
    "a shape with a file": first_obstacle(lambda shape: shape["own"].update(path=[])),
    "a shape of another size": first_obstacle(lambda shape: shape["own"].update(radius=[2])),
    "a negative size": first_obstacle(lambda shape: shape["own"].update(radius=[-1])),
    "a size of a billion": first_obstacle(lambda shape: shape["own"].update(radius=[10**9, 10**9, 10**9])),
    "a pose with a function": first_obstacle(lambda shape: shape.update(moving={"__init__": []})),
    "no obstacles": lambda path: moved(path, lambda meta: meta["problem"].pop("obstacles")),
    "obstacles in words": lambda path: moved(path, lambda meta: meta["problem"].update(obstacles="many")),
    "a wall for nobody": lambda path: moved(path, lambda meta: meta["problem"]["workspace"][1].update(frames=["nose"])),
    "numbers missing": numbers(lambda row: row[:-1]),
    "numbers too many": numbers(lambda row: np.append(row, 0.0)),
    "numbers that are nan": numbers(lambda row: np.full_like(row, np.nan)),
    "no numbers": numbers(lambda row: row[:0]),
    "sheared poses": numbers(lambda row: 1.01 * row),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_obstacles_are_refused_in_one_line(damage, saved):
    DAMAGE[damage](saved)
    with pytest.raises(FileError) as caught:
        eo.load_plan(saved)
    message = str(caught.value)
    assert str(saved) in message and "\n" not in message and len(message) < 600
