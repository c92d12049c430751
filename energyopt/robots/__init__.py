"""Robots: the catalogue, loading and checking of URDF files, limits and payloads."""

from energyopt.robots.catalogue import catalogue
from energyopt.robots.loading import load_robot
from energyopt.robots.meshes import resolve_mesh
from energyopt.robots.model import Limits, RobotModel
from energyopt.robots.payload import Payload

__all__ = ["Limits", "Payload", "RobotModel", "catalogue", "load_robot", "resolve_mesh"]
