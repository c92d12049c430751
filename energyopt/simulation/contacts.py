"""Which bodies of the arm touch each other during a replay.

Contacts are switched off in the dynamics, so that touching shapes do not change the motion; they are looked for
separately. Pairs that overlap in the starting position do not count: neighbouring links whose hulls interpenetrate.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from energyopt.simulation.engine import Engine

_CONTACT_OFF = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


@dataclass(frozen=True)
class ContactCounter:
    """Counts touching pairs of bodies.

    Attributes:
        body: body of every collision shape.
        ignored: pairs of bodies that do not count.
    """

    body: np.ndarray
    ignored: frozenset[tuple[int, int]]

    @classmethod
    def starting_from(cls, engine: Engine) -> ContactCounter:
        """A counter that ignores what touches in the present configuration of ``engine.data``."""
        mujoco.mj_kinematics(engine.model, engine.data)
        mujoco.mj_comPos(engine.model, engine.data)
        counter = cls(engine.model.geom_bodyid.copy(), frozenset())
        return cls(counter.body, frozenset(counter.pairs(engine.model, engine.data)))

    def pairs(self, model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[int, int]]:
        """Pairs of bodies that overlap in the configuration whose kinematics ``data`` holds."""
        flags = int(model.opt.disableflags)
        model.opt.disableflags = flags & ~_CONTACT_OFF
        mujoco.mj_collision(model, data)
        model.opt.disableflags = flags
        touching = data.contact.geom[data.contact.dist < 0.0]
        return {tuple(sorted(pair)) for pair in self.body[touching].tolist()}

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> int:
        return len(self.pairs(model, data) - self.ignored)
