"""Median savings on random moves of a Panda at 1.3 times their least time.

Start and goal are random, inside the limits and clear of self-collision (see `_shared.random_moves`). The least time of a move is
that in which the straight way between its ends in joint space can be passed, from rest to rest, within the limits of velocity,
acceleration and torque (`energyopt.minimum_duration`; the bang-bang timing of that path). Optimal motions need not be straight;
limits and self-collision hold for them. Compared are motions of 1.3 times that time:

    planned for J          energyopt's defaults: ∫(Στ² + λΣq̇²)dt
    planned for joules     the electrical energy of the drives below
    quintic, trapezoidal   on the straight way, not held to any limit: what they break is counted

Electrical joules need drives. No publication gives those of the Panda, so `DRIVE` is a generic example, chosen by the size of a
joint; it stands for no product. Standby power, the same for all motions of one duration, is left out.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from _shared import Report, parser, publish, quartiles, random_moves, settings, shown, table

import energyopt as eo
from energyopt.costs import ElectricalEnergy
from energyopt.io.pages import write_block
from energyopt.metrics import metrics
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.verification import excessive, verify

MEASURES = "savings at 1.3 times the least time, against quintic and trapezoidal motions (∫τ², electrical and mechanical joules)"
ACCELERATION = {"panda": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)}
"""Limits that the maker states and the URDF lacks [rad/s²]: Franka Control Interface documentation, "Robot limits"."""
STRONG = 30.0
"""Torque limit [N·m] from which a joint has the larger motor."""
DRIVE = {"gear_ratio": 100.0, "efficiency": 0.85}
MOTORS = {True: {"torque_constant": 0.1, "resistance": 0.4}, False: {"torque_constant": 0.05, "resistance": 1.0}}
"""The generic drive: of every joint; of strong joints and of weak ones. The bus is shared; braking power left over is burnt."""
ORDINARY = ("quintic", "trapezoidal")
MEASURED = {"torque_squared": "∫Στ²dt", "electrical_J": "electrical joules", "mechanical_J": "mechanical joules Σ∫|τq̇|dt"}
WITHIN = "boundary"
"""What an ordinary motion may break: a trapezoidal one leaves rest with an acceleration."""
PAGE = Path(__file__).resolve().parents[2] / "docs" / "benchmarks.md"
BEGIN, END = "<!-- moves: begin -->", "<!-- moves: end -->"


def main() -> int:
    made = parser("moves", MEASURES)
    made.add_argument("--robot", default="panda", metavar="NAME")
    made.add_argument("--problems", type=int, default=50, metavar="N")
    made.add_argument("--factor", type=float, default=1.3, metavar="X", help="duration as a multiple of the least time")
    made.add_argument("--processes", type=int, default=1, metavar="N")
    made.add_argument("--docs", action="store_true", help="write the table into docs/benchmarks.md")
    parsed = made.parse_args()
    results = _results(parsed)
    if parsed.docs:
        _write(results, parsed)
    return publish(Report("moves", MEASURES, settings(parsed), results, _text(results)), parsed.json)


def _results(parsed: argparse.Namespace) -> dict:
    bare = eo.load_robot(parsed.robot)
    drives = eo.Actuators([_drive(limit) for limit in bare.limits.torque], shared_bus=True, source="generic example")
    robot = eo.load_robot(parsed.robot, actuators=drives)
    moves = [_timed(move, parsed.factor) for move in _moves(robot, parsed)]
    goals = {"planned for J": moves, "planned for joules": [replace(move, costs=[ElectricalEnergy()]) for move in moves]}
    plans = {name: eo.plan_many(asked, processes=parsed.processes) for name, asked in goals.items()}
    solved = [k for k in range(len(moves)) if all(plans[name][k].solved for name in plans)]
    measured = [
        {name: _measure(moves[k], plans[name][k].trajectory) for name in plans}
        | {kind: _measure(moves[k], eo.baseline(moves[k], kind)) for kind in ORDINARY}
        for k in solved
    ]
    return {
        "problems": len(moves),
        "solved": {name: sum(plan.solved for plan in made) for name, made in plans.items()},
        "compared": len(solved),
        "duration_s": quartiles([moves[k].duration for k in solved]),
        "saved_percent": {name: {kind: _savings(measured, name, kind) for kind in ORDINARY} for name in plans},
        "broken": {kind: _broken(measured, kind) for kind in ORDINARY},
        "moves": measured,
    }


def _drive(limit: float) -> eo.ActuatorModel:
    return eo.ActuatorModel(**DRIVE, **MOTORS[bool(limit >= STRONG)])


def _moves(robot: eo.RobotModel, parsed: argparse.Namespace) -> list[eo.Problem]:
    own = ACCELERATION.get(parsed.robot)
    return random_moves(robot, parsed.problems, parsed.seed, self_collision=True, acceleration_limits=own)


def _timed(move: eo.Problem, factor: float) -> eo.Problem:
    """The move in ``factor`` times the least time of its straight way."""
    least = eo.minimum_duration(np.array([move.start, move.goal_position]), move.robot, move.limits)
    return replace(move, duration=factor * least)


def _measure(move: eo.Problem, motion: Trajectory) -> dict:
    """Costs of a motion, and names of what it breaks."""
    mechanical = metrics(move, motion)
    return {
        "torque_squared": mechanical.torque_squared,
        "electrical_J": eo.energy_account(motion, move.robot).electrical_J,
        "mechanical_J": mechanical.mechanical_abs_J,
        "broken": [name for name in excessive(verify(move, motion)) if name != WITHIN],
    }


def _savings(measured: list[dict], name: str, kind: str) -> dict:
    """What a plan saves of an ordinary motion's costs [%].

    Quartiles over the moves, over those on which the ordinary motion breaks nothing, and the saving in the sum of all moves:
    moves that go down draw next to nothing from the supply, and a percentage of next to nothing may be anything.
    """
    saved = lambda key, some: quartiles([100.0 * (1.0 - one[name][key] / one[kind][key]) for one in some])
    total = lambda key, motion: sum(one[motion][key] for one in measured)
    keeping = [one for one in measured if not one[kind]["broken"]]
    return {
        key: {
            "all": saved(key, measured),
            "keeping limits": saved(key, keeping),
            "sum": 100.0 * (1.0 - total(key, name) / total(key, kind)) if measured else None,
        }
        for key in MEASURED
    }


def _broken(measured: list[dict], kind: str) -> dict:
    """How many ordinary motions break what."""
    every = [one[kind]["broken"] for one in measured]
    return {"any": sum(bool(broken) for broken in every), **Counter(name for broken in every for name in broken)}


def _rows(results: dict) -> list[tuple[str, ...]]:
    rows = []
    for name, by_kind in results["saved_percent"].items():
        for kind, by_key in by_kind.items():
            sums = ("none" if by_key[key]["sum"] is None else f"{by_key[key]['sum']:.0f}" for key in MEASURED)
            cells = (f"{shown(by_key[key]['all'], '.0f')}; {whole}" for key, whole in zip(MEASURED, sums, strict=True))
            rows.append((name, kind, *cells))
    return rows


HEAD = ("motion", "against", *(f"{words} [%]" for words in MEASURED.values()))


def _remarks(results: dict) -> list[str]:
    """What breaks what, and how many are compared."""
    count = results["compared"]
    solved = ", ".join(f"{number} {name}" for name, number in results["solved"].items())
    lines = [f"Solved of {results['problems']}: {solved}; {count} compared, {shown(results['duration_s'], '.2f')} s long."]
    for kind, broken in results["broken"].items():
        by = ", ".join(f"{_words(name)} {number}" for name, number in broken.items() if name != "any")
        lines.append(f"The {kind} motion breaks something in {broken['any']} of {count} moves{f' ({by})' if by else ''}.")
    return lines


def _words(name: str) -> str:
    return {"torque_percent": "torque", "clearance": "self-collision"}.get(name, name)


def _text(results: dict) -> str:
    lines = [f"  {line}\n" for line in _remarks(results)]
    return table(HEAD, _rows(results)) + "  savings: median over the moves (quartiles); of all together\n" + "".join(lines)


def _write(results: dict, parsed: argparse.Namespace) -> None:
    """The table and its caption into docs/benchmarks.md."""
    escaped = lambda cells: "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
    strong, weak = ("{torque_constant:g} N·m/A and {resistance:g} Ω".format(**MOTORS[size]) for size in (True, False))
    caption = (
        f"Savings on {results['compared']} random {parsed.robot} moves (`moves`, seed {parsed.seed}) at {parsed.factor:g} times\n"
        "the least time of the straight way: median over the moves (quartiles); of all together. Electrical joules are those of\n"
        "a generic example drive, NOT of this arm, whose drive data nobody has published:\n"
        f"gear {DRIVE['gear_ratio']:g}:1 of efficiency {DRIVE['efficiency']:g}, {strong} for joints of {STRONG:g} N·m or more,\n"
        f"{weak} for the others, one bus that burns what is left over, no standby power."
    )
    rows = [escaped(HEAD), "|---|---|" + "--:|" * (len(HEAD) - 2), *(escaped(row) for row in _rows(results))]
    block = "\n\n".join([caption, "\n".join(rows), "\n".join(_remarks(results))])
    write_block(PAGE, (BEGIN, END), block)


if __name__ == "__main__":
    sys.exit(main())
