"""Which links of a robot are to be kept apart.

Of all pairs of links, those are left out, each with its reason, that

- are fixed to one another, or joined by one moving joint (they touch by construction);
- the robot's SRDF says may touch (``disable_collisions``);
- overlap in nearly every one of many random configurations: their collision geometry is made that way;
- came nowhere near one another in any of them. Sampling is no proof: such pairs are left out of planning only, and stay in the
  exact check of a finished motion;
- are so near to one another by construction that their spheres overlap in nearly every configuration, where they themselves do
  not. No motion could part those spheres, so these pairs too are left to the exact check.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from energyopt.errors import RobotError
from energyopt.geometry.bodies import Attached, Body, collision_bodies
from energyopt.geometry.cache import VERSION, Arrays, cached_arrays, digest
from energyopt.geometry.exact import CollisionScene
from energyopt.geometry.robot_spheres import SphereModel, centers, robot_spheres
from energyopt.robots.model import RobotModel
from energyopt.robots.urdf_xml import child_link, moving_joints, parent_link

SAMPLES = 1000
SPHERE_SAMPLES = 200
ALWAYS = 0.95
"""A pair that overlaps in this share of random configurations overlaps by construction."""
NEAR = 0.1
"""A pair that was never closer than this [m] is left out of planning."""
SAMPLED = ("share", "closest", "covered")
MAX_SRDF_BYTES = 5_000_000


@dataclass(frozen=True)
class PrunedPair:
    """A pair of links that is not planned with, and why; ``closest`` is the least distance seen [m], nan where none was taken."""

    first: str
    second: str
    reason: str
    closest: float = float("nan")


@dataclass(frozen=True)
class SelfCollisionPairs:
    """Pairs of links, as names.

    Attributes:
        pairs: to be kept apart by planning.
        checked: to be checked on a finished motion: ``pairs``, those that sampling has never seen near, and those whose spheres
            nearly always overlap.
        pruned: all others, with the reason.
    """

    pairs: tuple[tuple[str, str], ...]
    checked: tuple[tuple[str, str], ...]
    pruned: tuple[PrunedPair, ...]

    def report(self) -> str:
        """What was left out and why, one line a reason."""
        groups: dict[str, list[PrunedPair]] = {}
        for pair in self.pruned:
            groups.setdefault(pair.reason, []).append(pair)
        lines = [f"{len(self.pairs)} pairs of links are kept apart: " + ", ".join("–".join(pair) for pair in self.pairs)]
        return "\n".join(lines + [f"{r}: " + ", ".join(f"{p.first}–{p.second}" for p in ps) for r, ps in groups.items()])


def self_collision_pairs(
    robot: RobotModel, attached: Sequence[Attached] = (), allowed: Sequence[tuple[str, str]] = (), seed: int = 0
) -> SelfCollisionPairs:
    """The pairs of links of a robot that are to be kept apart; deterministic, and kept in the user's cache.

    Args:
        robot: its URDF gives the bodies, its SRDF, where there is one, pairs that may touch.
        attached: tools and grasped objects, by their names.
        allowed: further pairs that may touch, by name.
        seed: of the random configurations.

    Raises:
        RobotError: the SRDF is damaged.
    """
    bodies = collision_bodies(robot, attached)
    reasons = _structural(robot, bodies)
    links = dict.fromkeys(body.link for body in bodies)
    for stated, reason in ((_srdf_pairs(robot), "the SRDF lets them touch"), (allowed, "allowed by the caller")):
        for first, second in stated:
            if first in links and second in links:
                reasons.setdefault(frozenset((first, second)), reason)
    open_ = [pair for pair in combinations(links, 2) if frozenset(pair) not in reasons]
    seen = _sampled(robot, attached, open_, seed)
    pairs, checked, pruned = [], [], []
    for pair, hits, distance, covered in zip(open_, seen["share"], seen["closest"], seen["covered"], strict=True):
        reason = _reason(hits, distance, covered)
        if reason is None:
            pairs.append(pair)
        else:
            pruned.append(PrunedPair(*pair, reason, float(distance)))
        if hits < ALWAYS:
            checked.append(pair)
    stated = [PrunedPair(*pair, reasons[frozenset(pair)]) for pair in combinations(links, 2) if frozenset(pair) in reasons]
    return SelfCollisionPairs(tuple(pairs), tuple(checked), (*stated, *pruned))


def _reason(hits: float, distance: float, covered: float) -> str | None:
    """Why sampling leaves a pair out of planning; ``covered`` is the share of configurations in which spheres overlap."""
    if hits >= ALWAYS:
        return f"overlap in at least {ALWAYS:.0%} of {SAMPLES} random configurations"
    if distance > NEAR:
        return f"never within {NEAR:g} m in {SAMPLES} random configurations (checked on the finished motion)"
    if covered >= ALWAYS:
        return f"their spheres overlap in at least {ALWAYS:.0%} of the configurations (checked on the finished motion)"
    return None


def sphere_pairs(spheres: SphereModel, pairs: Sequence[tuple[str, str]]) -> np.ndarray:
    """Indices (i, j) of all pairs of spheres on pairs of links, shape (P, 2)."""
    on: dict[str, list[int]] = {}
    for k, link in enumerate(spheres.link):
        on.setdefault(link, []).append(k)
    found = [ij for first, second in pairs for ij in product(on.get(first, ()), on.get(second, ()))]
    return np.array(found, dtype=int).reshape(-1, 2)


def random_configurations(robot: RobotModel, count: int, seed: int) -> np.ndarray:
    """Even over the joint ranges, and the home configuration first; shape (count, nv) [rad]."""
    lower, upper = robot.limits.lower, robot.limits.upper
    finite = np.isfinite(lower) & np.isfinite(upper)
    low, high = np.where(finite, lower, robot.home - np.pi), np.where(finite, upper, robot.home + np.pi)
    q = np.random.default_rng(seed).uniform(low, high, (count, robot.nv))
    q[0] = robot.home
    return q


def _structural(robot: RobotModel, bodies: Sequence[Body]) -> dict[frozenset, str]:
    """Pairs that touch by construction of the kinematic tree."""
    joint = {body.link: body.joint for body in bodies}
    reasons = {frozenset(p): "fixed to one another" for p in combinations(joint, 2) if joint[p[0]] == joint[p[1]]}
    root = ET.fromstring(robot.urdf)
    for moving in moving_joints(root):
        parents, children = _solid_above(root, parent_link(moving), joint), _solid_below(root, child_link(moving), joint)
        for pair in product(parents, children):
            reasons.setdefault(frozenset(pair), "joined by one joint")
    return reasons


def _solid_above(root: ET.Element, link: str, solid: dict[str, int]) -> list[str]:
    """The link, or where it has no geometry the nearest one above that it is fixed to and that has."""
    fixed = {child_link(j): parent_link(j) for j in root.findall("joint") if j.get("type") == "fixed"}
    while link not in solid and link in fixed:
        link = fixed[link]
    return [link] if link in solid else []


def _solid_below(root: ET.Element, link: str, solid: dict[str, int]) -> list[str]:
    """The link, or where it has no geometry the nearest ones below that are fixed to it and have."""
    if link in solid:
        return [link]
    below = [child_link(j) for j in root.findall("joint") if j.get("type") == "fixed" and parent_link(j) == link]
    return [found for child in below for found in _solid_below(root, child, solid)]


def _srdf_pairs(robot: RobotModel) -> list[tuple[str, str]]:
    if robot.srdf is None:
        return []
    try:
        data = robot.srdf.read_bytes()
        if len(data) > MAX_SRDF_BYTES or b"<!DOCTYPE" in data:
            raise RobotError(f"{robot.srdf}: larger than {MAX_SRDF_BYTES / 1e6:.0f} MB, or contains a DOCTYPE; expected an SRDF")
        root = ET.fromstring(data)
    except OSError as error:
        raise RobotError(f"{robot.srdf}: cannot be read ({error.strerror or error}); it says which links may touch") from None
    except ET.ParseError as error:
        raise RobotError(f"{robot.srdf}: is no XML ({error}); expected an SRDF, which says which links may touch") from None
    return [(e.get("link1", ""), e.get("link2", "")) for e in root.iter("disable_collisions")]


def _sampled(robot: RobotModel, attached: Sequence[Attached], pairs: list[tuple[str, str]], seed: int) -> Arrays:
    """For each pair over random configurations: the share in which it overlaps, the least distance seen (or a bound of it), and
    the share in which spheres of the two overlap."""
    if not pairs:
        return {key: np.empty(0) for key in SAMPLED}

    def compute() -> Arrays:
        scene = CollisionScene(robot, (), pairs, attached)
        q = random_configurations(robot, SAMPLES, seed)
        distance = scene.distances(q, cutoff=NEAR)
        number = {pair: k for k, pair in enumerate(pairs)}
        owner = np.array([number[pair] for pair in scene.pairs])
        least = np.stack([distance[:, owner == k].min(axis=1) for k in range(len(pairs))], axis=1)
        covered = _sphere_overlaps(robot_spheres(robot, attached=attached), pairs, q[:SPHERE_SAMPLES])
        return {"share": np.mean(least < 0, axis=0), "closest": least.min(axis=0), "covered": covered}

    key = digest(VERSION, *_scene_parts(robot, attached), repr((pairs, seed, SAMPLES, SPHERE_SAMPLES, NEAR)))
    return cached_arrays("pairs", key, compute, lambda arrays: all(_fits(arrays.get(k), len(pairs)) for k in SAMPLED))


def _sphere_overlaps(spheres: SphereModel, pairs: list[tuple[str, str]], q: np.ndarray) -> np.ndarray:
    """The share of configurations in which spheres of a pair of links overlap, shape (P,)."""
    at, link = centers(spheres, q), np.array(spheres.link)
    shares = np.zeros(len(pairs))
    for k, names in enumerate(pairs):
        first, second = (np.flatnonzero(link == name) for name in names)
        gaps = np.linalg.norm(at[:, first, None] - at[:, None, second], axis=3)
        shares[k] = np.mean(np.any(gaps < spheres.radius[first, None] + spheres.radius[second], axis=(1, 2)))
    return shares


def _scene_parts(robot: RobotModel, attached: Sequence[Attached]) -> list[str | np.ndarray]:
    """Everything the distances depend on, as parts of a hash."""
    parts: list[str | np.ndarray] = [robot.urdf, robot.limits.lower, robot.limits.upper, robot.home]
    for body in collision_bodies(robot, attached):
        parts += [body.link, str(body.joint), body.shape.kind, np.array(body.shape.pose), np.array(body.shape.enclosing_points())]
    return parts


def _fits(array: np.ndarray | None, count: int) -> bool:
    return array is not None and array.shape == (count,) and array.dtype == float and bool(np.isfinite(array).all())
