"""The robots known by name: where their URDF is, which joints move, which frame is the tool, where they rest.

The files come from the package ``example-robot-data`` (data only, nothing is downloaded). Adding a robot of that
package is one line of `CATALOGUE`.
"""

from __future__ import annotations

import difflib
import os
import sys
import sysconfig
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any

from energyopt.errors import MissingDependencyError, RobotError


@dataclass(frozen=True)
class CatalogueEntry:
    """One robot of the catalogue.

    Attributes:
        urdf: path below the ``robots`` folder of example-robot-data.
        joints: names or patterns of the joints that move, separated by spaces; all others are locked.
        tool_frame: link whose motion is reported.
        home: a configuration inside the limits, away from singularities [rad], in the order of ``joint_names``.
        srdf: path below the same folder, or "".
        assumed: arguments of `load_robot` that stand in for what the file does not state.
    """

    urdf: str
    joints: str
    tool_frame: str
    home: tuple[float, ...]
    srdf: str = ""
    assumed: dict[str, Any] = field(default_factory=dict)


_UR_HOME = (0.0, -pi / 2, pi / 2, -pi / 2, -pi / 2, 0.0)
_UR_SRDF = "ur_description/srdf/ur5.srdf"
_UR_ARM = "shoulder_* elbow_joint wrist_*"
_SO_ARM = "shoulder_* elbow_flex wrist_*"
_BAXTER_HOME = (0.0, -0.55, 0.0, 0.75, 0.0, 1.26, 0.0)
_PENDULUM = {"position_limits": (-2 * pi, 2 * pi), "velocity_limits": 10.0, "torque_limits": 10.0}

# fmt: off
CATALOGUE: dict[str, CatalogueEntry] = {
    "panda": CatalogueEntry("panda_description/urdf/panda.urdf", "panda_joint?", "panda_hand_tcp", (0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4), "panda_description/srdf/panda.srdf"),
    "ur3": CatalogueEntry("ur_description/urdf/ur3_robot.urdf", _UR_ARM, "tool0", _UR_HOME, _UR_SRDF),
    "ur3_limited": CatalogueEntry("ur_description/urdf/ur3_joint_limited_robot.urdf", _UR_ARM, "tool0", _UR_HOME, _UR_SRDF),
    "ur5": CatalogueEntry("ur_description/urdf/ur5_robot.urdf", _UR_ARM, "tool0", _UR_HOME, _UR_SRDF),
    "ur5_limited": CatalogueEntry("ur_description/urdf/ur5_joint_limited_robot.urdf", _UR_ARM, "tool0", _UR_HOME, "ur_description/srdf/ur5_joint_limited_robot.srdf"),
    "ur10": CatalogueEntry("ur_description/urdf/ur10_robot.urdf", _UR_ARM, "tool0", _UR_HOME, _UR_SRDF),
    "ur10_limited": CatalogueEntry("ur_description/urdf/ur10_joint_limited_robot.urdf", _UR_ARM, "tool0", _UR_HOME, _UR_SRDF),
    "xarm7": CatalogueEntry("xarm_description/urdf/xarm7.urdf", "joint?", "link_eef", (0.0, -0.5, 0.0, 0.9, 0.0, 1.4, 0.0), "xarm_description/srdf/xarm7.srdf"),
    "z1": CatalogueEntry("z1_description/urdf/z1.urdf", "joint[1-6]", "gripperStator", (0.0, 1.2, -1.0, -0.6, 0.3, 0.0), "z1_description/srdf/z1.srdf"),
    "talos_arm": CatalogueEntry("talos_data/robots/talos_left_arm.urdf", "arm_left_?_joint", "gripper_left_base_link", (0.5, 0.4, -1.2, 0.5, 0.4, 0.2), "talos_data/srdf/talos.srdf"),
    "baxter": CatalogueEntry("baxter_description/urdf/baxter.urdf", "left_[sew]? right_[sew]?", "left_gripper", 2 * _BAXTER_HOME, "baxter_description/srdf/baxter_manipulation.srdf"),
    "baxter_left": CatalogueEntry("baxter_description/urdf/baxter.urdf", "left_[sew]?", "left_gripper", _BAXTER_HOME, "baxter_description/srdf/baxter_manipulation.srdf"),
    "baxter_right": CatalogueEntry("baxter_description/urdf/baxter.urdf", "right_[sew]?", "right_gripper", _BAXTER_HOME, "baxter_description/srdf/baxter_manipulation.srdf"),
    "kinova": CatalogueEntry("kinova_description/robots/kinova.urdf", "j2s6s200_joint_?", "j2s6s200_end_effector", (0.0, 2.9, 1.3, 4.2, 1.4, 0.0), "kinova_description/srdf/kinova.srdf"),
    "tiago": CatalogueEntry("tiago_description/robots/tiago.urdf", "arm_?_joint", "hand_grasping_frame", (0.5, -0.8, -0.5, 1.8, 0.0, 0.4, 0.0)),
    "tiago_no_hand": CatalogueEntry("tiago_description/robots/tiago_no_hand.urdf", "arm_?_joint", "arm_tool_link", (0.5, -0.8, -0.5, 1.8, 0.0, 0.4, 0.0)),
    "tiago_dual": CatalogueEntry("tiago_description/robots/tiago_dual.urdf", "arm_left_?_joint arm_right_?_joint", "hand_left_grasping_frame", 2 * (0.3, 0.2, 1.0, 1.5, 0.0, 0.4, 0.0)),
    "tiago_pro": CatalogueEntry("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_?_joint arm_right_?_joint", "arm_left_tool_link", (1.5, -0.6, 0.0, -1.2, -0.8, 0.5, 0.0, -1.5, -0.6, 0.0, -1.2, 0.8, 0.5, 0.0)),
    "pr2": CatalogueEntry("pr2_description/urdf/pr2.urdf", "[lr]_shoulder_* [lr]_upper_arm_roll_joint [lr]_elbow_* [lr]_forearm_* [lr]_wrist_*", "r_gripper_tool_frame", (0.6, 0.2, 0.6, -1.2, 0.3, -0.8, 0.0, -0.6, 0.2, -0.6, -1.2, -0.3, -0.8, 0.0), "pr2_description/srdf/pr2.srdf"),
    "so100": CatalogueEntry("so_arm_description/urdf/so100.urdf", _SO_ARM, "gripper", (0.0, 1.2, -1.5, 0.3, 0.0)),
    "so101": CatalogueEntry("so_arm_description/urdf/so101.urdf", _SO_ARM, "gripper_frame_link", (0.0, -0.6, 0.8, 0.6, 0.0)),
    "twodof": CatalogueEntry("asr_twodof_description/urdf/TwoDofs.urdf", "J?", "Tip", (0.4, 0.8)),
    "finger_edu": CatalogueEntry("finger_edu_description/robots/finger_edu.urdf", "finger_*", "finger_tip_link", (0.0, 0.6, -1.2), "finger_edu_description/srdf/finger_edu.srdf"),
    "double_pendulum": CatalogueEntry("double_pendulum_description/urdf/double_pendulum.urdf", "joint?", "link2", (0.4, 0.8), "", _PENDULUM),
}
# fmt: on

