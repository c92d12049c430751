"""MuJoCo, a second engine that has no part in planning: it replays plans and checks their torques."""

from energyopt.simulation.engine import Engine, build_engine
from energyopt.simulation.inverse import check_inverse_dynamics
from energyopt.simulation.log import ReplayLog
from energyopt.simulation.replaying import replay, replay_trajectory

__all__ = ["Engine", "ReplayLog", "build_engine", "check_inverse_dynamics", "replay", "replay_trajectory"]
