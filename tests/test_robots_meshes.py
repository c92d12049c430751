"""Mesh paths of a robot stay inside its package folders."""

from pathlib import Path

import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.errors import RobotError
from energyopt.robots import meshes, resolve_mesh

TRIANGLE = "solid t\nendsolid t\n"


@pytest.fixture
def package(tmp_path) -> Path:
    """A package ``arm`` with a mesh, its URDF folder, a neighbour package, and a secret beside them."""
    for file in ("ws/arm/meshes/link.stl", "ws/grip/meshes/jaw.stl", "ws/arm/package.xml", "ws/grip/package.xml", "secret.stl"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(TRIANGLE)
    (tmp_path / "ws/arm/urdf").mkdir()
    return tmp_path / "ws/arm"


def load(package: Path, mesh: str, **options):
    geometry = f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
    text = factory.pendulum().replace("</link>", geometry, 1)
    assert mesh in text
    return eo.load_robot(factory.write(package / "urdf", text), **options)


@pytest.mark.parametrize(
    ("uri", "file"),
    [
        ("package://arm/meshes/link.stl", "arm/meshes/link.stl"),
        ("package:///arm/meshes/link.stl", "arm/meshes/link.stl"),
        ("package://arm/urdf/../meshes/link.stl", "arm/meshes/link.stl"),
        ("package://grip/meshes/jaw.stl", "grip/meshes/jaw.stl"),
        ("../meshes/link.stl", "arm/meshes/link.stl"),
    ],
)
def test_meshes_of_the_package_and_its_neighbours_are_found(package, uri, file):
    assert resolve_mesh(load(package, uri), uri) == (package.parent / file).resolve()


def test_absolute_path_inside_the_package_is_found(package):
    file = package / "meshes/link.stl"
    for uri in (str(file), f"file://{file}"):
        assert resolve_mesh(load(package, uri), uri) == file.resolve()


@pytest.mark.parametrize(
    "uri",
    [
        "package://../../secret.stl",
        "package://arm/../../secret.stl",
        "package://arm/meshes/../../../../secret.stl",
        "package://..",
        "../../../secret.stl",
        "/etc/passwd",
        "file:///etc/passwd",
        "file:///%65tc/passwd",
        "https://example.org/link.stl",
        "package://arm/meshes/way_out.stl",
        "package://arm/outside/secret.stl",
    ],
)
def test_paths_that_lead_outside_are_refused_with_link_and_path(package, uri):
    (package / "meshes/way_out.stl").symlink_to(package.parent.parent / "secret.stl")
    (package / "outside").symlink_to(package.parent.parent)
    with pytest.raises(RobotError, match="link 'link1'") as caught:
        load(package, uri)
    assert uri in str(caught.value) and "\n" not in str(caught.value)


def test_folders_of_the_system_are_no_packages(package):
    robot = load(package, "package://etc/passwd")
    with pytest.raises(RobotError, match="not found"):
        resolve_mesh(robot, "package://etc/passwd")


def test_escape_through_declared_folders_is_refused_too(package):
    with pytest.raises(RobotError, match="outside"):
        load(package, "package://arm/../grip/../../secret.stl", package_dirs=[package.parent])


def test_declared_folders_may_hold_the_package_or_be_it(package, tmp_path):
    away = tmp_path / "elsewhere/urdf"
    away.mkdir(parents=True)
    for declared in (package.parent, str(package), [package.parent]):
        robot = load(away.parent, "package://arm/meshes/link.stl", package_dirs=declared)
        assert resolve_mesh(robot, "package://arm/meshes/link.stl") == (package / "meshes/link.stl").resolve()


def test_missing_mesh_matters_only_to_who_asks_for_it(package):
    robot = load(package, "package://arm/meshes/absent.stl")
    assert robot.torque([0.0], [0.0], [0.0])[0] == pytest.approx(9.81)
    with pytest.raises(RobotError, match=r"absent\.stl.*package_dirs"):
        resolve_mesh(robot, "package://arm/meshes/absent.stl")


def test_oversized_mesh_is_refused(package, monkeypatch):
    monkeypatch.setattr(meshes, "MAX_MESH_BYTES", 5)
    with pytest.raises(RobotError, match="MB"):
        resolve_mesh(load(package, "../meshes/link.stl"), "../meshes/link.stl")


def test_resolving_checks_names_that_were_not_in_the_file(package):
    with pytest.raises(RobotError, match="outside"):
        resolve_mesh(load(package, "../meshes/link.stl"), "package://arm/../../secret.stl")
