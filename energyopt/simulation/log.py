"""ReplayLog: what happened when a plan was replayed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from energyopt.readable import Readable

if TYPE_CHECKING:
    from energyopt.simulation.contacts import Contact


@dataclass(frozen=True, eq=False, repr=False)
class ReplayLog(Readable):
    """A simulated motion; rows are time, columns the robot's joints, the last row is at the end of the plan.

    Attributes:
        t: times [s], shape (N,).
        q, v, a: simulated position [rad], velocity [rad/s] and acceleration [rad/s²], shape (N, nv).
        tau: torque of the motors [N·m] after saturation, shape (N, nv).
        power: mechanical power τ q̇ of every motor [W], shape (N, nv).
        q_ref, v_ref: the planned motion; tau_planned: the planned torque, the feed-forward; shape (N, nv).
        contacts: number of touching pairs (links, attached objects, obstacles), shape (N,); None where nothing was watched.
        touches: every touch with its pair, times and depth, in order of beginning.
        saturated: whether some motor was at its torque limit, shape (N,).
        physics_step: time step of the integration [s].
        wall_s: time the simulation took [s].
        settings: gains, plant and what was watched for contact, for the record.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    tau: np.ndarray
    power: np.ndarray
    q_ref: np.ndarray
    v_ref: np.ndarray
    tau_planned: np.ndarray
    contacts: np.ndarray | None
    touches: tuple[Contact, ...]
    saturated: np.ndarray
    physics_step: float
    wall_s: float
    settings: dict[str, float | str | bool]

    def in_brief(self) -> str:
        touching = "contacts not looked for" if self.contacts is None else f"{len(self.touches)} contacts"
        return f"{self.t[-1]:.6g} s, {self.t.size} times, tracking error {self.tracking_max:.2g} rad at most, {touching}"

    @property
    def tracking_error(self) -> np.ndarray:
        """Simulated minus planned position [rad], shape (N, nv)."""
        return self.q - self.q_ref

    @property
    def tracking_rms(self) -> float:
        """Root of the mean over time of the squared error norm, divided by √nv: the RMS error of one joint [rad]."""
        return float(np.sqrt(np.mean(self.tracking_error**2)))

    @property
    def tracking_max(self) -> float:
        """Largest error of any joint at any time [rad]."""
        return float(np.abs(self.tracking_error).max())

    @property
    def saturated_steps(self) -> int:
        return int(np.count_nonzero(self.saturated))

    @property
    def contact_steps(self) -> int:
        """Number of steps with at least one contact; 0 also where contacts were not looked for."""
        return 0 if self.contacts is None else int(np.count_nonzero(self.contacts))

    def arrays(self) -> dict[str, np.ndarray]:
        """The time series by name, ready for ``numpy.savez``."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
