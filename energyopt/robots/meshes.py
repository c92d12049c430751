"""Where the meshes of a robot are, and that they stay there.

A URDF names a mesh as ``package://name/path``, relative to itself, or absolutely. Whatever the form, the file must lie
inside one of the folders that the caller has declared (or that the URDF's own place implies): ``..`` and symbolic links
that lead outside are refused, so that a robot description cannot make a mesh importer read other files.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

from energyopt.errors import RobotError

if TYPE_CHECKING:
    from energyopt.robots.model import RobotModel

MAX_MESH_BYTES = 200_000_000
PACKAGE_SCHEMES = ("package://", "model://")
URDF_FOLDERS = ("urdf", "urdfs", "robots", "xml")
"""Names of folders whose parent is the package, by convention, so that ``../meshes`` is inside it."""


def resolve_mesh(robot: RobotModel, uri: str) -> Path:
    """The file of a mesh named in ``robot.urdf``.

    Raises:
        RobotError: the path leaves the package folders, or the file is missing or above 200 MB.
    """
    folder = robot.source.parent if robot.source else None
    path = locate_mesh(uri, robot.package_dirs, folder, f"{robot.name}: mesh '{uri}'")
    if path is None or not os.path.isfile(path):
        declared = ", ".join(map(str, robot.package_dirs)) or "none"
        raise RobotError(f"{robot.name}: mesh '{uri}' not found; package folders searched: {declared}; give package_dirs=[...]")
    if path.stat().st_size > MAX_MESH_BYTES:
        raise RobotError(
            f"{robot.name}: mesh '{uri}' has {path.stat().st_size / 1e6:.0f} MB; expected below {MAX_MESH_BYTES / 1e6:.0f} MB"
        )
    return path


def lint_meshes(root: ET.Element, package_dirs: Iterable[Path], folder: Path | None, where: str) -> None:
    """Check that every mesh path stays inside the folders; files need not exist.

    Raises:
        RobotError: names the link and the path.
    """
    checked = set()
    for link in root.findall("link"):
        for mesh in link.iter("mesh"):
            uri = mesh.get("filename") or ""
            if uri not in checked:
                locate_mesh(uri, package_dirs, folder, f"{where}: link '{link.get('name')}': mesh '{uri[:200]}'")
                checked.add(uri)


def locate_mesh(uri: str, package_dirs: Iterable[Path], folder: Path | None, label: str) -> Path | None:
    """Where a mesh should be, or None where its package is in none of the folders.

    Raises:
        RobotError: the path leaves the folders, or is of a kind that is not supported.
    """
    scheme = uri.split("://", 1)[0] if "://" in uri else ""
    if uri.startswith(PACKAGE_SCHEMES):
        return _in_package(_package_path(uri), package_dirs, label)
    if scheme not in ("", "file"):
        raise RobotError(f"{label}: '{scheme[:20]}://' is not supported; expected package://, or a path")
    path = Path(unquote(uri.removeprefix("file://"))) if scheme else Path(uri)
    if not path.is_absolute():
        if folder is None:
            return None
        path = folder / path
    roots = [*package_dirs, *([folder] if folder else [])]
    return _contained(path, roots, label)


def default_package_dirs(root: ET.Element, folder: Path) -> tuple[Path, ...]:
    """Folders implied by the place of a user's URDF.

    For each ``package://name``, the nearest folder at or above the URDF that holds ``name``, where ``name`` is a package
    (it has a ``package.xml``), or holds the URDF, or lies beside it: ``package://etc`` finds no ``/etc``. For relative
    paths, the package the URDF is in: the nearest folder with a ``package.xml``, or the parent of a folder called ``urdf``.
    """
    uris = [m.get("filename") or "" for m in root.iter("mesh")]
    packages = sorted({_package_path(uri).partition("/")[0] for uri in uris if uri.startswith(PACKAGE_SCHEMES)} - {"", ".", ".."})
    chain = (folder, *folder.parents)

    def is_package(path: Path) -> bool:
        return path in chain or (path.is_dir() and ((path / "package.xml").is_file() or path.parent == folder))

    found = [next((p for p in chain if is_package(p / name)), None) for name in packages]
    own = next((p for p in chain[:4] if (p / "package.xml").is_file()), folder.parent if folder.name in URDF_FOLDERS else folder)
    return tuple(dict.fromkeys([*(p for p in found if p), own]))


def declared_package_dirs(package_dirs: Iterable[str], where: str) -> tuple[Path, ...]:
    """The caller's folders, absolute.

    Raises:
        RobotError: one is not a folder.
    """
    folders = tuple(Path(os.path.abspath(os.path.expanduser(p))) for p in package_dirs)
    for folder in folders:
        if not os.path.isdir(folder):
            raise RobotError(f"{where}: package_dirs: {folder} is not a folder")
    return folders


def _package_path(uri: str) -> str:
    """What follows ``package://``; a third slash, found in some files, is forgiven."""
    return uri.split("://", 1)[1].lstrip("/")


def _in_package(path: str, package_dirs: Iterable[Path], label: str) -> Path | None:
    package, _, rest = path.partition("/")
    if package in ("", ".", "..") or "\\" in package:
        raise RobotError(f"{label}: leaves its package folder; expected package://name/path")
    candidates = []
    for folder in package_dirs:
        root = folder if folder.name == package and not (folder / package).is_dir() else folder / package
        candidates.append(_contained(root / rest, [root], label))
    return next((c for c in candidates if os.path.isfile(c)), candidates[0] if candidates else None)


def _contained(path: Path, roots: Iterable[Path], label: str) -> Path:
    try:
        real = path.resolve()
        if any(real.is_relative_to(root.resolve()) for root in roots):
            return real
    except (OSError, ValueError, RuntimeError):
        raise RobotError(f"{label}: is not a usable path") from None
    raise RobotError(
        f"{label}: leads outside the package folders ({', '.join(map(str, roots)) or 'none declared'}); give package_dirs=[...]"
    )
