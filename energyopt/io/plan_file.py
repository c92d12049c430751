"""Plans in .npz files: save_plan and load_plan. The motion comes back bit for bit, and needs no other file.

Members: ``meta`` is JSON text (what is no array), ``urdf`` the robot's prepared URDF, and the arrays of the robot, the
problem and the trajectory under ``robot.…``, ``problem.…`` and ``trajectory.…``. Units are SI and radians.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from energyopt.arguments import check_plan
from energyopt.errors import EnergyOptError, FileError, RobotError
from energyopt.io.archive import npz_bytes, read_npz, write_atomic
from energyopt.io.parts import problem_arrays, problem_from_arrays, robot_arrays, robot_from_arrays
from energyopt.optima import Optimum
from energyopt.parameterizations import Trajectory, trajectory_from_arrays
from energyopt.plans import Plan, Status, Violations
from energyopt.verification import cost

FORMAT = "energyopt plan"
VERSION = 2
MAX_DEGREE = 9
MOST_OPTIMA = 20
"""Distinct optima that are saved, the best ones."""
SAME_COST = 1e-8
"""Relative difference of two computations of J that is rounding: other releases of Pinocchio sum in another order."""


def save_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan with its problem and robot; the file appears whole or not at all.

    Args:
        plan: what `energyopt.plan` gave.
        path: of the file; a name without suffix gets ``.npz``.

    Raises:
        FileError: the file cannot be written.
    """
    check_plan("save_plan", plan)
    problem, robot = plan.problem, plan.problem.robot
    meta = {"format": FORMAT, "version": VERSION, "kind": plan.trajectory.kind, "plan": _plan_meta(plan)}
    arrays = {}
    meta["robot"] = robot_arrays(robot, arrays)
    meta["problem"] = problem_arrays(problem, arrays)
    arrays |= {f"trajectory.{key}": np.asarray(value) for key, value in plan.trajectory.to_arrays().items()}
    for k, optimum in enumerate(plan.optima[:MOST_OPTIMA]):
        arrays |= {f"optimum.{k}.{key}": np.asarray(value) for key, value in optimum.trajectory.to_arrays().items()}
    text = {"meta": json.dumps(meta, default=_encode), "urdf": robot.urdf}
    target = path if _is(Path.is_dir, path) else _with_suffix(path)
    write_atomic(target, npz_bytes({k: np.frombuffer(v.encode(), dtype=np.uint8) for k, v in text.items()} | arrays))


