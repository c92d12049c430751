"""Broken robot descriptions: each gives one line that names the culprit and the value, before anything is computed."""

import random
import re
from pathlib import Path

import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.errors import RobotError
from energyopt.robots import urdf_xml
from energyopt.robots.catalogue import robots_folder

ARM = factory.planar_arm([1.0, 0.5, 0.3], [2.0, 1.0, 0.5])
"""A healthy arm: joint1, joint2, joint3 move link1, link2, link3; "tool" is fixed to link3."""


def refusal(path, **options) -> str:
    """The message of the refusal, which has to be a single line."""
    with pytest.raises(RobotError) as caught:
        eo.load_robot(path, **options)
    message = str(caught.value)
    assert "\n" not in message and "Traceback" not in message
    return message


def edited(pattern: str, replacement: str, part: str = "") -> str:
    """`ARM` with the first match of a pattern replaced, inside the element that contains ``part``."""
    lines = ARM.split("\n")
    for i, line in enumerate(lines):
        if part in line and re.search(pattern, line):
            lines[i] = re.sub(pattern, replacement, line, count=1)
            return "\n".join(lines)
    raise AssertionError(f"no line with {part!r} matches {pattern!r}")


def with_solid(element: str) -> str:
    """`ARM` with a collision solid at its first moving link."""
    return edited("</link>", f"<collision><geometry>{element}</geometry></collision></link>", '<link name="link1"')


LINK, JOINT = '<link name="link2"', '<joint name="joint2"'
LIMIT = r"<limit[^/]*/>"

