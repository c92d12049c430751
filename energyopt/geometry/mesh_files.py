"""Reading triangle meshes: STL (binary and ASCII) and OBJ by themselves, COLLADA (.dae) through the collision library.

Files are read without trust: size, counts and every number are checked before they are used.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from energyopt.errors import GeometryError
from energyopt.robots.messages import shown

MAX_TRIANGLES = 2_000_000
LARGEST_COORDINATE = 1e7
"""In the file's own unit, often millimetres."""
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
STL_HEADER = 84
SUFFIXES = (".stl", ".obj", ".dae")


def read_mesh(path: Path, max_bytes: int, where: str, suffixes: tuple[str, ...] = SUFFIXES) -> tuple[np.ndarray, np.ndarray]:
    """The triangles of a mesh file.

    Args:
        path: the file; its suffix says the format.
        max_bytes: larger files are refused.
        where: names the mesh in messages.
        suffixes: formats accepted.

    Returns:
        vertices in the file's unit, shape (V, 3), each used by some triangle; triangles: their indices, shape (F, 3).

    Raises:
        GeometryError: missing, no regular file, too large, of another format, or damaged.
    """
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        raise GeometryError(f"{where}: '{path.suffix}' is no mesh format known here; expected {', '.join(suffixes)}")
    data = _read_bytes(path, max_bytes, where)
    if suffix == ".dae":
        vertices, triangles = _read_dae(path, where)
    else:
        vertices, triangles = _read_obj(data, where) if suffix == ".obj" else _read_stl(data, where)
    if not 4 <= len(triangles) <= MAX_TRIANGLES:
        raise GeometryError(f"{where}: has {len(triangles)} triangles; expected 4 to {MAX_TRIANGLES}")
    used, triangles = np.unique(triangles, return_inverse=True)
    vertices = vertices[used]
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > LARGEST_COORDINATE:
        raise GeometryError(f"{where}: a corner is not finite or beyond {LARGEST_COORDINATE:g}; expected coordinates of a solid")
    return vertices, triangles.reshape(-1, 3)


def _read_bytes(path: Path, max_bytes: int, where: str) -> bytes:
    try:
        if not os.path.exists(path):
            raise GeometryError(f"{where}: no such file: {path!s:.300}")
        if not os.path.isfile(path):
            raise GeometryError(f"{where}: {path!s:.300} is not a regular file; expected a mesh file")
        with open(path, "rb") as file:
            data = file.read(max_bytes + 1)
    except GeometryError:
        raise
    except (OSError, ValueError) as error:
        raise GeometryError(f"{where}: {path!s:.300} cannot be read ({error})") from None
    if len(data) > max_bytes:
        raise GeometryError(f"{where}: larger than {max_bytes / 1e6:g} MB; reduce the mesh: its convex hull is all that counts")
    return data


def _read_stl(data: bytes, where: str) -> tuple[np.ndarray, np.ndarray]:
    count = int.from_bytes(data[80:STL_HEADER], "little") if len(data) >= STL_HEADER else -1
    if count >= 0 and len(data) == STL_HEADER + count * STL_TRIANGLE.itemsize:
        corners = np.frombuffer(data, STL_TRIANGLE, count, STL_HEADER)["corners"].astype(float)
    elif data[:80].lstrip()[:5].lower() == b"solid":
        corners = _ascii_corners(data, where)
    else:
        raise GeometryError(
            f"{where}: damaged STL: its header says {max(count, 0)} triangles, "
            f"which need {STL_HEADER + max(count, 0) * STL_TRIANGLE.itemsize} bytes, and it has {len(data)}"
        )
    vertices, triangles = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, triangles.reshape(-1, 3)


def _ascii_corners(data: bytes, where: str) -> np.ndarray:
    rows = [line.split()[1:] for line in data.split(b"\n") if line.lstrip()[:6].lower() == b"vertex"]
    if not rows or len(rows) % 3:
        raise GeometryError(f"{where}: damaged STL: {len(rows)} corners; expected three for each triangle")
    return _floats(rows, where).reshape(-1, 3, 3)


def _read_obj(data: bytes, where: str) -> tuple[np.ndarray, np.ndarray]:
    lines = [line.split() for line in data.replace(b"\\\n", b" ").split(b"\n")]
    vertices = _floats([words[1:4] for words in lines if words and words[0] == b"v"], where)
    triangles, seen = [], 0
    for words in lines:
        if words and words[0] == b"v":
            seen += 1
        elif words and words[0] == b"f":
            corners = [_obj_index(word, seen, len(vertices), where) for word in words[1:]]
            triangles += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
    return vertices, np.array(triangles, dtype=int).reshape(-1, 3)


def _obj_index(word: bytes, seen: int, count: int, where: str) -> int:
    """Zero-based corner of a face entry such as ``7``, ``7/1/3``, or ``-1`` (counted back from the latest)."""
    try:
        number = int(word.split(b"/")[0])
    except ValueError:
        number = 0
    index = number - 1 if number > 0 else seen + number
    if number == 0 or not 0 <= index < count:
        raise GeometryError(f"{where}: damaged OBJ: a face names the corner {shown(word[:20].decode('latin-1'))} of {count}")
    return index


def _floats(rows: list[list[bytes]], where: str) -> np.ndarray:
    try:
        return np.array([[float(x) for x in row] for row in rows], dtype=float).reshape(len(rows), 3)
    except ValueError:
        raise GeometryError(f"{where}: damaged: a corner is not three numbers") from None


def _read_dae(path: Path, where: str) -> tuple[np.ndarray, np.ndarray]:
    import coal

    try:
        mesh = coal.MeshLoader().load(str(path), np.ones(3))
        triangles = np.array([[mesh.tri_indices(k)[j] for j in range(3)] for k in range(mesh.num_tris)], dtype=int)
        return np.array(mesh.vertices(), dtype=float).reshape(-1, 3), triangles.reshape(-1, 3)
    except Exception as error:  # the importer raises several types, none documented
        raise GeometryError(f"{where}: cannot be read ({' '.join(str(error).split())[:160]})") from None
