"""Robots: the catalogue, loading and checking of URDF files, limits and payloads."""

from energyopt.robots.model import Limits, RobotModel

__all__ = ["Limits", "RobotModel"]
