"""The keys of a problem file, with their kinds and units. This table is the format; everything else follows it.

angles = "rad"  what angles are in: "rad" (also rad/s …) or "deg"
[robot]   [robot.payload]   [robot.limits]      which arm, what it holds, how it differs from its file
[robot.actuators]                               its electric drives
[problem]   [limits]   [[waypoints]]            what is asked of it
[[problem.cost]]                                what a motion costs, in place of the two weights of [problem]
[[obstacles]]   [[workspace]]   [potential]   [[attached]]      what to stay clear of (see `avoidance_schema`)
[method]                                        how to solve it
"""

from __future__ import annotations

from energyopt.arguments import PATH_SEARCHES
from energyopt.io.avoidance_schema import AVOIDANCE, PLACE, YES_NO
from energyopt.io.energy_schema import ACTUATORS, COST
from energyopt.io.schema import Kind, ListOf, OneOf, Table, by_joint, choice, either, integer, is_number, number, numbers, text
from energyopt.robots.identified import FRICTION

_PAIR = numbers("a pair [lower, upper]", 2)
_STRINGS = Kind("a list of texts", lambda x: isinstance(x, list) and all(isinstance(s, str) and 0 < len(s) <= 4000 for s in x))
_FALSE = Kind("false", lambda x: x is False)


def _for_joints(unit: str, positive: bool = False, low: float = float("-inf")) -> Kind:
    """One number for all joints, or a list with one number a joint."""
    return either(number(unit, low=low, positive=positive), numbers("a list with one number a joint"))


def _limit(unit: str) -> Kind:
    return either(_for_joints(unit, positive=True), by_joint(number(unit, positive=True)))


def _friction(unit: str) -> Kind:
    return either(_for_joints(unit, low=0), by_joint(number(unit, low=0)), Kind('"urdf"', lambda x: x == "urdf"))


_POSITION_LIMIT = Kind(
    "{lower = …, upper = …} with numbers or lists [rad or m], or a table by joint name of pairs [lower, upper]",
    lambda x: isinstance(x, dict) and (_is_interval(x) or (bool(x) and all(_PAIR.accepts(pair) for pair in x.values()))),
)


def _is_matrix(value: object) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(numbers("", 3).accepts(row) for row in value)


def _is_interval(value: dict) -> bool:
    side = _for_joints("rad or m")
    return set(value) == {"lower", "upper"} and all(side.accepts(v) for v in value.values())


LIMITS = {
    "position": _POSITION_LIMIT,
    "velocity": _limit("rad/s"),
    "acceleration": _limit("rad/s²"),
    "jerk": _limit("rad/s³"),
    "torque": _limit("N·m"),
    "torque_rate": _limit("N·m/s"),
}

_PAYLOAD = Table(
    {
        "mass": number("kg", positive=True),
        "center": numbers("three numbers [m]", 3),
        "inertia": Kind(
            "3 principal moments, 6 numbers (xx, xy, xz, yy, yz, zz), or a 3×3 matrix [kg·m²]",
            lambda x: numbers("", 3, 6).accepts(x) or _is_matrix(x),
        ),
        "frame": text("the name of a link or joint"),
    },
    required=("mass",),
)

_SCALE = Table({kind: _limit("") for kind in LIMITS if kind != "position"})

_ROBOT = Table(
    {
        "name": text("the name of a catalogue robot (see: energyopt robots)"),
        "urdf": text("the path of a URDF file"),
        "package_dirs": _STRINGS,
        "joints": either(text("joint names or patterns"), _STRINGS),
        "locked": either(by_joint(number("rad or m")), _STRINGS),
        "gravity": numbers("three numbers [m/s²]", 3),
        "armature": either(_for_joints("kg·m²", low=0), by_joint(number("kg·m²", low=0))),
        "viscous_friction": _friction("N·m·s/rad"),
        "coulomb_friction": either(_friction("N·m"), choice(*FRICTION)),
        "coulomb_velocity": _limit("rad/s"),
        "continuous_range": either(_PAIR, by_joint(_PAIR)),
        "tool_frame": text("the name of a link or joint"),
        "payload": OneOf(ListOf(_PAYLOAD), _PAYLOAD),
        "actuators": ACTUATORS,
        "limits": Table({**LIMITS, "scale": _SCALE}),
    },
)

_CONFIGURATION = either(numbers("a list of joint positions [rad or m]"), Kind('"home"', lambda x: x == "home"))

_FRAME_GOAL = Table(
    {
        "frame": text("the name of a link or joint"),
        **PLACE,
    },
    required=("position",),
)

_PROBLEM = Table(
    {
        "start": _CONFIGURATION,
        "goal": OneOf(_CONFIGURATION, _FRAME_GOAL),
        "duration": either(number("s", positive=True), numbers("a pair [least, most] of seconds to choose from", 2)),
        "velocity_weight": _for_joints("N²·m²·s²/rad²", low=0),
        "torque_weights": _for_joints("", low=0),
        "start_velocity": _for_joints("rad/s"),
        "goal_velocity": _for_joints("rad/s"),
        "start_acceleration": _for_joints("rad/s²"),
        "goal_acceleration": _for_joints("rad/s²"),
        "clearance": number("m", low=0),
        "self_collision": YES_NO,
        "periodic": YES_NO,
        "cost": COST,
    },
    required=("start", "goal", "duration"),
)

_WAYPOINT = Table(
    {"position": numbers("a list of joint positions [rad or m]"), "time": number("s", positive=True)},
    required=("position",),
)

METHOD = {
    "bspline": {
        "degree": integer(3, 5),
        "control_points": integer(7, 2000),
        "accuracy": either(Kind("a relative error between 0 and 1", lambda x: is_number(x) and 0 < x < 1), _FALSE),
    },
    "sinusoid": {"harmonics": integer(0, 64)},
    "hermite_simpson": {"intervals": integer(4, 500)},
}
"""Options of each parameterisation."""

PLAN_OPTIONS = {
    "seed": integer(0, 2**32 - 1),
    "starts": integer(1, 10_000),
    "time_limit": number("s", positive=True),
    "path_search": choice(*PATH_SEARCHES),
}
"""Options of `energyopt.plan` that a file may set."""

_OWN_OPTIONS = {key: kind for options in METHOD.values() for key, kind in options.items()}
_METHOD = Table({"parameterization": choice(*METHOD), **_OWN_OPTIONS, **PLAN_OPTIONS})

PROBLEM_FILE = Table(
    {
        "name": text("a name, one line of at most 200 characters", 200),
        "angles": choice("rad", "deg"),
        "robot": _ROBOT,
        "problem": _PROBLEM,
        "limits": Table(LIMITS),
        "waypoints": ListOf(_WAYPOINT),
        **AVOIDANCE,
        "method": _METHOD,
    },
    required=("robot", "problem"),
)