def load_plan(path: str | Path) -> Plan:
    """Read a plan that `save_plan` wrote.

    Its cost is recomputed: a motion, robot or weight that was changed in the file no longer gives the J it states.

    Args:
        path: of the file; where there is no file of this name, ``.npz`` is added to a name without suffix.

    Raises:
        FileError: missing, damaged, of another kind, or contradicting itself; one line says what.
    """
    path = path if _is(Path.is_file, path) or not _is(Path.is_file, _with_suffix(path)) else _with_suffix(path)
    arrays = read_npz(path)
    try:
        meta = _meta(arrays)
        robot = robot_from_arrays(meta["robot"], _text(arrays, "urdf"), _group(arrays, "robot"))
        problem = problem_from_arrays(meta["problem"], robot, _group(arrays, "problem"))
        trajectory = _trajectory(str(meta["kind"]), _group(arrays, "trajectory"), robot.nv)
        plan = replace(_plan(meta["plan"], problem, trajectory), optima=_optima(meta["plan"], arrays, robot.nv))
        _check_cost(plan)
        return plan
    except EnergyOptError as error:
        raise FileError(f"{path}: not a plan that holds together: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError) as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        missing = f"{reason} is missing" if isinstance(error, KeyError) else reason
        raise FileError(f"{path}: not a plan that energyopt wrote: {missing}") from None


def _with_suffix(path: str | Path) -> str | Path:
    """The path with ``.npz`` where its name has no suffix; what is no path is left for others to refuse."""
    return Path(f"{path}.npz") if isinstance(path, (str, Path)) and Path(path).name and not Path(path).suffix else path


def _is(kind: Callable[[Path], bool], path: str | Path) -> bool:
    """Whether a path exists and is of a kind, such as `Path.is_file`; what is no path is none."""
    try:
        return isinstance(path, (str, Path)) and kind(Path(path))
    except (OSError, ValueError):
        return False


def _check_cost(plan: Plan) -> None:
    """Compare the stored cost with that of the stored motion, by numeric Pinocchio."""
    stored = plan.cost_terms
    with np.errstate(all="ignore"):
        pairs = [(f"the {name} of J", stored.get(name), value) for name, value in _cost_terms(plan).items()]
        for name, said, value in [*pairs, ("J", plan.objective, sum(stored.values()))]:
            slack = {"rtol": SAME_COST, "atol": SAME_COST * abs(plan.objective), "equal_nan": True}
            if said is not None and not np.isclose(said, value, **slack):
                raise FileError(f"{name} is stated as {said:.9g}, its motion gives {value:.9g}: the file was changed")


def _cost_terms(plan: Plan) -> dict[str, float]:
    """The terms of J; without the potential where the robot's meshes, which it needs, are not there."""
    try:
        return cost(plan.problem, plan.trajectory)
    except RobotError:
        return cost(replace(plan.problem, potential=None), plan.trajectory)


def _plan_meta(plan: Plan) -> dict[str, Any]:
    return {
        "status": plan.status.value,
        "message": plan.message,
        "objective": plan.objective,
        "cost_terms": plan.cost_terms,
        "violations": asdict(plan.violations),
        "discretization_error": plan.discretization_error,
        "iterations": plan.iterations,
        "time_s": plan.time_s,
        "seed": plan.seed,
        "options": plan.options,
        "notes": list(plan.notes),
        "optima": [{"kind": optimum.trajectory.kind, **optimum.summary} for optimum in plan.optima[:MOST_OPTIMA]],
    }


def _plan(meta: dict[str, Any], problem, trajectory: Trajectory) -> Plan:
    violations = meta["violations"]
    worst = {str(k): (str(joint), float(t)) for k, (joint, t) in violations["worst"].items()}
    error = meta["discretization_error"]
    return Plan(
        problem=problem,
        status=Status(meta["status"]),
        message=str(meta["message"]),
        trajectory=trajectory,
        objective=float(meta["objective"]),
        cost_terms=_floats(meta["cost_terms"]),
        violations=Violations(_floats(violations["amount"]), _floats(violations["margin"]), worst, violations.get("distance")),
        discretization_error=None if error is None else float(error),
        iterations=int(meta["iterations"]),
        time_s=_floats(meta["time_s"]),
        seed=int(meta["seed"]),
        options=dict(meta["options"]),
        notes=tuple(str(note) for note in meta["notes"]),
    )


def _optima(meta: dict[str, Any], arrays: dict[str, np.ndarray], nv: int) -> tuple[Optimum, ...]:
    """The distinct optima; files written before there were any hold none."""
    found = []
    for k, one in enumerate(meta.get("optima", ())[:MOST_OPTIMA]):
        motion = _trajectory(str(one["kind"]), _group(arrays, f"optimum.{k}"), nv)
        found.append(Optimum(float(one["objective"]), str(one["guess"]), int(one["guesses"]), int(one["seed"]), motion))
    return tuple(found)


def _encode(value: Any) -> Any:
    """Numpy numbers and arrays, which JSON does not know, as numbers and lists."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} in a plan's options cannot be saved")


def _meta(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    meta = json.loads(_text(arrays, "meta"))
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise ValueError("it is an archive of another kind")
    if meta.get("version") != VERSION:
        raise ValueError(f"its version is {meta.get('version')!r:.20}; this energyopt reads version {VERSION}")
    return meta


def _text(arrays: dict[str, np.ndarray], name: str) -> str:
    if arrays[name].dtype != np.uint8 or arrays[name].ndim != 1:
        raise ValueError(f"member '{name}' is no text")
    return arrays[name].tobytes().decode("utf-8")


def _group(arrays: dict[str, np.ndarray], name: str) -> dict[str, np.ndarray]:
    return {key.removeprefix(f"{name}."): value for key, value in arrays.items() if key.startswith(f"{name}.")}


def _trajectory(kind: str, arrays: dict[str, np.ndarray], nv: int) -> Trajectory:
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"trajectory.{name} holds a number that is not finite")
        if name.split(".")[-1] == "degree" and not 1 <= int(array) <= MAX_DEGREE:
            raise ValueError(f"the degree is {int(array)}; expected 1 to {MAX_DEGREE}")
    trajectory = trajectory_from_arrays(kind, arrays)
    if trajectory.nv != nv:
        raise ValueError(f"the trajectory has {trajectory.nv} joints and the robot {nv}")
    if not trajectory.duration > 0 or trajectory.breaks[0] != 0 or np.any(np.diff(trajectory.breaks) <= 0):
        raise ValueError("the trajectory's times do not increase from 0")
    if not np.isfinite(trajectory(np.array([0.0, 0.5 * trajectory.duration, trajectory.duration]))).all():
        raise ValueError("the trajectory is not finite")
    return trajectory


def _floats(table: dict[str, Any]) -> dict[str, float]:
    return {str(key): float(value) for key, value in table.items()}
