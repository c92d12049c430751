"""Bad shapes, poses and meshes: one clear line each; good mesh files are read as they are."""

import struct

import numpy as np
import pinocchio as pin
import pytest

from energyopt.errors import GeometryError, InputError
from energyopt.geometry.mesh_files import read_mesh
from energyopt.geometry.moving import Moving
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Sphere, workspace_walls

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], dtype=float)
FACES = [
    (0, 1, 3),
    (0, 3, 2),
    (4, 6, 7),
    (4, 7, 5),
    (0, 4, 5),
    (0, 5, 1),
    (2, 3, 7),
    (2, 7, 6),
    (0, 2, 6),
    (0, 6, 4),
    (1, 5, 7),
    (1, 7, 3),
]
MIRROR, SHEAR, TALL = np.diag([1.0, 1, -1, 1]), np.eye(4) + np.eye(4, k=1) * 0.1, np.eye(4) * [1, 1, 1, 2]

BAD = {
    "negative radius": (lambda: Sphere(-0.1), "sphere: radius is -0.1"),
    "zero radius": (lambda: Capsule(0.0, 1.0), "capsule: radius is 0"),
    "nan length": (lambda: Cylinder(0.1, np.nan), "cylinder: length is nan"),
    "text as radius": (lambda: Sphere("big"), "sphere: radius is 'big'"),
    "no radius": (lambda: Sphere(None), "sphere: radius is"),
    "millimetres": (lambda: Sphere(5e4), "at most 10000"),
    "negative size": (lambda: Box((0.1, -0.2, 0.3)), "box: size is"),
    "two sizes": (lambda: Box((0.1, 0.2)), "expected 3 numbers"),
    "size as text": (lambda: Box("1"), "box: size"),
    "ragged size": (lambda: Box([[1], [2, 3]]), "box: size is [[1], [2, 3]]"),
    "size of hundreds of digits": (lambda: Box(10**400), "box: size is 1000000"),
    "radius as digits": (lambda: Sphere("0.1"), "sphere: radius is '0.1'"),
    "nan pose": (lambda: Sphere(0.1, (0, np.nan, 0)), "sphere: pose"),
    "pose of five": (lambda: Sphere(0.1, (0, 0, 0, 0, 0)), "sphere: pose is"),
    "ragged pose": (lambda: Sphere(0.1, [[1, 2], [3]]), "sphere: pose is"),
    "mirrored pose": (lambda: Box(0.1, MIRROR), "it mirrors"),
    "sheared pose": (lambda: Box(0.1, SHEAR), "is no rotation"),
    "scaled last row": (lambda: Box(0.1, TALL), "last row"),
    "far pose": (lambda: Sphere(0.1, (1e6, 0, 0)), "its position is"),
    "name": (lambda: Sphere(0.1, name="a\nb"), "sphere: name"),
    "zero normal": (lambda: HalfSpace((0, 0, 0)), "half-space: normal"),
    "infinite offset": (lambda: HalfSpace((0, 0, 1), np.inf), "half-space: offset"),
    "flat workspace": (lambda: workspace_walls((1, 1, 0)), "workspace: size"),
    "no mesh": (lambda: ConvexMesh(), "mesh: path is None"),
    "flat mesh": (lambda: ConvexMesh(points=CORNERS * [1, 1, 0]), "not a flat sheet"),
    "mesh of rows": (lambda: ConvexMesh(points=[1, 2, 3]), "rows xyz"),
    "mesh scale": (lambda: ConvexMesh(points=CORNERS, scale=0), "other than zero"),
    "mesh in millimetres": (lambda: ConvexMesh(points=CORNERS * 1e4), "scale=0.001"),
    "unknown mesh format": (lambda: ConvexMesh("part.step"), "no mesh format"),
    "missing mesh": (lambda: ConvexMesh("missing.stl"), "no such file"),
    "nul in path": (lambda: ConvexMesh("a\0b.stl"), "mesh"),
    "velocity": (lambda: Moving((0, 0, 0), velocity=(1, 2)), "Moving: velocity"),
    "velocity and times": (lambda: Moving([np.eye(4)] * 2, velocity=(1, 0, 0), times=(0, 1)), "expected one of them"),
    "falling times": (lambda: Moving([np.eye(4)] * 3, times=(0, 2, 1)), "times[2]"),
    "one time": (lambda: Moving([np.eye(4)], times=(0,)), "2 to"),
    "poses missing": (lambda: Moving([np.eye(4)], times=(0, 1)), "holds 1 poses"),
    "bad waypoint": (lambda: Moving([np.eye(4), np.ones((4, 4))], times=(0, 1)), "pose at 1 s"),
    "function without times": (lambda: Moving(lambda t: (t, 0, 0)), "times is missing"),
    "function that fails": (lambda: Moving(lambda t: (1 / t, 0, 0), times=1.0), "ZeroDivisionError"),
    "function that returns text": (lambda: Moving(lambda t: "here", times=1.0), "pose at 0 s"),
    "points": (lambda: Sphere(0.1).distance([1, 2, 3]), "(N, 3)"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case):
    make, said = BAD[case]
    with pytest.raises(GeometryError) as caught:
        make()
    message = str(caught.value)
    assert said in message and "\n" not in message and len(message) < 500
    assert isinstance(caught.value, InputError)


def test_every_form_of_a_pose_means_the_same():
    pose = pin.SE3(pin.utils.rotate("x", 0.3), np.array([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(Sphere(0.1, pose).pose, Sphere(0.1, pose.homogeneous).pose)
    np.testing.assert_array_equal(Sphere(0.1, (1, 2, 3)).pose[:3, 3], (1, 2, 3))
    assert not Sphere(0.1, pose).pose.flags.writeable


def stl_binary(corners=CORNERS, header=b"solid but binary"):
    rows = [struct.pack("<12fH", 0, 0, 0, *np.ravel(corners[list(f)]), 0) for f in FACES]
    return header.ljust(80, b" ") + struct.pack("<I", len(rows)) + b"".join(rows)


def stl_ascii():
    lines = ["solid box"]
    for f in FACES:
        lines += [
            "facet normal 0 0 0",
            "outer loop",
            *(f"vertex {x:g} {y:g} {z:e}" for x, y, z in CORNERS[list(f)]),
            "endloop",
            "endfacet",
        ]
    return "\n".join([*lines, "endsolid box"]).encode()


def obj():
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]
    lines = ["# a box", "v 9 9 9 # used by no face"] + [f"v {x} {y} {z}" for x, y, z in CORNERS]
    return "\n".join(lines + ["f " + " ".join(f"{k + 2}//1" for k in q) for q in quads] + ["f -7 -3 -1 -5"]).encode()


@pytest.mark.parametrize("name, data", [("b.stl", stl_binary()), ("a.STL", stl_ascii()), ("o.obj", obj())])
def test_mesh_files_are_read_in_every_format(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    mesh = ConvexMesh(name, folder=tmp_path, scale=(0.1, 0.1, 0.2))
    np.testing.assert_allclose(sorted(mesh.points.tolist()), sorted((CORNERS * [0.1, 0.1, 0.2]).tolist()), atol=1e-15)
    assert mesh.hull.volume == pytest.approx(6 * 0.002)
    vertices, triangles = read_mesh(tmp_path / name, 10_000, "mesh")
    assert vertices.shape == (8, 3) and triangles.shape == (12, 3)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    assert abs(np.sum(np.einsum("ni,ni->n", a, np.cross(b, c))) / 6) == pytest.approx(6.0)


def test_a_mesh_forgets_its_file(tmp_path):
    from dataclasses import replace

    path = tmp_path / "b.stl"
    path.write_bytes(stl_binary())
    mesh = ConvexMesh(path, scale=0.001)
    path.unlink()
    moved = replace(mesh, pose=(1, 0, 0))
    np.testing.assert_allclose(moved.distance([[1.0005, 0.001, -0.002]]), [0.002], atol=1e-15)


@pytest.mark.parametrize(
    "name, data, said",
    [
        ("cut.stl", stl_binary()[:-7], "damaged STL"),
        ("long.stl", b"x" * 80 + struct.pack("<I", 1 << 31) + b"x" * 50, "damaged STL"),
        ("empty.stl", b"", "damaged STL"),
        ("nan.stl", stl_binary(CORNERS * [1, 1, np.nan]), "not finite"),
        ("word.stl", stl_ascii().replace(b"vertex 1 2", b"vertex one 2"), "not three numbers"),
        ("odd.stl", stl_ascii().replace(b"vertex 1 2", b"corner 1 2", 1), "expected three"),
        ("none.obj", b"v 0 0 0\n", "0 triangles"),
        ("index.obj", obj().replace(b"f 2//1", b"f 99//1"), "of 9"),
        ("two.obj", obj().replace(b"v 9 9 9", b"v 9 9"), "not three numbers"),
        ("big.stl", b"\0" * 20_000_001, "larger than 20 MB"),
    ],
)
def test_damaged_meshes_are_named(tmp_path, name, data, said):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(GeometryError, match=said) as caught:
        ConvexMesh(name, folder=tmp_path)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_a_mesh_stays_in_its_folder(tmp_path):
    inside = tmp_path / "problem"
    inside.mkdir()
    (tmp_path / "b.stl").write_bytes(stl_binary())
    (inside / "link.stl").symlink_to(tmp_path / "b.stl")
    for path in ("../b.stl", str(tmp_path / "b.stl"), "link.stl"):
        with pytest.raises(GeometryError, match="leads outside the folder"):
            ConvexMesh(path, folder=inside)
    (inside / "folder.stl").mkdir()
    with pytest.raises(GeometryError, match="not a regular file"):
        ConvexMesh("folder.stl", folder=inside)
