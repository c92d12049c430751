"""RRT-Connect: a path between two configurations where the straight way is blocked.

Two trees of free ways grow from start and goal (J. J. Kuffner and S. M. LaValle, "RRT-Connect", IEEE ICRA 2000). Of each in
turn, the node nearest to a random configuration is extended towards it by at most a step; the other tree is then connected
to the new node, step by step, until it arrives or is stopped. Two refinements that are usual: the smaller tree is extended,
and a node from which an extension has failed accepts random configurations only from its own neighbourhood (A. Yershova,
L. Jaillet, T. Siméon and S. M. LaValle, "Dynamic-Domain RRTs", IEEE ICRA 2005), so that nodes in corners are not asked in vain.

The same generator gives the same path, as long as no time limit cuts the search short.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from energyopt.errors import ProblemError
from energyopt.pathfinding.free_space import FreeSpace

STEP = 0.15
"""Longest extension, as a share of the diagonal of the box that is sampled."""
DOMAIN = 2.0
"""Radius of the neighbourhood of a node from which an extension has failed, in steps."""
SAMPLED_BEYOND = np.pi
"""Joints with more than a turn of range are sampled so far beyond start and goal [rad]; other turns mean the same places."""


@dataclass(frozen=True)
class Budget:
    """What a search may spend.

    Attributes:
        seconds: of wall time; None for no limit.
        nodes: of both trees.
        until: when everything ends, a time of `time.monotonic`.
    """

    seconds: float | None = 5.0
    nodes: int = 50_000
    until: float = np.inf

    def deadline(self) -> float:
        """The end of a search that begins now, a time of `time.monotonic`."""
        return self.until if self.seconds is None else min(time.monotonic() + self.seconds, self.until)

    @property
    def over(self) -> bool:
        return time.monotonic() >= self.until


@dataclass(frozen=True, eq=False)
class PathSearch:
    """How a search for a path ended.

    Attributes:
        path: configurations joined by straight free ways, start and goal included, shape (K, nv); None where none was found.
        reason: in a few words, what was spent without one; "" with a path.
        nodes: of both trees; seconds: wall time.
    """

    path: np.ndarray | None
    reason: str
    nodes: int
    seconds: float

    @property
    def found(self) -> bool:
        return self.path is not None


def rrt_connect(
    free: FreeSpace, start: np.ndarray, goal: np.ndarray, rng: np.random.Generator, budget: Budget | None = None
) -> PathSearch:
    """A path of straight free ways from ``start`` to ``goal`` (nv,) [rad].

    Args:
        free: the robot among obstacles.
        start, goal: free configurations inside the limits.
        rng: source of the random configurations.
        budget: when to give up.

    Raises:
        ProblemError: start or goal is not free or outside the limits; the message names the pair and the depth.
    """
    began, budget = time.monotonic(), budget or Budget()
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    require_free(free, start, "start")
    require_free(free, goal, "goal")
    if free.free_way(start, goal):
        return PathSearch(np.stack([start, goal]), "", 2, time.monotonic() - began)
    path, nodes = _search(free, start, goal, rng, budget.deadline(), budget.nodes)
    return ended(path, nodes, time.monotonic() - began)


def ended(path: np.ndarray | None, nodes: int, seconds: float) -> PathSearch:
    """How a search ended, in words where it found nothing."""
    return PathSearch(path, "" if path is not None else f"no path in {seconds:.1f} s, with {nodes} nodes", nodes, seconds)


def require_free(free: FreeSpace, q: np.ndarray, where: str) -> None:
    """Raise where a configuration (nv,) is not free.

    Raises:
        ProblemError: names the joint outside its limit, or the pair that is too close and by how much.
    """
    if free.free(q)[0]:
        return
    outside = np.maximum(free.limits.lower - q, q - free.limits.upper)
    worst = int(np.argmax(outside))
    if not free.inside(q[None])[0]:
        name = free.robot.joint_names[worst]
        raise ProblemError(f"{where}: joint '{name}' is at {q[worst]:.6g}, {outside[worst]:.3g} outside its position limits")
    if free.hold is not None and (load := free.load(q[None])[0]) > free.hold:
        raise ProblemError(f"{where}: standing still takes {load:.0%} of a torque limit, expected at most {free.hold:.0%}")
    if not free.allowed(q[None])[0]:
        raise ProblemError(f"{where}: a frame is outside the workspace it is bound to; choose another {where}")
    closest = free.closest(q, float(free.times(q[None])[0]))
    gap = f"{1e3 * abs(closest.distance):.2f} mm {'apart' if closest.distance > 0 else 'inside one another'}"
    raise ProblemError(
        f"{where}: '{closest.first}' and '{closest.second}' are {gap}, expected more than {1e3 * free.margin:.2f} mm; "
        f"choose another {where}, or move the obstacle"
    )


class _Tree:
    """Nodes with their parents, in arrays that grow."""

    def __init__(self, root: np.ndarray):
        self.count = 1
        self._nodes, self._parent, self._domain = np.empty((256, len(root))), np.empty(256, int), np.empty(256)
        self._nodes[0], self._parent[0], self._domain[0] = root, -1, np.inf

    def add(self, q: np.ndarray, parent: int) -> int:
        if self.count == len(self._nodes):
            self._nodes, self._parent, self._domain = (
                np.concatenate([a, np.empty_like(a)]) for a in (self._nodes, self._parent, self._domain)
            )
        k = self.count
        self._nodes[k], self._parent[k], self._domain[k] = q, parent, np.inf
        self.count += 1
        return k

    def __getitem__(self, k: int) -> np.ndarray:
        return self._nodes[k]

    def nearest(self, q: np.ndarray) -> tuple[int, float]:
        """Number of the nearest node, and its distance [rad]."""
        away = self._nodes[: self.count] - q
        square = np.einsum("ij,ij->i", away, away)
        k = int(np.argmin(square))
        return k, float(np.sqrt(square[k]))

    def accepts(self, k: int, distance: float) -> bool:
        return distance <= self._domain[k]

    def confine(self, k: int, radius: float) -> None:
        self._domain[k] = radius

    def branch(self, k: int) -> list[np.ndarray]:
        """Nodes from the root to node ``k``."""
        found = []
        while k >= 0:
            found.append(self._nodes[k].copy())
            k = int(self._parent[k])
        return found[::-1]


def _search(
    free: FreeSpace, start: np.ndarray, goal: np.ndarray, rng: np.random.Generator, deadline: float, most: int
) -> tuple[np.ndarray | None, int]:
    low, high = sampled_box(free, start, goal)
    step = STEP * float(np.linalg.norm(high - low))
    forward, backward = _Tree(start), _Tree(goal)
    while True:
        tree, other = (forward, backward) if forward.count <= backward.count else (backward, forward)
        new = _extend(free, tree, rng.uniform(low, high), step)
        if new is not None:
            joined = _connect(free, other, tree[new], step)
            if joined is not None:
                ends = (new, joined) if tree is forward else (joined, new)
                return np.array(forward.branch(ends[0]) + backward.branch(ends[1])[-2::-1]), forward.count + backward.count
        nodes = forward.count + backward.count
        if nodes >= most or time.monotonic() > deadline:
            return None, nodes


def _extend(free: FreeSpace, tree: _Tree, q: np.ndarray, step: float) -> int | None:
    """Grow a tree towards a configuration by at most a step; the number of the new node, or None."""
    near, distance = tree.nearest(q)
    if not tree.accepts(near, distance):
        return None
    if distance > step:
        q = tree[near] + step / distance * (q - tree[near])
    if not free.free_way(tree[near], q):
        tree.confine(near, DOMAIN * step)
        return None
    return tree.add(q, near)


def _connect(free: FreeSpace, tree: _Tree, q: np.ndarray, step: float) -> int | None:
    """Grow a tree towards a configuration step by step; the number of the node that is there, or None where it was stopped."""
    near, distance = tree.nearest(q)
    count = max(1, int(np.ceil(distance / step)))
    first = tree[near].copy()
    for share in np.arange(1, count + 1) / count:
        new = q if share == 1.0 else first + share * (q - first)
        if not free.free_way(tree[near], new):
            return None
        near = tree.add(new, near)
    return near


def sampled_box(free: FreeSpace, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (nv,) [rad] of the configurations that are worth trying."""
    low, high = free.limits.lower, free.limits.upper
    wide = ~(high - low <= 2 * np.pi)
    low = np.where(wide, np.maximum(low, np.minimum(start, goal) - SAMPLED_BEYOND), low)
    return low, np.where(wide, np.minimum(high, np.maximum(start, goal) + SAMPLED_BEYOND), high)
