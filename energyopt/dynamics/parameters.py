"""What of an arm's dynamics is structure, and what are numbers.

The structure (joints, axes, placements, parents; which numbers are zero by symmetry; whether there is Coulomb friction; along
which axes of the base gravity acts) decides the graph of the torques, so it is compiled once. The numbers θ are inputs of that
graph: inertias, armature, friction, gravity. The torque is linear in the inertias, in armature and in the frictions.

Inertias enter as ten numbers a body, about the joint's origin: m, h = mc, I_o. Only combinations of them can be felt
(M. Gautier, W. Khalil, "Direct calculation of minimum set of inertial parameters of serial robots", IEEE Trans. Robotics and
Automation 6, 1990): an inertia that does not change, and that has no momentum, when its joint moves is felt as if it sat on
the parent. Behind a revolute joint about e that is a mass on the axis and a thin rod along it, (m, h = h e, I_o = J (1 − eeᵀ));
behind a prismatic joint a pure I_o. Those are handed down to the parent, which leaves seven numbers, or four, for a body; less
where links are symmetric. At the last body of each branch all seven count, whatever they are: a payload there changes no
structure.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from energyopt.dynamics.body import Dynamics, joint_axis

UPPER = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Entries of I_o in the order of the ten numbers (m, h, I_o)."""
TEN = 10
NOTHING = 1e-13
"""Numbers of a body below this share of the largest are zero by symmetry."""
ROUNDING = 2e-11
"""Entries of unit rotations below this are the rounding of π in URDF files; as exact zeros they keep the graph sparse."""


@dataclass(frozen=True, eq=False)
class Structure:
    """The structure of an arm.

    Attributes:
        parents: joint numbers, 0 the base; entry 0 is unused. axes: (kind, axis) of each joint from 1 on.
        rotations, translations: of each joint in its parent, (nv, 3, 3), (nv, 3) [m].
        kept: of each joint, which of the ten numbers of its body are inputs, (nv, 10).
        coulomb: whether there is Coulomb friction; gravity: along which axes of the base there is gravity, three flags.
    """

    parents: tuple[int, ...]
    axes: tuple[tuple[str, np.ndarray], ...]
    rotations: np.ndarray
    translations: np.ndarray
    kept: np.ndarray
    coulomb: bool
    gravity: tuple[bool, bool, bool]

    @property
    def nv(self) -> int:
        return len(self.axes)

    @cached_property
    def digest(self) -> str:
        """Hash of everything the graph depends on."""
        h = hashlib.sha256(repr((self.parents, self.coulomb, self.gravity, [kind for kind, _ in self.axes])).encode())
        for values in (*(axis for _, axis in self.axes), self.rotations, self.translations, self.kept):
            h.update(np.ascontiguousarray(values, dtype=float).tobytes())
        return h.hexdigest()

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where θ holds what: ``inertia``, ``armature``, ``viscous``, ``coulomb``, ``sharpness`` (1/v_s) and ``gravity``."""
        friction = self.nv if self.coulomb else 0
        sizes = {
            "inertia": int(self.kept.sum()), "armature": self.nv, "viscous": self.nv,
            "coulomb": friction, "sharpness": friction, "gravity": sum(self.gravity),
        }  # fmt: skip
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end - size), int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @property
    def size(self) -> int:
        """Numbers in θ."""
        return self.slices["gravity"].stop


def structure_of(dynamics: Dynamics) -> Structure:
    """The structure of an arm whose joints have one degree of freedom each."""
    model = dynamics.model
    joints, numbers = range(1, model.njoints), body_numbers(model)
    parents = tuple(int(p) for p in model.parents)
    last = [k for k in range(model.nv) if k + 1 not in parents]
    size = np.abs(numbers).max() if len(numbers) else 0.0
    numbers[last] += size * np.random.default_rng(0).uniform(0.5, 1.0, (len(last), TEN))
    structure = Structure(
        parents=parents,
        axes=tuple((kind, rounded(axis)) for kind, axis in (joint_axis(model, i) for i in joints)),
        rotations=np.array([rounded(model.jointPlacements[i].rotation) for i in joints]),
        translations=np.array([rounded(model.jointPlacements[i].translation) for i in joints]),
        kept=np.ones((model.nv, TEN), bool),
        coulomb=bool(np.any(dynamics.coulomb_friction)),
        gravity=tuple(bool(g) for g in model.gravity.linear != 0.0),
    )
    felt = np.abs(felt_inertias(numbers, structure))
    return replace(structure, kept=felt > NOTHING * felt.max(initial=0.0))


def numbers_of(dynamics: Dynamics, structure: Structure) -> np.ndarray:
    """θ of an arm, shape (structure.size,)."""
    friction = (dynamics.coulomb_friction, 1.0 / np.broadcast_to(dynamics.coulomb_velocity, dynamics.nv))
    return np.concatenate(
        [
            felt_inertias(body_numbers(dynamics.model), structure)[structure.kept],
            dynamics.armature,
            dynamics.viscous_friction,
            *(friction if structure.coulomb else ()),
            np.asarray(dynamics.model.gravity.linear)[list(structure.gravity)],
        ]
    )


def body_numbers(model: pin.Model) -> np.ndarray:
    """m [kg], h = mc [kg·m] and I_o [kg·m²] of each joint's body, (nv, 10)."""
    return np.array([model.inertias[i].toDynamicParameters() for i in range(1, model.njoints)])


