"""Obstacles, workspace, potential and tools in problem files: what they mean, and one clear line for every wrong one."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import energyopt as eo
from energyopt.errors import InputError, ProblemError
from energyopt.geometry.shapes import SHAPES
from energyopt.io.avoidance_schema import SIZES, sizes_of

UR5 = """
[robot]
name = "ur5"
[problem]
start = [0, -1, 1, 0, 0.5, 0]
goal = [1.0, -1.2, 0.7, 0, 0, 0]
duration = 1
"""
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


def written(folder, text, name="task.toml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def stl(path, corners=TETRAHEDRON, faces=((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))):
    """A binary STL file."""
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(corners[list(face)]), 0) for face in faces)
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + triangles)


EVERYTHING = """
[[obstacles]]
type = "sphere"
name = "ball"
radius = 0.1
position = [1, 2, 3]

[[obstacles]]
type = "capsule"
radius = 0.1
length = 0.5
quaternion = [0.5, 0.5, 0.5, 0.5]

[[obstacles]]
type = "box"
size = 0.2
position = [2, 0, 0]
rpy = [0, 0, 1.0]
velocity = [0, 0.3, 0]
angular_velocity = [0, 0, 2]

[[obstacles]]
type = "cylinder"
radius = 0.05
length = 1

[[obstacles.waypoints]]
time = 0
position = [2, 2, 0]

[[obstacles.waypoints]]
time = 1
position = [2, 3, 0]
rpy = [0, 0, 1.5]

[[obstacles]]
type = "half-space"
normal = [0, 0, 2]
offset = -0.5

[[obstacles]]
type = "mesh"
mesh = "parts/corner.stl"
scale = 0.001
position = [3, 0, 0]

[[workspace]]
type = "box"
size = [4, 4, 4]

[[workspace]]
type = "half-space"
name = "window"
normal = [-1, 0, 0]
offset = -1.5
frames = ["tool0", "ee_link"]

[[attached]]
type = "box"
name = "tray"
size = [0.1, 0.1, 0.02]
position = [0, 0, 0.05]
frame = "tool0"

