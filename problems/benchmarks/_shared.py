"""What the benchmark scripts share: random moves, clocks, the machine they run on, and how results are printed and written.

Machines are rarely idle, so times are taken by two clocks: wall time, which a user waits for, and processor time of this
process and its threads, which does not count what other programs do meanwhile (caches and frequencies are still shared with
them; the least of several repeats suffers least).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from energyopt import Problem, RobotModel
from energyopt.clearance_checks import check_ends
from energyopt.errors import ProblemError
from energyopt.feasibility import check_feasibility
from energyopt.io import write_atomic
from energyopt.versions import versions

QUINTIC_PEAK = 15.0 / 8.0
"""Peak velocity of a quintic from rest to rest over its mean velocity."""
MOST_DRAWS = 100
"""Random moves drawn for one that is possible, before a robot is given up."""

Clock = Callable[[], float]
CLOCKS: dict[str, Clock] = {"wall": time.perf_counter, "cpu": time.process_time}


@dataclass(frozen=True)
class Goal:
    """A figure that the measured one should not exceed (or, with ``least``, should reach)."""

    what: str
    measured: float
    bound: float
    unit: str
    least: bool = False

    @property
    def met(self) -> bool:
        return bool(self.measured >= self.bound if self.least else self.measured <= self.bound)

    def __str__(self) -> str:
        sign = "≥" if self.least else "≤"
        return f"{self.what}: {self.measured:.3g} {self.unit}, goal {sign} {self.bound:g}: {'met' if self.met else 'NOT met'}"


@dataclass(frozen=True)
class Report:
    """What a script found.

    Attributes:
        suite: name of the script. measures: what is measured, and against what.
        settings: of this run. results: the numbers, ready for JSON.
        text: the tables to print. goals: figures to reach.
    """

    suite: str
    measures: str
    settings: dict[str, Any]
    results: dict[str, Any]
    text: str
    goals: list[Goal] = field(default_factory=list)


def parser(suite: str, measures: str) -> argparse.ArgumentParser:
    """The arguments that all scripts have."""
    made = argparse.ArgumentParser(prog=f"{suite}.py", description=measures)
    made.add_argument("--json", type=Path, metavar="FILE", help="write the results there too")
    made.add_argument("--seed", type=int, default=0, metavar="N", help="of the random moves")
    return made


def settings(parsed: argparse.Namespace) -> dict[str, Any]:
    return {key: value for key, value in vars(parsed).items() if key != "json"}


def publish(report: Report, path: Path | None) -> int:
    """Print a report and write it as JSON where asked. Returns exit code 0: a goal that is missed is a finding, no failure."""
    host, used = machine(), versions()
    print(f"{report.suite}: {report.measures}\n")
    print(report.text)
    for goal in report.goals:
        print(f"  {goal}")
    print(f"\n  {host['cpu']}, {host['cores']} cores, load {host['load']:.1f} (of others too); {host['system']}")
    print("  " + ", ".join(f"{name} {version}" for name, version in used.items()), flush=True)
    if path is not None:
        goals = [{**asdict(goal), "met": goal.met} for goal in report.goals]
        content = {"suite": report.suite, "measures": report.measures, "settings": report.settings, "results": report.results}
        content |= {"goals": goals, "machine": host, "versions": used}
        write_atomic(path, json.dumps(content, indent=1, allow_nan=False).encode())
    return 0


def machine() -> dict[str, Any]:
    """Processor, number of cores this process may use, load (mean number of running programs in the last minute), system."""
    cpu = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), cpu)
    except OSError:
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return {"cpu": cpu, "cores": cores, "load": round(load, 2), "system": f"{platform.system()} {platform.machine()}"}


def random_moves(robot: RobotModel, count: int, seed: int, self_collision: bool = False, **options: Any) -> list[Problem]:
    """Random rest-to-rest moves with all the robot's limits on; rivals do not know self-collision, so it is off by default.

    Start and goal are uniform inside the position limits less 10 % of their range at either side, and inside ±2.5 rad; the
    duration is 1.3 to 1.6 times the least with which a quintic keeps the velocity limits. Moves that no motion can make
    (an arm too weak to hold its start or goal, or one that touches itself there) are drawn again.

    Args:
        robot: which arm.
        count: how many.
        seed: the same seed gives the same moves.
        self_collision: whether links are kept apart.
        options: further arguments of `Problem`.
    """
    rng, limits, made = np.random.default_rng(seed), robot.limits, []
    margin = 0.1 * (limits.upper - limits.lower)
    low, high = np.maximum(limits.lower + margin, -2.5), np.minimum(limits.upper - margin, 2.5)
    for _ in range(MOST_DRAWS * count):
        start, goal = rng.uniform(low, high), rng.uniform(low, high)
        least = QUINTIC_PEAK * np.max(np.abs(goal - start) / limits.velocity)
        options |= {"name": f"{robot.name} {len(made)}", "self_collision": self_collision}
        problem = Problem(robot, start, goal, least * rng.uniform(1.3, 1.6), **options)
        try:
            check_feasibility(problem)
            check_ends(problem, goal)
        except ProblemError:
            continue
        made.append(problem)
        if len(made) == count:
            return made
    raise SystemExit(f"{robot.name}: {len(made)} of {count} random moves are possible; the arm is too weak for the others")


def quartiles(values: Sequence[float]) -> dict[str, float] | None:
    """Lower quartile, median, upper quartile; None without values."""
    if not len(values):
        return None
    low, middle, high = np.percentile(np.asarray(values, float), [25, 50, 75])
    return {"lower": float(low), "median": float(middle), "upper": float(high)}


def shown(spread: dict[str, float] | None, form: str = ".3g", factor: float = 1.0) -> str:
    """A spread as ``median (lower – upper)``."""
    if spread is None:
        return "none"
    median, low, high = (format(factor * spread[key], form) for key in ("median", "lower", "upper"))
    return f"{median} ({low} – {high})"


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Columns of text, the first aligned left, the others right."""
    cells = [[str(cell) for cell in row] for row in (head, *rows)]
    width = [max(len(row[k]) for row in cells) for k in range(len(head))]
    forms = [f"{{:{'<' if k == 0 else '>'}{w}}}" for k, w in enumerate(width)]
    lines = ["  " + "  ".join(forms).format(*row).rstrip() for row in cells]
    return "\n".join([lines[0], "  " + "-" * (sum(width) + 2 * len(width) - 2), *lines[1:], ""])
