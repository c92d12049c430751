"""Robustness and trials as tables for people and plain numbers for files."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from energyopt.robust.evaluation import CaseResult, LimitUse, Robustness
    from energyopt.robust.trials import Trial, Trials

NAMES = {
    "mechanical_abs_J": "Σ∫|τq̇|dt [J]",
    "mechanical_positive_J": "of it driving [J]",
    "electrical_J": "electrical [J]",
    "torque_squared": "∫Στ²dt",
}


def robustness_table(found: Robustness) -> str:
    """Energies of nominal case, corners and draws; then the worst use of every limit."""
    known = [key for key in NAMES if getattr(found.nominal, key) is not None]
    width = max(24, *(len(str(result.case)) for result in found.corners))
    lines = [f"{found.uncertainty}: {len(found.corners)} corners, {len(found.samples)} draws (seed {found.seed})", ""]
    lines.append(f"{'':{width}}" + "".join(f"{NAMES[key]:>19}" for key in known) + f"{'torque':>9}")
    rows = {"as modelled": found.nominal} | {str(result.case): result for result in found.corners}
    for label, result in rows.items():
        values = "".join(f"{getattr(result, key):19.5g}" for key in known)
        lines.append(f"{label:{width}}{values}{result.torque_share.max():8.1f}%")
    if found.samples:
        for label, level in (("draws, median", 50), ("draws, quartiles", (25, 75))):
            cells = [np.percentile([getattr(r, key) for r in found.samples], level) for key in known]
            lines.append(f"{label:{width}}" + "".join(f"{_words(cell):>19}" for cell in cells))
    spreads = [f"{low:.5g} … {high:.5g}" for low, high in (found.spread(key) for key in known)]
    lines.append(f"{'least … largest':{width}}" + "".join(f"{words:>19}" for words in spreads))
    lines += ["", *(_limit_line(name, use) for name, use in found.limits.items())]
    holds = "every limit holds for every arm between these bounds"
    return "\n".join([*lines, holds if found.holds else "NOT every arm between these bounds holds the limits"])


def _words(cell: np.ndarray) -> str:
    return " … ".join(f"{value:.5g}" for value in np.atleast_1d(cell))


def _limit_line(name: str, use: LimitUse) -> str:
    where = "in every case" if use.case is None else str(use.case)
    plain = name.removesuffix("_percent").replace("_", " ")
    mark = "" if use.holds else "  BROKEN"
    return f"{plain:14} {use.share:7.2f} % of the limit: {use.joint} at {use.time:.3f} s, {where}{mark}"


def robustness_dict(found: Robustness) -> dict[str, Any]:
    """Plain numbers for a JSON file."""
    return {
        "uncertainty": {key: list(bounds) for key, bounds in found.uncertainty.ranges.items()},
        "holds": found.holds,
        "joint_names": list(found.joint_names),
        "nominal": _case_dict(found.nominal),
        "corners": [_case_dict(result) for result in found.corners],
        "samples": [_case_dict(result) for result in found.samples],
        "spread": {key: found.spread(key) for key in NAMES},
        "limits": {name: asdict(use) for name, use in found.limits.items()},
        "seed": found.seed,
    }


def _case_dict(result: CaseResult) -> dict[str, Any]:
    numbers = {key: getattr(result, key) for key in NAMES}
    shares = [None if not np.isfinite(share) else share for share in result.torque_share.tolist()]
    return {**asdict(result.case), **numbers, "torque_share_percent": shares}


TRIAL_NAMES = {
    "tracking_rms": ("tracking error, RMS", 1e3, "mrad"),
    "tracking_max": ("tracking error, largest", 1e3, "mrad"),
    "end_error": ("error at the end", 1e3, "mrad"),
    "mechanical_abs_J": ("Σ∫|τq̇|dt", 1.0, "J"),
    "electrical_J": ("electrical energy", 1.0, "J"),
}
"""By quantity: what it is called, factor to the unit shown, unit."""


def trials_table(trials: Trials) -> str:
    """Spread of every quantity, then what went wrong."""
    count, d = len(trials.trials), trials.disturbance
    loop = [f"delay {d.delay} steps"] if d.delay else []
    loop += [f"noise {d.position_noise:g} rad, {d.velocity_noise:g} rad/s"] if d.noisy else []
    what = "; ".join([str(trials.uncertainty), *loop])
    lines = [f"{count} replays in MuJoCo (seed {d.seed}): {what}", ""]
    head = ("undisturbed", "median", "quartiles", "least", "worst")
    lines.append(f"{'':32}{head[0]:>12}{head[1]:>11}{head[2]:>24}{head[3]:>11}{head[4]:>11}")
    for key, (name, factor, unit) in TRIAL_NAMES.items():
        spread, nominal = trials.distribution(key), getattr(trials.nominal, key)
        if spread is None:
            continue
        quartiles = f"{factor * spread.lower_quartile:.4g} … {factor * spread.upper_quartile:.4g}"
        ends = f"{factor * spread.least:11.4g}{factor * spread.largest:11.4g}"
        lines.append(f"{f'{name} [{unit}]':32}{factor * nominal:12.4g}{factor * spread.median:11.4g}{quartiles:>24}{ends}")
    touching = f"{trials.touching} touched something" if not trials.watched.startswith("not") else f"contacts {trials.watched}"
    lines += ["", f"{trials.diverged} diverged; {touching}; {trials.saturated} had a motor at its torque limit"]
    return "\n".join(lines)


def trials_dict(trials: Trials) -> dict[str, Any]:
    """Plain numbers for a JSON file."""
    spreads = {key: trials.distribution(key) for key in TRIAL_NAMES}
    return {
        "trials": [_trial_dict(trial) for trial in trials.trials],
        "nominal": _trial_dict(trials.nominal),
        "distribution": {key: None if spread is None else asdict(spread) for key, spread in spreads.items()},
        "diverged": trials.diverged,
        "touching": trials.touching,
        "saturated": trials.saturated,
        "uncertainty": {key: list(bounds) for key, bounds in trials.uncertainty.ranges.items()},
        "disturbance": asdict(trials.disturbance),
        "watched": trials.watched,
        "steps": trials.steps,
    }


def _trial_dict(trial: Trial) -> dict[str, Any]:
    values = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in asdict(trial).items()}
    return {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in values.items()}