def felt_inertias(bodies: np.ndarray, structure: Structure) -> np.ndarray:
    """The ten numbers of each body, (nv, 10), less what is not felt at its joint, which is handed down to its parent. Linear."""
    felt = np.array(bodies, dtype=float)
    for k in reversed(range(structure.nv)):
        handed = _handed_down(felt[k], *structure.axes[k])
        felt[k] -= handed
        if parent := structure.parents[k + 1]:
            felt[parent - 1] += moved(handed, structure.rotations[k], structure.translations[k])
    return felt


def moved(numbers: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """The ten numbers of a body in a frame in which its own frame has this rotation and translation."""
    m, h, inertia = numbers[0], rotation @ numbers[1:4], rotation @ tensor(numbers) @ rotation.T
    a, b = pin.skew(h), pin.skew(np.asarray(translation, dtype=float))
    inertia = inertia - a @ b - b @ a - m * b @ b
    return np.concatenate([[m], h + m * translation, [inertia[i, j] for i, j in UPPER]])


def tensor(numbers: np.ndarray) -> np.ndarray:
    """I_o of the ten numbers of a body, (3, 3)."""
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(numbers[4:], UPPER, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def _along(axis: np.ndarray) -> int | None:
    """The coordinate axis along which a joint axis lies, or None."""
    k = int(np.argmax(np.abs(axis)))
    return k if abs(axis[k]) > 1.0 - 1e-12 else None


def _handed_down(numbers: np.ndarray, kind: str, axis: np.ndarray) -> np.ndarray:
    handed = np.zeros(TEN)
    k = _along(axis)
    if kind == "prismatic":
        handed[4:] = numbers[4:]
    elif k is not None:
        j, other = (k + 1) % 3, (k + 2) % 3
        handed[0], handed[1 + k] = numbers[0], numbers[1 + k]
        handed[4 + UPPER.index((j, j))] = handed[4 + UPPER.index((other, other))] = numbers[4 + UPPER.index((j, j))]
    return handed


def rounded(values: np.ndarray) -> np.ndarray:
    """Entries of rotations, or lengths in m, with what is nearly zero or one made exactly that."""
    values = np.array(values, dtype=float)
    values[np.abs(values) < ROUNDING] = 0.0
    near = np.abs(np.abs(values) - 1.0) < ROUNDING
    values[near] = np.sign(values[near])
    return values
