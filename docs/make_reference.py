"""Write the parts of the documentation that follow from the code:  python docs/make_reference.py

docs/problem_files.md   the table of keys, from the schema of problem files
docs/validation.md      the table of test files, from their first lines

What a key may be comes from `energyopt.io.problem_schema`; what it means, and what holds without it, stands here. A key that is
missing here, or is no longer in the schema, is an error.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

from energyopt.costs import COSTS
from energyopt.geometry.shapes import SHAPES
from energyopt.io import write_atomic
from energyopt.io.avoidance_schema import REGIONS, SIZES, SOLIDS, sizes_of
from energyopt.io.energy_schema import PARAMETERS, parameters_of
from energyopt.io.pages import with_block
from energyopt.io.problem_schema import METHOD, PROBLEM_FILE
from energyopt.io.schema import ListOf, OneOf, Table

HERE = Path(__file__).resolve().parent

_SHAPE = {
    "type": "of shape",
    "radius": "",
    "length": "of a cylinder from end to end, of a capsule between the centres of its half balls",
    "size": "full edge lengths, or one for a cube",
    "normal": "points away from the solid side; any length",
    "offset": "of the plane along the normal; 0 without it",
    "mesh": "its convex hull counts; relative to the problem file, inside its folder, at most 20 MB",
    "scale": "on the coordinates of the mesh, 0.001 for millimetres; 1 without it",
    "position": "the origin of the {axes} without it",
    "quaternion": "orientation; along the axes of the {axes} without it and rpy",
    "rpy": "orientation in the file's angles, in place of quaternion",
}
"""Keys of every table that holds a shape."""


def _shape_keys(section: str, kinds: tuple[str, ...], axes: str) -> dict[str, str]:
    """The keys of `_SHAPE` that a section has, with what its positions are measured in."""
    own = [key for key in _SHAPE if key not in SIZES or any(key in sizes_of(kind) for kind in kinds)]
    return {f"{section}.{key}": _SHAPE[key].format(axes=axes) for key in own}


SECTION_TYPES = {"obstacles": tuple(SHAPES), "workspace": REGIONS, "attached": SOLIDS}
ARRAYS = ("problem.cost", "waypoints", "obstacles", "obstacles.waypoints", "workspace", "attached")
"""Sections that may stand several times."""

MEANINGS = {
    "name": "name in reports; the file's own name without it",
    "angles": 'unit of every angle in the file, "rad" without it; "deg" also means degrees per second and so on',
    "robot.name": "a robot of the catalogue; either this or urdf",
    "robot.urdf": "any arm; relative to the problem file",
    "robot.package_dirs": "folders in which package:// paths of meshes are found; relative to the problem file",
    "robot.joints": "the joints that move, all others are locked; the catalogue's choice, or all, without it",
    "robot.locked": "joints to fix: with their values, or names only (then at 0 or the nearest limit)",
    "robot.gravity": "acceleration of gravity in the base; [0, 0, -9.81] without it",
    "robot.armature": "rotor inertia seen at the joint; 0 without it",
    "robot.viscous_friction": '0 without it; "urdf" takes the file\'s damping',
    "robot.coulomb_friction": '0 without it; "urdf" takes the file\'s friction, a published set ([energy](energy.md)) its own',
    "robot.coulomb_velocity": "velocity over which Coulomb friction changes sign; 0.05 without it",
    "robot.continuous_range": "range of joints without limits; [-2π, 2π] without it",
    "robot.tool_frame": "frame whose motion is reported; the catalogue's, or the last link, without it",
    "robot.payload": "a body held by the arm, or a list of them",
    "robot.payload.mass": "",
    "robot.payload.center": "centre of mass in the frame; its origin without it",
    "robot.payload.inertia": "about the centre of mass, in the axes of the frame; a point mass without it",
    "robot.payload.frame": "the tool frame without it",
    "robot.actuators.gear_ratio": "N, turns of the motor a turn of the joint (rad/m for a sliding joint)",
    "robot.actuators.torque_constant": "k_t of the motor",
    "robot.actuators.resistance": "R of the winding that carries τ_m/k_t",
    "robot.actuators.efficiency": "η of the gear, at most 1; 1 without it",
    "robot.actuators.regeneration": "share of braking power that comes back, 0 to 1; 0 without it",
    "robot.actuators.brake_power": "holds the brake open while the robot moves; 0 without it",
    "robot.actuators.shared_bus": "whether a braking joint feeds the others; false without it",
    "robot.actuators.standby_power": "P₀ of controller and drives, drawn at all times; 0 without it",
    "robot.actuators.source": "kept with the numbers",
    "robot.limits.position": "in place of the URDF's",
    "robot.limits.velocity": "in place of the URDF's",
    "robot.limits.acceleration": "none without it",
    "robot.limits.jerk": "none without it",
    "robot.limits.torque": "in place of the URDF's",
    "robot.limits.torque_rate": "none without it",
    "robot.limits.scale.velocity": "factor on the limit, applied last",
    "robot.limits.scale.acceleration": "factor on the limit, applied last",
    "robot.limits.scale.jerk": "factor on the limit, applied last",
    "robot.limits.scale.torque": "factor on the limit, applied last",
    "robot.limits.scale.torque_rate": "factor on the limit, applied last",
    "problem.start": "joint positions at t = 0",
    "problem.goal": "joint positions at the end, or a pose of a frame",
    "problem.goal.frame": "the tool frame without it",
    "problem.goal.position": "where its origin has to be, in the robot's base",
    "problem.goal.quaternion": "its orientation; free without it and rpy",
    "problem.goal.rpy": "its orientation in the file's angles, in place of quaternion",
    "problem.duration": "T, or between what it is to be chosen",
    "problem.velocity_weight": "λ; 0.1 without it",
    "problem.torque_weights": "w; 1 without it",
    "problem.start_velocity": "0 without it",
    "problem.goal_velocity": "0 without it",
    "problem.start_acceleration": "0 without it",
    "problem.goal_acceleration": "0 without it",
    "problem.clearance": "least distance from obstacles, walls, and between links; 0 without it, which asks for no contact",
    "problem.periodic": "a cycle: goal = start, velocity and acceleration the same at both ends and up to the optimiser",
    "problem.self_collision": "whether links are kept apart; true without it",
    "problem.cost.type": "of the term (see [energy](energy.md)); all terms together are J, in place of the two weights above",
    "problem.cost.weight": "factor of the term in J; 1 without it",
    "problem.cost.weights": "of the joints; 1 without it",
    "problem.cost.smoothing": "width over which kinks in power are smoothed; 0.2 without it",
    "limits.position": "for this problem, in place of the robot's",
    "limits.velocity": "for this problem, in place of the robot's",
    "limits.acceleration": "for this problem, in place of the robot's",
    "limits.jerk": "for this problem, in place of the robot's",
    "limits.torque": "for this problem, in place of the robot's",
    "limits.torque_rate": "for this problem, in place of the robot's",
    "waypoints.position": "a configuration to pass",
    "waypoints.time": "when; chosen by the optimiser without it, in the order of the list",
    **_shape_keys("obstacles", tuple(SHAPES), "base"),
    "obstacles.name": "for reports; its type and number without it",
    "obstacles.velocity": "constant, in the axes of the base; the pose is then that at t = 0",
    "obstacles.angular_velocity": "constant, in the axes of the base; degrees per second where the file's angles are in degrees",
    "obstacles.smooth": "twice differentiable between waypoints; without it straight and at constant rate",
    "obstacles.waypoints.time": "in planned time; before the first and after the last the obstacle stands still",
    "obstacles.waypoints.position": "at that time",
    "obstacles.waypoints.quaternion": "orientation at that time; along the axes of the base without it and rpy",
    "obstacles.waypoints.rpy": "orientation in the file's angles, in place of quaternion",
    "workspace": "where to stay: inside a box, on the free side of a half-space",
    **_shape_keys("workspace", REGIONS, "base"),
    "workspace.name": "for reports",
    "workspace.frames": "whose origins are bound; without it the whole of every link that moves",
    "potential.gain": "k of the repulsive potential U = ½k(1/d − 1/d_safe)², whose integral is added to J",
    "potential.safe_distance": "d_safe, beyond which nothing is felt",
    "potential.minimum_distance": "below it U continues as a parabola; a tenth of safe_distance without it",
    "attached": "a tool or a grasped object, or a list of them; part of what is kept clear, without mass (see robot.payload)",
    **_shape_keys("attached", SOLIDS, "frame"),
    "attached.name": "for reports",
    "attached.frame": "it is fixed to; the tool frame without it",
    "method.parameterization": "how the motion is described; bspline without it",
    "method.degree": "of the spline; 3 without it",
    "method.control_points": "coefficients of a joint to start with; by the duration without it",
    "method.accuracy": "refine knots until the estimated relative error of J is below; 0.01 without it, false keeps the knots",
    "method.harmonics": "frequencies above the fundamental; 6 without it",
    "method.intervals": "40 without it",
    "method.seed": "of random guesses; 0 without it",
    "method.starts": "guesses; the best is kept; by default up to 64 for splines without obstacles, "
    "fewer where they keep leading to the same optima, 1 else (for a pose, one a branch)",
    "method.time_limit": "solving, and looking for paths, stops after this time",
    "method.path_search": "what looks for ways around obstacles; auto without it: built-in, then ompl where that is installed",
}


def key_tables() -> str:
    """The tables of all keys, one section of the file after another."""
    lines, keys = [], dict(_keys("", PROBLEM_FILE, True))
    missing, unknown = keys.keys() - MEANINGS.keys(), MEANINGS.keys() - keys.keys()
    if missing or unknown:
        sys.exit(f"docs/make_reference.py: keys without a meaning: {sorted(missing)}; meanings without a key: {sorted(unknown)}")
    heading = None
    for key, (expected, required) in keys.items():
        section, _, name = key.rpartition(".")
        if section != heading:
            heading = section
            title = f"`[[{section}]]`" if section in ARRAYS else f"`[{section}]`" if section else "Top of the file"
            lines += ["", f"### {title}", "", "| key | value | meaning |", "|---|---|---|"]
        words = expected.replace("|", "\\|")
        only = _owners(section, name)
        parts = MEANINGS[key], f"With {', '.join(only)} only" if only else "", "**Required**" if required else ""
        meaning = ". ".join(part for part in parts if part)
        lines.append(f"| `{name}` | {words} | {meaning} |")
    return "\n".join(lines).strip()


def _owners(section: str, key: str) -> list[str]:
    """The methods, or types of shapes or costs, that have a key which not all of them have."""
    if section == "method":
        return [kind for kind, options in METHOD.items() if key in options]
    if section == "problem.cost" and key in PARAMETERS:
        return [kind for kind in COSTS if key in parameters_of(kind)]
    kinds = SECTION_TYPES.get(section, ()) if key in SIZES else ()
    return [kind for kind in kinds if key in sizes_of(kind)]


def _keys(prefix: str, table: Table, required: bool) -> Iterator[tuple[str, tuple[str, bool]]]:
    """(dotted key, (what is expected, whether the table cannot do without it)); keys of a table before its inner tables."""
    inner = []
    for key, kind in table.keys.items():
        full = f"{prefix}.{key}" if prefix else key
        below = kind.table if isinstance(kind, (OneOf, ListOf)) else kind
        if isinstance(below, Table):
            inner.append((full, below))
        if isinstance(kind, OneOf):
            plain = "a table, or a list of tables" if isinstance(kind.kind, ListOf) else f"{kind.kind.expected}, or a table"
            yield full, (plain, key in table.required)
        elif not isinstance(kind, (Table, ListOf)):
            yield full, (kind.expected, key in table.required)
    for full, below in inner:
        yield from _keys(full, below, True)


def test_table() -> str:
    """The files of tests with what they say of themselves."""
    lines = ["| file | what it tests |", "|---|---|"]
    for path in sorted((HERE.parent / "tests").glob("test_*.py")):
        words = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n\n")[0]
        lines.append(f"| `{path.name}` | {' '.join(words.split()).rstrip('.')} |")
    return "\n".join(lines)


PARTS = {"problem_files.md": ("keys", key_tables), "validation.md": ("tests", test_table)}
"""Page → name of the mark, and what stands between its begin and end."""


def renewed(page: str) -> str:
    """The text of a page with its generated part made anew."""
    mark, make = PARTS[page]
    return with_block(HERE / page, (f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"), make())


if __name__ == "__main__":
    for name in PARTS:
        write_atomic(HERE / name, renewed(name).encode())
