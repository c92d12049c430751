"""The keys of a problem file that say what to stay clear of: obstacles, workspace, potential, what is attached.

Which sizes a type has follows from the fields of its class in `energyopt.geometry`: a new shape brings its own, and only a size
of a new name needs a line here.
"""

from __future__ import annotations

from dataclasses import MISSING, fields

from energyopt.geometry.shapes import SHAPES
from energyopt.io.schema import Kind, ListOf, OneOf, Table, choice, either, number, numbers, text

YES_NO = Kind("true or false", lambda x: isinstance(x, bool))

SIZES = {
    "radius": number("m", positive=True),
    "length": number("m", positive=True),
    "size": either(number("m", positive=True), numbers("three edge lengths [m]", 3)),
    "normal": numbers("three numbers, the direction towards the free side", 3),
    "offset": number("m"),
    "mesh": text("the path of an STL or OBJ file"),
    "scale": either(number(), numbers("three factors", 3)),
}
"""Sizes of shapes."""
CALLED = {"path": "mesh"}
"""What a field of a shape is called in a file, where that differs."""
_NOT_WRITTEN = ("pose", "name", "folder", "points")


def sizes_of(kind: str) -> dict[str, bool]:
    """The sizes a type of shape has, as they are called in a file, and whether it cannot do without them."""
    own = [field for field in fields(SHAPES[kind]) if field.name not in _NOT_WRITTEN]
    return {CALLED.get(f.name, f.name): f.default is MISSING or f.name in CALLED for f in own}


PLACE = {
    "position": numbers("three numbers [m]", 3),
    "quaternion": numbers("four numbers w, x, y, z of norm 1", 4),
    "rpy": numbers("three angles: roll, pitch, yaw about the fixed x, y, z axes", 3),
}
"""Keys of a pose."""

_STATION = Table({"time": number("s"), **PLACE}, required=("time", "position"))
MOTION = {
    "velocity": numbers("three numbers [m/s]", 3),
    "angular_velocity": numbers("three numbers [rad/s]", 3),
    "waypoints": ListOf(_STATION),
    "smooth": YES_NO,
}
"""Keys of a pose that changes with time."""

_NAME = {"name": text("a name of at most 200 characters", 200)}
_FRAMES = either(
    text("the name of a link or joint"),
    Kind("a list of such names", lambda x: isinstance(x, list) and all(isinstance(name, str) for name in x)),
)


def _shape(kinds: tuple[str, ...], **more) -> Table:
    """A table of one shape, of one of the given types."""
    own = {key: kind for key, kind in SIZES.items() if any(key in sizes_of(name) for name in kinds)}
    return Table({"type": choice(*kinds), **_NAME, **own, **PLACE, **more}, required=("type",))


REGIONS = ("box", "half-space")
"""Types of shapes that a workspace may have."""
SOLIDS = tuple(kind for kind in SHAPES if kind != "half-space")
"""Types of shapes that can be attached."""

_WORKSPACE = _shape(REGIONS, frames=_FRAMES)
_ATTACHED = _shape(SOLIDS, frame=text("the name of a link or joint"))
_POTENTIAL = Table(
    {
        "gain": number("N²·m⁴", positive=True),
        "safe_distance": number("m", positive=True),
        "minimum_distance": number("m", positive=True),
    },
    required=("gain", "safe_distance"),
)

AVOIDANCE = {
    "obstacles": ListOf(_shape(tuple(SHAPES), **MOTION)),
    "workspace": OneOf(ListOf(_WORKSPACE), _WORKSPACE),
    "potential": _POTENTIAL,
    "attached": OneOf(ListOf(_ATTACHED), _ATTACHED),
}
"""Sections of a problem file."""