BROKEN = {
    "position limits inverted": (edited('lower="-6.0" upper="6.0"', 'lower="2" upper="-2"', JOINT), ["joint2", "2 to -2"]),
    "position limits left out": (edited('lower="-6.0" upper="6.0"', "", JOINT), ["joint2", "missing", "position_limits"]),
    "no limit element": (edited(LIMIT, "", JOINT), ["joint2", "missing"]),
    "velocity limit zero": (edited(r'velocity="[^"]*"', 'velocity="0"', JOINT), ["joint2", 'velocity="0"', "velocity_limits"]),
    "effort limit zero": (edited(r'effort="[^"]*"', 'effort="0.0"', JOINT), ["joint2", 'effort="0"', "torque_limits"]),
    "effort limit negative": (edited(r'effort="[^"]*"', 'effort="-5"', JOINT), ["joint2", "is negative"]),
    "limit that is no number": (edited(r'lower="[^"]*"', 'lower="NaN"', JOINT), ["joint2", "lower", "NaN"]),
    "limit in words": (edited(r'upper="[^"]*"', 'upper="pi"', JOINT), ["joint2", "upper", "pi"]),
    "number Python alone understands": (edited(r'upper="[^"]*"', 'upper="1_0"', JOINT), ["joint2", "1_0"]),
    "mass zero": (edited(r"<mass[^/]*/>", '<mass value="0"/>', LINK), ["link2", "mass is 0"]),
    "mass negative": (edited(r"<mass[^/]*/>", '<mass value="-1.5"/>', LINK), ["link2", "-1.5"]),
    "mass not a number": (edited(r"<mass[^/]*/>", '<mass value="nan"/>', LINK), ["link2", "mass", "nan"]),
    "mass infinite": (edited(r"<mass[^/]*/>", '<mass value="inf"/>', LINK), ["link2", "mass", "inf"]),
    "mass left out": (edited(r"<mass[^/]*/>", "", LINK), ["link2", "mass"]),
    "moving link without inertial": (edited(r"<inertial>.*</inertial>", "", LINK), ["link2", "joint2", "mass 0"]),
    "inertia negative": (edited(r'iyy="[^"]*"', 'iyy="-0.02"', LINK), ["link2", "-0.02"]),
    "inertia breaks the triangle": (edited(r'izz="[^"]*"', 'izz="0.5"', LINK), ["link2", "0.5"]),
    "inertia not a number": (edited(r'ixy="[^"]*"', 'ixy="nan"', LINK), ["link2", "ixy", "nan"]),
    "inertia incomplete": (edited(r'izz="[^"]*"', "", LINK), ["link2", "izz"]),
    "axis zero": (edited(r"<axis[^/]*/>", '<axis xyz="0 0 0"/>', JOINT), ["joint2", "[0.0, 0.0, 0.0]"]),
    "axis of a nanometre": (edited(r"<axis[^/]*/>", '<axis xyz="0 0 1e-9"/>', JOINT), ["joint2", "1e-09", "unit vector"]),
    "negative box": (with_solid('<box size="0.1 -0.1 0.1"/>'), ["link1", 'size="0.1 -0.1 0.1"', "no negative size"]),
    "negative sphere": (with_solid('<sphere radius="-0.1"/>'), ["link1", 'radius="-0.1"', "no negative size"]),
    "cylinder without length": (with_solid('<cylinder radius="0.1"/>'), ["link1", "<cylinder> has no length"]),
    "axis too short": (edited(r"<axis[^/]*/>", '<axis xyz="0 1"/>', JOINT), ["joint2", "0 1", "3 finite"]),
    "origin not a number": (edited(r'xyz="[^"]*"', 'xyz="0 nan 0"', JOINT), ["joint2", "0 nan 0"]),
    "origin infinite": (edited(r'rpy="[^"]*"', 'rpy="0 0 1e999"', JOINT), ["joint2", "rpy", "1e999"]),
    "unknown joint type": (edited("revolute", "spherical", JOINT), ["joint2", "spherical"]),
    "unknown parent": (edited('parent link="link1"', 'parent link="ghost"', JOINT), ["joint2", "ghost", "parent"]),
    "no child": (edited("<child[^/]*/>", "", JOINT), ["joint2", "child"]),
    "two joints of one name": (edited('name="joint2"', 'name="joint1"', JOINT), ["joint1", "more than once"]),
    "two links of one name": (ARM.replace("</robot>", '<link name="link1"/></robot>'), ["link1", "more than once"]),
    "link without a name": (ARM.replace("</robot>", "<link/></robot>"), ["link number 6", "no name"]),
    "kinematic loop": (ARM.replace("</robot>", factory.joint("z", "fixed", "base", "link3") + "</robot>"), ["link3", "loop"]),
    "link above itself": (edited('parent link="base"', 'parent link="link3"'), ["link", "ancestor"]),
    "two bases": (ARM.replace("</robot>", '<link name="island"/></robot>'), ["base", "island"]),
    "floating base": (edited("revolute", "floating", '<joint name="joint1"'), ["joint1", "floating", "torques"]),
    "planar base": (edited("revolute", "planar", '<joint name="joint1"'), ["joint1", "planar", "torques"]),
    "nothing moves": ('<robot name="r"><link name="a"/></robot>', ["no joint is left"]),
    "not a robot": ("<sdf><model/></sdf>", ["<sdf>", "<robot>"]),
    "no links": ('<robot name="r"/>', ["no <link>"]),
    "xacro": ('<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="a"/></robot>', ["xacro"]),
    "malformed": (ARM[:-20], ["malformed XML", "line"]),
    "empty": ("", ["malformed XML"]),
    "mimic of nobody": (edited("</joint>", '<mimic joint="nobody"/></joint>', JOINT), ["joint2", "nobody"]),
    "mimic of itself": (edited("</joint>", '<mimic joint="joint2"/></joint>', JOINT), ["joint2", "itself"]),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_broken_description_is_refused_by_one_line_that_names_the_culprit(case, tmp_path):
    text, expected = BROKEN[case]
    path = factory.write(tmp_path, text)
    message = refusal(path)
    assert str(path) in message
    for words in expected:
        assert words in message, f"'{words}' is not in: {message}"


def test_the_healthy_arm_of_this_file_loads(tmp_path):
    assert eo.load_robot(factory.write(tmp_path, ARM)).joint_names == ("joint1", "joint2", "joint3")


@pytest.mark.parametrize(
    ("old", "new", "culprit"),
    [
        ('name="panda_joint4" type="revolute"', 'name="panda_joint4" type="floating"', "panda_joint4"),
        ('lower="-1.7628" upper="1.7628"', 'lower="1.7628" upper="-1.7628"', "panda_joint2"),
        ('effort="100" lower="0.0" upper="0.04"', 'effort="100" lower="0.05" upper="0.04"', "panda_finger_joint1"),
    ],
)
def test_faults_in_a_real_robot_are_found(tmp_path, old, new, culprit):
    text = (robots_folder() / "panda_description/urdf/panda.urdf").read_text()
    assert old in text
    assert culprit in refusal(factory.write(tmp_path, text.replace(old, new, 1)))


def test_every_mass_of_a_real_robot_is_judged(tmp_path):
    text = (robots_folder() / "panda_description/urdf/panda.urdf").read_text()
    names = re.findall(r'<link name="(panda_(?:link[1-7]|hand|leftfinger))">', text)
    assert len(names) == 9
    for name in names:
        for value in ("-0.5", "nan", "0"):
            broken = re.sub(rf'(<link name="{name}">.*?<mass value=")[^"]*', rf"\g<1>{value}", text, count=1, flags=re.S)
            assert broken != text
            assert f"link '{name}'" in refusal(factory.write(tmp_path, broken))


# --- what does not matter is a note --------------------------------------------------------------------------------


def test_impossible_inertia_that_never_moves_is_a_note(tmp_path):
    base = factory.link("base", 1.0, (0, 0, 0), np.diag([0.1, 0.1, 5.0]))
    robot = eo.load_robot(factory.write(tmp_path, ARM.replace('<link name="base"/>', base)))
    assert any("'base'" in note and "does not move" in note for note in robot.notes)
    assert "5.0" not in robot.urdf


def test_impossible_inertia_of_a_trifle_is_a_note_and_of_a_heavy_part_an_error(tmp_path):
    def with_part(mass: float) -> Path:
        part = factory.link("part", mass, (0, 0, 0), np.diag([0.0, 0.0, 1e-3 * mass])) + factory.joint(
            "glue", "fixed", "link1", "part"
        )
        return factory.write(tmp_path, ARM.replace("</robot>", part + "</robot>"))

    assert any("'part'" in note for note in eo.load_robot(with_part(0.001)).notes)
    assert "link 'part'" in refusal(with_part(0.5))


def test_rounded_inertia_of_a_thin_plate_passes(tmp_path):
    plate = np.diag([0.0033333, 0.0033333, 0.0066667])  # true: 1/300, 1/300, 1/150
    text = edited(
        r"<inertial>.*</inertial>", re.search(r"<inertial>.*</inertial>", factory.link("x", 1.0, (0, 0, 0), plate)).group(), LINK
    )
    assert eo.load_robot(factory.write(tmp_path, text)).nv == 3


def test_point_mass_on_its_own_axis_is_refused_unless_armature_helps(tmp_path):
    path = factory.write(tmp_path, factory.planar_arm([1.0, 0.5], [1.0, 1.0], centers=[0.5, 0.0], inertias=[0.1, 0.0]))
    assert "joint2" in refusal(path)
    assert eo.load_robot(path, armature=0.01).nv == 2


# --- arguments -----------------------------------------------------------------------------------------------------

ARGUMENTS = [
    ({"locked": {"joint9": 0.0}}, ["locked", "joint9", "joint1"]),
    ({"locked": {"joint1": "up"}}, ["locked", "joint1", "'up'"]),
    ({"locked": {"joint1": 99.0}}, ["joint1", "99", "[-6, 6]"]),
    ({"locked": ["joint1", "joint2", "joint3"]}, ["no joint is left"]),
    ({"locked": ["joint9"]}, ["locked", "joint9", "joint1"]),
    ({"locked": 5}, ["locked", "5", "names"]),
    ({"joints": "elbow*"}, ["joints", "elbow*"]),
    ({"joints": 5}, ["joints", "5", "names"]),
    ({"position_limits": (1.0, -1.0)}, ["joint1", "inverted", "1 to -1"]),
    ({"position_limits": 3.0}, ["position_limits", "3.0"]),
    ({"velocity_limits": [1, 2]}, ["velocity_limits", "3 numbers"]),
    ({"velocity_limits": {"knee": 1.0}}, ["velocity_limits", "knee"]),
    ({"torque_limits": [1, float("nan"), 1]}, ["torque_limits", "joint2", "nan"]),
    ({"acceleration_limits": 0.0}, ["joint1", "acceleration_limits", "0"]),
    ({"limit_scale": {"speed": 0.5}}, ["limit_scale", "speed", "velocity"]),
    ({"limit_scale": {"velocity": 0.0}}, ["limit_scale", "positive"]),
    ({"armature": -0.1}, ["armature", "joint1", "-0.1"]),
    ({"viscous_friction": "some"}, ["viscous_friction", "some"]),
    ({"coulomb_velocity": 0}, ["coulomb_velocity"]),
    ({"gravity": (0, -9.81)}, ["gravity"]),
    ({"gravity": (0, 0, float("nan"))}, ["gravity", "nan"]),
    ({"payload": 2.0}, ["payload", "2.0", "Payload"]),
    ({"payload": eo.Payload(1.0, frame="claw")}, ["payload", "claw"]),
    ({"tool_frame": "claw"}, ["claw"]),
    ({"home": [0.0, 7.0, 0.0]}, ["home", "joint2", "7"]),
    ({"continuous_range": {"joint1": (-1, 1)}}, ["continuous_range", "joint1"]),
    ({"continuous_range": (1, -1)}, ["continuous_range", "(1, -1)", "lower < upper"]),
    ({"continuous_range": "wide"}, ["continuous_range", "'wide'"]),
    ({"velocity_limits": ["1", "2", "3"]}, ["velocity_limits is ['1', '2', '3']", "3 numbers"]),
    ({"velocity_limits": [None, 1, 1]}, ["velocity_limits is [None, 1, 1]"]),
    ({"position_limits": {"joint1": (0.0, "a")}}, ["position_limits (upper) of joint 'joint1' is 'a'; expected a number"]),
    ({"armature": 1e300}, ["armature", "joint1", "0 to 1e+12"]),
    ({"armature": True}, ["armature is True"]),
    ({"gravity": "down"}, ["gravity is 'down'", "three numbers"]),
    ({"gravity": (1e300, 0, 0)}, ["gravity", "none beyond 10000"]),
    ({"coulomb_velocity": "slow"}, ["coulomb_velocity is 'slow'"]),
    ({"package_dirs": 5}, ["package_dirs", "5"]),
    ({"package_dirs": ["/no/such/folder"]}, ["package_dirs", "/no/such/folder"]),
]


@pytest.mark.parametrize(("options", "expected"), ARGUMENTS, ids=[next(iter(options)) for options, _ in ARGUMENTS])
def test_bad_argument_is_refused_by_name_and_value(options, expected, tmp_path):
    message = refusal(factory.write(tmp_path, ARM), **options)
    for words in expected:
        assert words in message, f"'{words}' is not in: {message}"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((0.0,), "mass is 0"),
        ((-1.0,), "mass is -1"),
        ((float("nan"),), "nan"),
        (("heavy",), "heavy"),
        (("1",), "mass is '1'; expected one number"),
        ((True,), "mass is True"),
        ((1e300,), "mass is 1e.300; expected finite numbers, none beyond"),
        ((1.0, (0, 0)), "center"),
        ((1.0, (0, 0, 0), [1, 1, 3]), "inertia"),
        ((1.0, (0, 0, 0), np.triu(np.ones((3, 3)))), "symmetric"),
        ((1.0, (0, 0, 0), None, 7), "frame"),
    ],
)
def test_impossible_payload_is_refused(arguments, expected):
    with pytest.raises(RobotError, match=expected):
        eo.Payload(*arguments)


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda arm: arm.torque([0.0], [0.0], [0.0]), r"q has the shape \(1,\); expected \(3,\) or \(N, 3\)"),
        (lambda arm: arm.torque("a", 0, 0), "q is 'a'; expected 3 numbers"),
        (lambda arm: arm.torque(np.zeros(3), np.zeros((2, 3)), np.zeros(3)), "expected one shape"),
        (lambda arm: arm.placement("tool", [0, 0]), r"q has the shape \(2,\)"),
        (lambda arm: arm.placement("tool", np.zeros((2, 3))), "expected one configuration"),
        (lambda arm: arm.placement("tool", "home"), "q is 'home'"),
    ],
)
def test_states_that_do_not_fit_the_arm_are_refused(call, expected, tmp_path):
    """Pinocchio's own errors are four lines of C++ types."""
    with pytest.raises(RobotError, match=expected) as caught:
        call(eo.load_robot(factory.write(tmp_path, ARM)))
    assert "\n" not in str(caught.value)


