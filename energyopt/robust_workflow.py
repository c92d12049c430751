"""From a saved plan to what is known of its robustness: cases, replays, and the files of both. What `energyopt robust` does.

The folder receives robustness.json and robustness.png.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from energyopt.io import write_atomic
from energyopt.plans import Plan
from energyopt.readable import Readable
from energyopt.robust import Robustness, Trials, replay_trials, robustness
from energyopt.stopping import whole_files
from energyopt.workflow import plain, prepare_folder

FILES = ("robustness.json", "robustness.png")


@dataclass(frozen=True, eq=False, repr=False)
class Findings(Readable):
    """What a run gave: cases, replays (None where none were asked for), and the files written."""

    cases: Robustness
    trials: Trials | None
    files: tuple[Path, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether every corner holds the limits, and no replay diverged or touched anything."""
        troubled = self.trials is not None and (self.trials.diverged or self.trials.touching)
        return self.cases.holds and not troubled

    def in_brief(self) -> str:
        return self.cases.in_brief()

    def __str__(self) -> str:
        tables = [str(self.cases)] + ([] if self.trials is None else [str(self.trials)])
        return "\n\n".join(tables + ([f"files: {', '.join(map(str, self.files))}"] if self.files else []))


def run(
    plan: Plan, bounds: Mapping[str, Any], samples: int, trials: int, seed: int, replay: Mapping[str, Any], out: Path | None
) -> Findings:
    """Evaluate cases, replay, and write.

    Args:
        plan: the motion. bounds: payload, masses, friction. samples: draws of cases. trials: replays; 0 leaves them out.
        seed: of both. replay: further options of `replay_trials`. out: folder for the files; None writes nothing.

    Raises:
        InputError: a bound or option makes no sense. FileError: the folder cannot be used.
    """
    if out is not None:
        prepare_folder(out, FILES)
    cases = robustness(plan, **bounds, samples=samples, seed=seed)
    replays = replay_trials(plan, **bounds, trials=trials, seed=seed, **replay) if trials else None
    return Findings(cases, replays, () if out is None else _write(plan, cases, replays, out))


def _write(plan: Plan, cases: Robustness, trials: Trials | None, out: Path) -> tuple[Path, ...]:
    from energyopt.plotting import plot_robustness

    content = {"name": plan.problem.name, "robot": plan.problem.robot.name, "cases": cases.as_dict()}
    content["replays"] = None if trials is None else trials.as_dict()
    image = io.BytesIO()
    plot_robustness(plan, cases, trials).savefig(image, format="png", dpi=150)
    text = json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False)
    paths = tuple(out / name for name in FILES)
    with whole_files():
        for path, data in zip(paths, ((text + "\n").encode(), image.getvalue()), strict=True):
            write_atomic(path, data)
    return paths