FLOATING_BASE = frozenset(
    ("a1", "alex", "alexander", "anymal", "anymal_c", "anymal_kinova", "b1", "b1_z1", "bolt", "borinot", "cassie", "centauro")
    + ("g1", "go1", "go2", "hector", "hextilt", "hyq", "icub", "iris", "laikago", "quadruped", "romeo", "simple_humanoid")
    + ("solo", "solo8", "solo12", "talos", "talos_full", "talos_legs")
)
"""Robots of example-robot-data that walk or fly; refused by name with the reason."""


def catalogue() -> tuple[str, ...]:
    """Names that `load_robot` knows, sorted."""
    return tuple(sorted(CATALOGUE))


def find_entry(name: str) -> CatalogueEntry:
    """The entry of a name.

    Raises:
        RobotError: unknown, with the nearest names; or a robot whose base moves freely.
    """
    if name in CATALOGUE:
        return CATALOGUE[name]
    if name in FLOATING_BASE:
        raise RobotError(
            f"robot '{name}': its base moves freely (it walks or flies), so its torques do not follow from its joint motion alone; "
            f"energyopt plans for arms bolted to the ground: {', '.join(catalogue())}"
        )
    near = difflib.get_close_matches(name.lower(), catalogue(), n=4, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(catalogue())}; or give the path of a URDF file"
    raise RobotError(f"no robot named '{name[:80]}' in the catalogue; {hint}")


def robots_folder() -> Path:
    """The ``robots`` folder of example-robot-data: from a wheel, conda, ROS or a CMake installation.

    Raises:
        MissingDependencyError: not installed; the message names the command.
    """
    for share in _share_folders():
        folder = share / "example-robot-data" / "robots"
        if folder.is_dir():
            return folder
    raise MissingDependencyError("the catalogue robots need the package example-robot-data: pip install example-robot-data")


def _share_folders() -> list[Path]:
    site = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib"), *sys.path}
    shares = [Path(s) / "cmeel.prefix" / "share" for s in sorted(p for p in site if p)]
    shares += [Path(p) / "share" for p in (sys.prefix, os.environ.get("CONDA_PREFIX", "")) if p]
    for variable, tail in (("AMENT_PREFIX_PATH", "share"), ("CMAKE_PREFIX_PATH", "share"), ("ROS_PACKAGE_PATH", "")):
        shares += [Path(p) / tail for p in os.environ.get(variable, "").split(os.pathsep) if p]
    return shares