# --- files ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "expected"), [("pandda", "panda"), ("UR5", "ur5"), ("solo12", "moves freely"), ("", "known"), ("xyzzy", "known")]
)
def test_unknown_name_lists_what_is_known(name, expected):
    assert expected in refusal(name)


def test_what_is_no_readable_file_is_refused(tmp_path):
    assert "no such file" in refusal(tmp_path / "missing.urdf")
    assert "is a folder" in refusal(tmp_path)
    assert "not a regular file" in refusal("/dev/null")
    binary = tmp_path / "binary.urdf"
    binary.write_bytes(bytes(range(256)))
    assert "not UTF-8" in refusal(binary)
    assert "expected a catalogue name" in refusal(3)


def test_oversized_file_is_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr(urdf_xml, "MAX_URDF_BYTES", 1000)
    assert "MB" in refusal(factory.write(tmp_path, ARM))


def test_entities_that_expand_without_bound_are_refused(tmp_path):
    levels = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    bomb = f'<!DOCTYPE robot [<!ENTITY e0 "x">{levels}]><robot name="&e9;"/>'
    assert "DOCTYPE" in refusal(factory.write(tmp_path, bomb))


def test_deep_nesting_is_refused(tmp_path):
    assert "nested deeper" in refusal(factory.write(tmp_path, "<robot>" + "<link>" * 100_000))


