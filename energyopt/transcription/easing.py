"""What spheres ask too much, given back.

Spheres stick out of the links they cover, by a centimetre or so. Where a motion comes near something, exact distances d tell
by how much: a pair of a link and an obstacle (or two links) whose spheres miss ε of what is asked of them, and which has to keep
the distance d_min, can be asked for

    min over the instants where it is near of (d − d_min − ε)

less, as long as the motion passes there. That is right for this motion, and nearly so for one close by: it is measured again
with every level of a search, taken back where it was too much, and the exact check has the last word.
"""

from __future__ import annotations

import numpy as np

from energyopt.avoidance import RESERVE, Avoidance, arm_obstacles, checked_pairs
from energyopt.clearance_checks import exact_distances
from energyopt.geometry.exact import obstacle_names
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.transcription.penalty import SAMPLES, STEP, travel_times

NEAR = 5e-3
"""Pairs whose spheres keep less than this beyond what is asked [m] are looked at."""
SHARE, MOST = 0.6, 0.01
"""Of what could be given is given this share, and no more than this [m]: the motion will be another one, a little."""


def eased(avoidance: Avoidance, problem: Problem, trajectory: Trajectory, back: bool = False) -> Avoidance:
    """With so much less asked, pair by pair, as exact geometry allows where a motion comes near; more where it allows less.

    With ``back`` nothing is given, only taken back.
    """
    times = travel_times(avoidance, trajectory, STEP, SAMPLES)
    least, pair = avoidance.kernels.place(avoidance.scene.at(times), trajectory(times)).least(NEAR)
    spare = np.zeros(least.shape[1])
    known = set(obstacle_names(arm_obstacles(problem))), set(checked_pairs(problem))
    for column in np.flatnonzero((least < NEAR).any(axis=0)):
        near = np.flatnonzero(least[:, column] < NEAR)
        first, second = avoidance.pair_names(*pair[near[0], column])
        own = second in avoidance.arm.links
        names = (second, first) if own and (first, second) not in known[1] else (first, second)
        if names not in known[1] if own else second not in known[0]:
            continue  # a frame, which is a point and sticks out of nothing
        wanted = RESERVE if own else avoidance.margin
        spare[column] = np.min(exact_distances(problem, trajectory, times[near], names) - wanted - least[near, column])
    if back:
        spare = np.minimum(spare, 0.0)
    return avoidance.less(np.where(spare > 0, SHARE * spare, spare / SHARE), MOST) if spare.any() else avoidance
