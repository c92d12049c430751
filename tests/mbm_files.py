"""Problem files in the format of MotionBenchMaker, for arms of the catalogue."""

import json

UR5 = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
LEFT = [f"left_{joint}" for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
POST = {"name": "post", "type": "cylinder", "radius": 0.05, "length": 0.8, "xyz": [0.6, 0.1, 0.4], "quat_wxyz": [1, 0, 0, 0]}
BALL = {"name": "ball", "type": "sphere", "radius": 0.06, "xyz": [0.61, 0.66, 0.02], "quat_wxyz": [1, 0, 0, 0]}


def ur5(**changes):
    """A turn from one side of a post to the other."""
    entry = {
        "id": "ur5_0001", "robot": "ur5", "scene": "made", "index": 1, "frame": "base_link", "joint_names": UR5[::-1],
        "q_start": [0.0, -1.57, -1.57, 1.57, -1.2, -0.8], "q_goal": [0.0, -1.57, -1.57, 1.57, -1.2, 0.8],
        "fixed_joints": {"robotiq_85_left_knuckle_joint": 0.1}, "obstacles": [POST],
    }  # fmt: skip
    return {**entry, **changes}


def baxter(**changes):
    """A short swing of the left arm, bent so that its torque limits can hold it; the right arm hangs where it is."""
    entry = {
        "id": "baxter_0001", "robot": "baxter", "scene": "made", "index": 1, "frame": "base", "joint_names": LEFT,
        "q_start": [-0.6, -0.8, 0.0, 1.4, 0.0, 1.0, 0.0], "q_goal": [0.3, -0.8, 0.0, 1.4, 0.0, 1.0, 0.0],
        "fixed_joints": {"right_s0": -0.5, "head_pan": 0.1}, "obstacles": [BALL],
    }  # fmt: skip
    return {**entry, **changes}


def write(folder, *entries):
    """A file a robot; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for robot in {entry["robot"] for entry in entries}:
        own = [entry for entry in entries if entry["robot"] == robot]
        (folder / f"{robot}.json").write_text(json.dumps(own))
    return folder


def small_set(folder):
    """Three problems: two robots, and a goal inside an obstacle."""
    there = {**POST, "xyz": [0.6 * 0.6967, 0.6 * 0.7174, 0.4]}
    return write(folder, ur5(), ur5(id="ur5_0002", obstacles=[there]), baxter())
