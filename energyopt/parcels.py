"""Parcels: problems as they travel to other processes and machines, and plans as they come back.

A problem is pickled without its robot, which travels beside it in packed form and is unpacked once a process: problems of the
same arm find one `RobotModel` there, and with it all that is kept for it (kernels, covers of spheres, pairs of links). A plan
comes back without its problem, which the sender has. Parcels pass between a process and those that work for it, and nobody else.
"""

from __future__ import annotations

import io
import pickle
import traceback
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from energyopt import __version__
from energyopt.errors import EnergyOptError, InputError, RobotError
from energyopt.problem import Problem
from energyopt.robots.model import RobotModel
from energyopt.serving import no_more_processes, sendable

_ROBOT = "robot"
_PACKED: WeakKeyDictionary[RobotModel, bytes] = WeakKeyDictionary()


@dataclass(frozen=True)
class Parcel:
    """A problem and its robot, ready to be sent.

    Attributes:
        problem, robot: pickled, the robot compressed too.
        folders: of the robot's meshes, which have to be in the same place wherever the parcel goes.
        version: of the energyopt that packed it.
    """

    problem: bytes
    robot: bytes
    folders: tuple[str, ...]
    version: str = __version__


def packed(problem: Problem) -> Parcel:
    """A parcel of a problem.

    Raises:
        InputError: it holds something that no other process could read.
    """
    robot, buffer = problem.robot, io.BytesIO()
    try:
        _Packer(buffer, pickle.HIGHEST_PROTOCOL).dump(problem)
        if robot not in _PACKED:
            bare = replace(robot, dynamics=replace(robot.dynamics))  # without what is kept for it
            _PACKED[robot] = zlib.compress(pickle.dumps(bare, pickle.HIGHEST_PROTOCOL), 1)
    except Exception as error:  # whatever the objects in it raise
        remedy = "functions must be those of a module; or plan it with executor=ThreadPoolExecutor(1), which sends nothing"
        raise InputError(f"the problem cannot be sent to another process: {error}; {remedy}") from None
    return Parcel(buffer.getvalue(), _PACKED[robot], tuple(str(d) for d in robot.package_dirs if d.is_dir()))


def unpacked(parcel: Parcel) -> Problem:
    """The problem of a parcel.

    Raises:
        EnergyOptError: this is another energyopt. RobotError: the robot's meshes are not on this machine.
    """
    if parcel.version != __version__:
        raise EnergyOptError(f"this worker has energyopt {__version__}, the sender {parcel.version}; install the same everywhere")
    missing = [folder for folder in parcel.folders if not Path(folder).is_dir()]
    if missing:
        raise RobotError(f"the robot's meshes are not on this worker: no folder {missing[0]}; give all machines the same paths")
    return _Unpacker(parcel).load()


class _Packer(pickle.Pickler):
    def persistent_id(self, value: Any) -> str | None:
        return _ROBOT if isinstance(value, RobotModel) else None


class _Unpacker(pickle.Unpickler):
    def __init__(self, parcel: Parcel):
        super().__init__(io.BytesIO(parcel.problem))
        self._robot = parcel.robot

    def persistent_load(self, name: str) -> RobotModel:
        return _robot(self._robot)


@lru_cache(maxsize=16)
def _robot(data: bytes) -> RobotModel:
    return pickle.loads(zlib.decompress(data))


def plan_parcel(parcel: Parcel, options: Mapping[str, Any]) -> Any:
    """In a worker: plan what a parcel asks for; the plan goes back without its problem."""
    from energyopt.planning import plan

    with no_more_processes(), noted():
        return replace(plan(unpacked(parcel), throw=False, **options), problem=None)


@contextmanager
def noted() -> Iterator[None]:
    """Errors nobody foresaw get their traceback as a note: it does not travel otherwise. What cannot travel is replaced."""
    try:
        yield
    except Exception as error:
        if not isinstance(error, EnergyOptError):
            error.add_note("".join(traceback.format_exception(error)))
        raise sendable(error) from None
