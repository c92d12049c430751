"""Pairs of links that are to be kept apart: none is lost, and each that is left out has a reason that is true."""

from dataclasses import replace
from itertools import combinations
from xml.etree import ElementTree as ET

import arms
import numpy as np
import pytest
import urdf_factory as factory

from energyopt.errors import RobotError
from energyopt.geometry import cache
from energyopt.geometry.bodies import Attached, collision_bodies
from energyopt.geometry.exact import CollisionScene
from energyopt.geometry.robot_spheres import centers, robot_spheres
from energyopt.geometry.self_collision import random_configurations, self_collision_pairs, sphere_pairs
from energyopt.geometry.shapes import Box, Sphere

ROBOTS = ["panda", "ur5", "xarm7", "z1", "kinova", "talos_arm", "baxter"]


def box(x, y=0.0, z=0.0, size=(0.06, 0.06, 0.06)):
    numbers = " ".join(map(str, size))
    return f'<collision><origin xyz="{x} {y} {z}"/><geometry><box size="{numbers}"/></geometry></collision>'


def arm(*solids, lengths=None, **limits):
    """A planar arm about z, one text of collision elements a link, the base first; no SRDF."""
    lengths = lengths or [0.3] * (len(solids) - 1)
    root = ET.fromstring(factory.planar_arm(lengths, [1.0] * len(lengths), axis=(0, 0, 1), **limits))
    for link, solid in zip(root.findall("link"), solids, strict=False):
        link.extend(ET.fromstring(f"<x>{solid}</x>"))
    return arms.from_urdf(ET.tostring(root, encoding="unicode"))


def reason(found, first, second):
    return next((p.reason for p in found.pruned if {p.first, p.second} == {first, second}), None)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_pair_of_links_is_planned_with_or_left_out_for_a_reason(name):
    robot = arms.catalogue_robot(name)
    found = self_collision_pairs(robot)
    links = dict.fromkeys(body.link for body in collision_bodies(robot))
    listed = [frozenset(pair) for pair in found.pairs] + [frozenset((p.first, p.second)) for p in found.pruned]
    assert sorted(map(sorted, listed)) == sorted(sorted(pair) for pair in combinations(links, 2))
    assert all(p.reason for p in found.pruned) and set(found.pairs) <= set(found.checked)
    report = found.report()
    assert all(f"{p.first}–{p.second}" in report for p in found.pruned)
    sampled = {frozenset((p.first, p.second)) for p in found.pruned if "checked on the finished motion" in p.reason}
    assert {frozenset(pair) for pair in found.checked} == {frozenset(pair) for pair in found.pairs} | sampled


@pytest.mark.parametrize("name", ["panda", "ur5", "baxter"])
def test_what_the_srdf_lets_touch_is_not_planned_with(name):
    robot = arms.catalogue_robot(name)
    stated = {frozenset((e.get("link1"), e.get("link2"))) for e in ET.parse(robot.srdf).iter("disable_collisions")}
    found = self_collision_pairs(robot)
    assert stated and not stated & {frozenset(pair) for pair in found.checked}
    assert any("SRDF" in p.reason for p in found.pruned)


def test_links_fixed_together_or_joined_by_one_joint_touch_by_construction():
    found = self_collision_pairs(arms.catalogue_robot("panda"))
    assert reason(found, "panda_hand", "panda_leftfinger") == "fixed to one another"
    assert reason(found, "panda_link3", "panda_link4") == "joined by one joint"
    assert ("panda_link2", "panda_link7") in found.pairs


def test_a_link_without_geometry_does_not_hide_the_joint():
    """The base has a pedestal fixed to it and no geometry of its own; the tool hangs on the last link likewise."""
    text = factory.planar_arm([0.3, 0.3], [1.0, 1.0], axis=(0, 0, 1))
    pedestal = f'<link name="pedestal">{box(0)}</link>' + factory.joint("stand", "fixed", "pedestal", "base")
    text = text.replace("</robot>", pedestal + "</robot>").replace('<link name="tool"/>', f'<link name="tool">{box(0)}</link>')
    found = self_collision_pairs(arms.from_urdf(text.replace("</inertial></link>", f"</inertial>{box(0.1)}</link>")))
    assert reason(found, "pedestal", "link1") == "joined by one joint"
    assert reason(found, "link2", "tool") == "fixed to one another"
    assert set(map(frozenset, found.checked)) == {frozenset(p) for p in [("pedestal", "link2"), ("pedestal", "tool")]} | {
        frozenset(("link1", "tool"))
    }