def test_too_many_links_are_refused(tmp_path):
    links = "".join(f'<link name="l{i}"/>' for i in range(urdf_xml.MAX_LINKS + 1))
    assert "2001 links" in refusal(factory.write(tmp_path, f"<robot>{links}</robot>"))


def test_random_damage_never_gives_anything_but_one_line_or_finite_torques(tmp_path):
    rng = random.Random(0)
    junk = [
        "",
        "nan",
        "inf",
        "-1",
        "0",
        "1e308",
        "1e-320",
        "abc",
        "1 2",
        '"',
        "<",
        "&#10;",
        "link1",
        "floating",
        "continuous",
        "\u0661",
    ]
    whole = factory.chain(
        axes=[(0, 0, 1), (0, 1, 1), (1, 0, 0)],
        origins=[(0, 0, 0.3)] * 3,
        masses=[1, 2, 0.5],
        centers=[(0.1, 0, 0.2)] * 3,
        inertias=[0.01 * np.eye(3)] * 3,
        types=["revolute", "continuous", "prismatic"],
    ).replace("</joint>", '<mimic joint="joint1" multiplier="0.5"/></joint>', 1)
    whole = whole.replace('<mimic joint="joint1"', '<mimic joint="joint2"')
    loaded = 0
    for _ in range(300):
        places = list(re.finditer(r'"([^"]*)"|<[^>]*>', whole))
        place = rng.choice(places)
        start, end = place.span(1) if place.group(1) is not None else place.span()
        path = factory.write(tmp_path, whole[:start] + rng.choice(junk) + whole[end:])
        try:
            robot = eo.load_robot(path)
        except RobotError as error:
            assert "\n" not in str(error)
            continue
        loaded += 1
        assert np.isfinite(robot.torque(robot.home, np.ones(robot.nv), np.ones(robot.nv))).all()
    assert 10 < loaded < 200  # both outcomes occur
