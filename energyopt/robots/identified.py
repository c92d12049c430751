"""Friction that was identified on real arms and published, by name: ``load_robot("panda", coulomb_friction="gaz2019")``.

"gaz2019": the seven joints of a Franka Emika Panda, from C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "Dynamic
Identification of the Franka Emika Panda Robot With Retrieval of Feasible Parameters Using Penalty-Based Optimization", IEEE
Robotics and Automation Letters 4(4), 2019, and the numbers its authors published with it (github.com/marcocognetti/
FrankaEmikaPandaDynModel, function get_FrictionTorque). Their model of a joint, with φ = (φ₁, φ₂, φ₃), is

    φ₁ / (1 + exp(−φ₂ (q̇ + φ₃))) − φ₁ / (1 + exp(−φ₂ φ₃))  =  ½φ₁ [ tanh(½φ₂ (q̇ + φ₃)) − tanh(½φ₂φ₃) ]

without viscous part. It is taken over as f tanh(q̇/v_s) with f = ½φ₁ and v_s = 2/φ₂, that is without the offset φ₃, by which
friction differs between the two directions. What that leaves out is ½φ₁ tanh(½φ₂φ₃) tanh(q̇/v_s) tanh(½φ₂(q̇ + φ₃)): at most
0.074 N·m at any joint and velocity, and no more power than that torque gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from energyopt.errors import RobotError


@dataclass(frozen=True)
class IdentifiedFriction:
    """Friction of named joints.

    Attributes:
        joints: their names.
        sigmoid: φ₁ [N·m], φ₂ [s/rad] and φ₃ [rad/s], one number a joint.
        source: the publication, for notes.
    """

    joints: tuple[str, ...]
    sigmoid: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    source: str

    @property
    def coulomb(self) -> dict[str, float]:
        """f [N·m] by joint."""
        return {joint: 0.5 * size for joint, size in zip(self.joints, self.sigmoid[0], strict=True)}

    @property
    def velocity(self) -> dict[str, float]:
        """v_s [rad/s] by joint."""
        return {joint: 2.0 / steepness for joint, steepness in zip(self.joints, self.sigmoid[1], strict=True)}


FRICTION = {
    "gaz2019": IdentifiedFriction(
        joints=tuple(f"panda_joint{k}" for k in range(1, 8)),
        sigmoid=(
            (0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489),
            (5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336),
            (0.039533, 0.025882, -0.04607, 0.036194, 0.026226, -0.021047, 0.0035526),
        ),
        source="Gaz, Cognetti, Oliva, Robuffo Giordano, De Luca, IEEE RA-L 4(4), 2019",
    )
}
"""Published sets by name."""


def with_identified(coulomb: Any, velocity: Any, default: float, names: Sequence[str], where: str) -> tuple[Any, Any, list[str]]:
    """Arguments ``coulomb_friction`` and ``coulomb_velocity`` with the numbers of a set in place of its name, and a note on it.

    Args:
        coulomb, velocity: what the caller gave. default: ``velocity`` where nothing was given.
        names: joints that move. where: begins messages.

    Raises:
        RobotError: an unknown set, one of another arm, or one beside a velocity.
    """
    if not isinstance(coulomb, str) or coulomb == "urdf":
        return coulomb, velocity, []
    if coulomb not in FRICTION:
        known = ", ".join(f"'{name}'" for name in FRICTION)
        raise RobotError(f"{where}: coulomb_friction is '{coulomb}'; expected numbers, 'urdf', or a published set: {known}")
    found = FRICTION[coulomb]
    unknown = [name for name in names if name not in found.joints]
    if unknown:
        raise RobotError(
            f"{where}: coulomb_friction '{coulomb}' has no joint '{unknown[0]}'; it is for {', '.join(found.joints)}"
        )
    if not (np.isscalar(velocity) and velocity == default):
        raise RobotError(
            f"{where}: coulomb_velocity is given beside coulomb_friction '{coulomb}', which has its own; leave it out"
        )
    sizes, widths = ({name: table[name] for name in names} for table in (found.coulomb, found.velocity))
    return sizes, widths, [f"Coulomb friction as identified by {found.source}, without its offset."]