def test_a_chain_of_three_keeps_its_ends_apart_unless_that_is_allowed():
    robot = arm(box(0), box(0.15), box(0.15))
    assert self_collision_pairs(robot).pairs == (("base", "link2"),)
    found = self_collision_pairs(robot, allowed=[("link2", "base"), ("link2", "nothing")])
    assert found.pairs == found.checked == () and reason(found, "base", "link2") == "allowed by the caller"


def test_links_that_always_overlap_are_left_out():
    """The last link's long box reaches back over the base, which is on the axis of both joints."""
    robot = arm(box(0, size=(0.2, 0.2, 0.1)), "", box(0, size=(0.2, 0.2, 0.1)), lengths=[0.02, 0.3])
    found = self_collision_pairs(robot)
    assert "overlap in at least 95%" in reason(found, "base", "link2") and not found.checked


def test_links_that_never_come_near_are_checked_but_not_planned_with():
    robot = arm(box(0, z=2.0), box(0.15), box(0.15))
    found = self_collision_pairs(robot)
    assert found.pairs == () and found.checked == (("base", "link2"),)
    assert "never within" in reason(found, "base", "link2")


def test_links_whose_spheres_always_overlap_are_checked_but_not_planned_with():
    """Two boxes turn above one another 1 mm apart: the spheres about them cannot be parted."""
    robot = arm(box(0, z=0.061), "", box(0.0), lengths=[1e-6, 0.3])
    found = self_collision_pairs(robot)
    assert found.pairs == () and found.checked == (("base", "link2"),)
    assert "their spheres overlap" in reason(found, "base", "link2")
    assert next(p for p in found.pruned if p.second == "link2").closest == pytest.approx(1e-3, abs=1e-6)


def test_the_least_distance_seen_is_that_of_the_same_configurations():
    robot = arms.catalogue_robot("ur5")
    found = self_collision_pairs(robot, seed=3)
    scene = CollisionScene(robot, (), found.checked)
    least = scene.distances(random_configurations(robot, 1000, 3)).min(axis=0)
    by_pair = {}
    for pair, d in zip(scene.pairs, least, strict=True):
        by_pair[pair] = min(d, by_pair.get(pair, np.inf))
    assert all(by_pair[pair] <= 0.1 for pair in found.pairs)


def test_what_is_attached_is_kept_from_the_far_links_and_not_from_its_own():
    robot = arms.catalogue_robot("panda")
    found = self_collision_pairs(robot, attached=[Attached(Box((0.03, 0.03, 0.4), (0, 0, 0.2)), "panda_hand_tcp", "stick")])
    assert reason(found, "panda_hand", "stick") == reason(found, "panda_link7", "stick") == "fixed to one another"
    assert ("panda_link0", "stick") in found.pairs and ("panda_link5", "stick") in found.checked


def test_pairs_of_spheres_are_those_of_the_links():
    robot = arms.catalogue_robot("panda")
    spheres, found = robot_spheres(robot), self_collision_pairs(robot)
    index = sphere_pairs(spheres, found.pairs)
    links = {(spheres.link[i], spheres.link[j]) for i, j in index}
    assert links == set(found.pairs) and len(index) == sum(
        spheres.link.count(first) * spheres.link.count(second) for first, second in found.pairs
    )
    at = centers(spheres, robot.home)[0]
    gaps = np.linalg.norm(at[index[:, 0]] - at[index[:, 1]], axis=1) - spheres.radius[index].sum(axis=1)
    assert gaps.min() > 0  # the home configuration can be planned from
    assert sphere_pairs(spheres, []).shape == (0, 2)


@pytest.mark.parametrize("text", ["<robot", "<!DOCTYPE x><robot/>"])
def test_a_damaged_srdf_is_one_clear_line(text, tmp_path):
    path = tmp_path / "robot.srdf"
    path.write_text(text)
    with pytest.raises(RobotError, match="SRDF"):
        self_collision_pairs(replace(arms.catalogue_robot("panda"), srdf=path))
    with pytest.raises(RobotError, match="cannot be read"):
        self_collision_pairs(replace(arms.catalogue_robot("panda"), srdf=tmp_path))


def test_a_damaged_file_of_the_cache_is_computed_again(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    robot = arm(box(0), box(0.15), box(0.15))
    first = self_collision_pairs(robot)
    (file,) = tmp_path.glob("pairs-*.npz")
    for damaged in (b"", file.read_bytes()[:100]):
        file.write_bytes(damaged)
        assert self_collision_pairs(robot) == first
    np.savez(file, share=np.zeros(1), closest=np.array([np.nan]), covered=np.zeros(1))
    assert self_collision_pairs(robot) == first
    assert np.isfinite(np.load(file)["closest"]).all()


def test_a_robot_with_one_link_has_no_pairs():
    found = self_collision_pairs(arms.pendulum(), attached=[Attached(Sphere(0.1))])
    assert found.pairs == found.checked == found.pruned == ()