[potential]
gain = 2
safe_distance = 0.15
minimum_distance = 0.02
"""


@pytest.fixture()
def folder(tmp_path):
    (tmp_path / "parts").mkdir()
    stl(tmp_path / "parts" / "corner.stl", 1000 * TETRAHEDRON)
    return tmp_path


def test_a_file_says_what_the_python_call_says(folder):
    text = UR5 + "clearance = 0.02\nself_collision = false\n" + EVERYTHING
    problem = eo.load_problem(written(folder, text))
    ball, capsule, box, cylinder, plane, mesh = problem.obstacles
    assert (ball.name, ball.radius, ball.pose[:3, 3].tolist()) == ("ball", 0.1, [1, 2, 3])
    # The quaternion (1, 1, 1, 1)/2 turns x to y, y to z, z to x.
    assert (capsule.radius, capsule.length) == (0.1, 0.5)
    np.testing.assert_allclose(capsule.pose[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)
    np.testing.assert_array_equal(box.size, [0.2, 0.2, 0.2])
    np.testing.assert_allclose(box.pose_at(2.0)[:3, 3], [2, 0.6, 0], atol=1e-15)
    np.testing.assert_allclose(box.pose_at(2.0)[:3, :3], Rotation.from_euler("z", 5.0).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(cylinder.pose_at(0.5)[:3, 3], [2, 2.5, 0], atol=1e-15)
    np.testing.assert_allclose(cylinder.pose_at(0.5)[:3, :3], Rotation.from_euler("z", 0.75).as_matrix(), atol=1e-15)
    assert not cylinder.pose.smooth
    np.testing.assert_array_equal(plane.normal, [0, 0, 1])
    assert plane.offset == -0.5
    np.testing.assert_allclose(np.sort(mesh.points, axis=0), np.sort(TETRAHEDRON, axis=0), atol=1e-15)
    room, window = problem.workspace
    assert room.frames == () and room.region.size.tolist() == [4, 4, 4]
    assert window.frames == ("tool0", "ee_link") and window.region.name == "window"
    (tray,) = problem.attached
    assert (tray.name, tray.frame, tray.shape.size.tolist()) == ("tray", "tool0", [0.1, 0.1, 0.02])
    potential = problem.potential
    assert (potential.gain, potential.safe_distance, potential.minimum_distance) == (2, 0.15, 0.02)
    assert problem.clearance == 0.02 and problem.self_collision is False


def test_without_these_sections_a_problem_has_no_obstacles(tmp_path):
    problem = eo.load_problem(written(tmp_path, UR5))
    assert (problem.obstacles, problem.workspace, problem.attached, problem.potential) == ((), (), (), None)
    assert problem.clearance == 0 and problem.self_collision is True


def test_degrees_turn_poses_and_turning_rates_too(tmp_path):
    text = """
    [[obstacles]]
    type = "box"
    size = 0.1
    position = [1, 0, 0]
    rpy = [0, 90, 0]
    angular_velocity = [0, 0, 90]
    velocity = [0.5, 0, 0]
    [workspace]
    type = "half-space"
    normal = [0, 0, 1]
    rpy = [180, 0, 0]
    offset = -2
    """
    problem = eo.load_problem(written(tmp_path, 'angles = "deg"\n' + UR5 + text))
    (box,), (ceiling,) = problem.obstacles, problem.workspace
    np.testing.assert_allclose(box.pose_at(0.0)[:3, :3], Rotation.from_euler("y", 90, degrees=True).as_matrix(), atol=1e-15)
    turned = Rotation.from_euler("z", 90, degrees=True) * Rotation.from_euler("y", 90, degrees=True)
    np.testing.assert_allclose(box.pose_at(1.0)[:3, :3], turned.as_matrix(), atol=1e-15)
    np.testing.assert_allclose(box.pose_at(1.0)[:3, 3], [1.5, 0, 0], atol=1e-15)
    assert ceiling.walls[0].distance([[0, 0, 1.5]]) == pytest.approx(0.5)


def test_smooth_waypoints_and_one_frame_alone(tmp_path):
    text = """
    [[obstacles]]
    type = "sphere"
    radius = 0.1
    smooth = true
    waypoints = [{time = 0, position = [1, 1, 0]}, {time = 0.5, position = [1, 2, 0]}, {time = 1, position = [1, 1, 0]}]
    [workspace]
    type = "box"
    size = 3
    frames = "tool0"
    """
    problem = eo.load_problem(written(tmp_path, UR5 + text))
    assert problem.obstacles[0].pose.smooth and problem.obstacles[0].pose.times.tolist() == [0, 0.5, 1]
    assert problem.workspace[0].frames == ("tool0",)


def test_every_shape_can_be_written_in_a_file():
    for kind in SHAPES:
        assert sizes_of(kind) and set(sizes_of(kind)) <= set(SIZES)


BALL = '[[obstacles]]\ntype = "sphere"\nradius = 0.1\n'
MESH = '[[obstacles]]\ntype = "mesh"\n'
MOVES = '[[obstacles]]\ntype = "sphere"\nradius = 0.1\n[[obstacles.waypoints]]\ntime = 0\nposition = [1, 0, 0]\n'
POTENTIAL = "[potential]\ngain = 1\nsafe_distance = 0.1\n"
WRONG = {
    "unknown type": ('[[obstacles]]\ntype = "ball"', 'obstacles[0].type is "ball"; expected one of sphere, capsule, box'),
    "no type": ("[[obstacles]]\nradius = 1", "obstacles[0].type is missing; expected one of sphere"),
    "no size": ('[[obstacles]]\ntype = "capsule"\nradius = 1', "obstacles[0].length is missing; expected a number > 0 [m]"),
    "no mesh": (MESH, "obstacles[0].mesh is missing; expected the path of an STL or OBJ file"),
    "negative radius": (BALL.replace("0.1", "-0.1"), "obstacles[0].radius is -0.1; expected a number > 0 [m]"),
    "negative size": ('[[obstacles]]\ntype = "box"\nsize = [1, -1, 1]', "size is [1.0, -1.0, 1.0]; expected three positive"),
    "two sizes": ('[[obstacles]]\ntype = "box"\nsize = [1, 1]', "obstacles[0].size is [1, 1]; expected a number > 0 [m] or"),
    "millimetres": (BALL.replace("0.1", "50000"), "radius is 50000; expected a positive number of metres, at most 10000"),
    "another's size": (BALL + "size = 1", "obstacles[0].size is 1; expected only with box"),
    "nan in a pose": (BALL + "position = [0, nan, 0]", "obstacles[0].position[1] is nan; expected a finite number"),
    "infinite velocity": (BALL + "velocity = [inf, 0, 0]", "obstacles[0].velocity[0] is inf; expected a finite number"),
    "position of two": (BALL + "position = [0, 1]", "obstacles[0].position is [0, 1]; expected three numbers [m]"),
    "far away": (BALL + "position = [0, 1e6, 0]", "its position is [0.0, 1000000.0, 0.0]; expected metres, at most 10000"),
    "quaternion of norm 2": (BALL + "quaternion = [2, 0, 0, 0]", "quaternion is [2, 0, 0, 0], of norm 2; expected norm 1"),
    "two orientations": (BALL + "quaternion = [1, 0, 0, 0]\nrpy = [0, 0, 0]", "obstacles[0] has both quaternion and rpy"),
    "degrees": (BALL + "rpy = [0, 0, 180]", "obstacles[0].rpy is [0, 0, 180]; looks like degrees"),
    "zero normal": ('[[obstacles]]\ntype = "half-space"\nnormal = [0, 0, 0]', "normal is [0.0, 0.0, 0.0]; expected a direction"),
    "unknown key": (BALL + "colour = 1", "obstacles[0].colour is not a known key; expected one of type, name, radius"),
    "nearly a key": (BALL + "postion = [0, 0, 1]", "obstacles[0].postion is not a known key; did you mean position"),
    "one table": ('[obstacles]\ntype = "sphere"\nradius = 1', "expected a list of tables, each under [[obstacles]]"),
    "same name": (2 * (BALL + 'name = "a"\n'), 'obstacles[1].name is "a", as that of obstacles[0]; expected a name of its own'),
    "name of a link": (BALL + 'name = "tool0"', 'obstacles[0].name is "tool0", as a frame of the robot'),
    "missing mesh": (MESH + 'mesh = "none.stl"', "obstacles[0]: mesh 'none.stl': no such file"),
    "mesh outside": (MESH + 'mesh = "../task.stl"', "mesh '../task.stl': leads outside the folder"),
    "mesh at a root": (MESH + 'mesh = "/etc/passwd"', "mesh '/etc/passwd': leads outside the folder"),
    "huge mesh": (MESH + 'mesh = "huge.stl"', "mesh 'huge.stl': larger than 20 MB"),
    "damaged mesh": (MESH + 'mesh = "damaged.stl"', "mesh 'damaged.stl': damaged STL"),
    "flat mesh": (MESH + 'mesh = "flat.stl"', "mesh 'flat.stl': its 3 points enclose no volume"),
    "mesh in millimetres": (MESH + 'mesh = "corner.stl"\nscale = 1e6', "a file in millimetres wants scale=0.001"),
    "mesh of another kind": (MESH + 'mesh = "part.step"', "'.step' is no mesh format known here"),
    "mesh that is a number": (MESH + "mesh = 5", "obstacles[0].mesh is 5; expected the path of an STL or OBJ file"),
    "scale of zero": (MESH + 'mesh = "corner.stl"\nscale = 0', "scale is [0.0, 0.0, 0.0]; expected factors other than zero"),
    "one waypoint": (MOVES, "obstacles[0].waypoints: Moving: times is [0]; expected 2 to"),
    "no waypoints": (BALL + "waypoints = []", "obstacles[0].waypoints: Moving: times is []; expected 2 to"),
    "falling times": (MOVES + "[[obstacles.waypoints]]\ntime = -1\nposition = [1, 0, 0]", "times[1] is -1 s after 0 s; expected"),
    "waypoint without time": (MOVES.replace("time = 0\n", ""), "obstacles[0].waypoints[0].time is missing; expected a"),
    "waypoint far away": (
        MOVES + "[[obstacles.waypoints]]\ntime = 1\nposition = [1e5, 0, 0]",
        "pose at 1 s: its position is [100000.0, 0.0, 0.0]; expected metres",
    ),
    "two motions": (BALL + "velocity = [1, 0, 0]\nwaypoints = [{time = 0, position = [0, 0, 0]}]", "velocity is given beside"),
    "smooth at rest": (BALL + "smooth = true", "obstacles[0].smooth is given without waypoints"),
    "workspace of another type": ('[workspace]\ntype = "sphere"', 'workspace.type is "sphere"; expected one of box, half-space'),
    "workspace that moves": ('[workspace]\ntype = "box"\nsize = 1\nvelocity = [1, 0, 0]', "workspace.velocity is not a known"),
    "workspace frame": (
        '[[workspace]]\ntype = "box"\nsize = 1\n[[workspace]]\ntype = "box"\nsize = 1\nframes = ["tol0"]',
        "workspace[1].frames: ur5: no frame named 'tol0'",
    ),
    "workspace frames": ('[workspace]\ntype = "box"\nsize = 1\nframes = 3', "workspace.frames is 3; expected the name of a link"),
    "attached frame": ('[attached]\ntype = "sphere"\nradius = 0.1\nframe = "hand"', "attached.frame: ur5: no frame named 'hand'"),
    "attached half-space": ('[attached]\ntype = "half-space"', 'attached.type is "half-space"; expected one of sphere'),
    "attached name": ('[attached]\ntype = "box"\nsize = 1\nname = "tool0"', 'attached.name is "tool0", as a frame of the robot'),
    "potential without gain": ("[potential]\nsafe_distance = 0.1", "potential.gain is missing; expected a number > 0"),
    "attractive potential": (POTENTIAL.replace("gain = 1", "gain = -1"), "potential.gain is -1; expected a number > 0"),
    "potential distances": (POTENTIAL + "minimum_distance = 0.2", "minimum_distance is 0.2 m; expected below safe_distance"),
    "negative clearance": ("clearance = -1", "problem.clearance is -1; expected a number ≥ 0 [m]"),
    "clearance in millimetres": ("clearance = 20", "problem.clearance is 20: expected metres, 0 to 10"),
    "self-collision in words": ('self_collision = "no"', 'problem.self_collision is "no"; expected true or false'),
    "clearance elsewhere": (POTENTIAL + "clearance = 1", "potential.clearance is not a known key; it belongs under [problem]"),
}


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """A folder with good and bad mesh files."""
    folder = tmp_path_factory.mktemp("meshes")
    stl(folder / "corner.stl")
    stl(folder / "flat.stl", TETRAHEDRON[:3], faces=4 * [(0, 1, 2)])
    (folder / "damaged.stl").write_bytes(b"\0" * 200)
    (folder / "part.step").write_text("ISO-10303-21;")
    with (folder / "huge.stl").open("wb") as file:
        file.truncate(21_000_000)
    return folder


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused_in_one_line_that_names_it(case, meshes):
    text, expected = WRONG[case]
    path = written(meshes, UR5 + text)
    with pytest.raises(InputError) as caught:
        eo.load_problem(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:")
    assert expected in message
    assert "\n" not in message and len(message) < 1000


def test_the_line_of_the_offending_value_is_named(tmp_path):
    """Also inside tables of tables, whose places count within each obstacle."""
    text = UR5 + 2 * MOVES + "[[obstacles.waypoints]]\ntime = 1\nposition = [1, 0]\n" + BALL + "position = 3\n"
    lines = text.split("\n")
    number = lines.index("position = [1, 0]") + 1
    with pytest.raises(ProblemError, match=rf"task\.toml:{number}: obstacles\[1\]\.waypoints\[1\]\.position"):
        eo.load_problem(written(tmp_path, text))
    text = text.replace("position = [1, 0]\n", "position = [1, 0, 1]\n")
    with pytest.raises(ProblemError, match=r"obstacles\[0\]\.waypoints: Moving"):
        eo.load_problem(written(tmp_path, text.replace("position = 3", "position = [0, 0, 1]")))
    with pytest.raises(ProblemError, match=rf"task\.toml:{lines.index('position = 3') + 1}: obstacles\[2\]\.position is 3"):
        eo.load_problem(written(tmp_path, text))
    mesh = UR5 + BALL + MESH + 'position = [0, 0, 0]\nmesh = "none.stl"\n'
    with pytest.raises(ProblemError, match=rf"task\.toml:{mesh.count(chr(10))}: obstacles\[1\]: mesh 'none\.stl'"):
        eo.load_problem(written(tmp_path, mesh))


def test_a_link_out_of_the_folder_is_not_followed(tmp_path):
    (tmp_path / "task").mkdir()
    stl(tmp_path / "secret.stl")
    (tmp_path / "task" / "part.stl").symlink_to(tmp_path / "secret.stl")
    with pytest.raises(ProblemError, match="leads outside the folder"):
        eo.load_problem(written(tmp_path / "task", UR5 + MESH + 'mesh = "part.stl"'))
