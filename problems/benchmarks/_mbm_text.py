"""What `mbm` found, summed up: by robot and scene and over all, as a table, a list of failures, and figures to reach."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from _shared import CLOCKS, Goal, table

TOTAL = "all"


def summary(records: Sequence[dict]) -> dict[str, Any]:
    """Figures of each group and of all; those of motions are over the plans that are solved and valid."""
    groups = {name: [r for r in records if r["group"] == name] for name in dict.fromkeys(r["group"] for r in records)}
    if len(groups) != 1:
        groups[TOTAL] = list(records)
    return {
        "groups": {name: _figures(members) for name, members in groups.items()},
        "total": _figures(records),
        "preparation_s": max((r["preparation_s"] for r in records), default=0.0),
    }


def _figures(records: Sequence[dict]) -> dict[str, Any]:
    possible = [r for r in records if not r["ends"]]
    valid = [r for r in possible if r["valid"]]
    timed = [r for r in possible if r["seconds"]]
    times = lambda what, clock: [r["seconds"][what][clock] for r in timed]
    return {
        "problems": len(records),
        "valid_ends": len(possible),
        "solved": sum(r["status"] == "SOLVED" for r in possible),
        "solved_and_valid": len(valid),
        "percent_solved_and_valid": 100.0 * len(valid) / len(possible) if possible else None,
        "false_successes": sum(r["false_success"] for r in records),
        "seconds": {what: {clock: _spread(times(what, clock)) for clock in CLOCKS} for what in ("plan", "all")},
        "torque_squared": _median([r["judged"]["torque_squared"] for r in valid]),
        "energy": _median([r["judged"]["energy"] for r in valid]),
        "saving_percent": {
            key: _median([100.0 * r["saving"][key] for r in valid if r["saving"][key] is not None])
            for key in ("torque_squared", "energy")
        },
        "least_clearance": min((r["judged"]["clearance"] for r in valid if r["judged"]["clearance"] is not None), default=None),
        "valid_baselines": sum(not r["baseline"]["faults"] for r in possible if "baseline" in r),
    }


def text(results: dict[str, Any]) -> str:
    """The tables to print."""
    groups = results["groups"].items()
    head = ("problems", "valid ends", "solved", "and valid", "false", "plan [s]", "processor", "with path", "processor")
    lines = [table(head, [_outcome(name, figures) for name, figures in groups])]
    lines.append("  times: median / 95th percentile of one call of plan by wall and processor clock, and with the search of the")
    lines.append("  path that gives the duration; once a process and robot, not counted, at most")
    lines[-1] += f" {results['preparation_s']:.1f} s to load or compile\n"
    head = ("motions, medians", "∫τ² [N²m²s]", "saved", "Σ∫|τq̇| [J]", "saved", "least clearance", "baselines valid")
    lines.append(table(head, [_motions(name, figures) for name, figures in groups]))
    lines.append("  over those solved and valid; saved against the path that gives the duration, timed at that duration")
    failed = [r for r in results["problems"] if not r["valid"]]
    lines += ["", f"  {len(failed)} not solved and valid:"] if failed else []
    lines += [f"    {r['id']}: {r['status']}{' (FALSE SUCCESS)' if r['false_success'] else ''}: {r['why']}" for r in failed]
    return "\n".join(lines) + "\n"


def _outcome(name: str, figures: dict[str, Any]) -> tuple:
    times, percent = figures["seconds"], _shown(figures["percent_solved_and_valid"], ".0f", " %")
    spread = lambda found: "none" if found is None else f"{found['median']:.2f} / {found['p95']:.2f}"
    return (
        f"{name}: {figures['problems']}",
        figures["valid_ends"],
        figures["solved"],
        f"{figures['solved_and_valid']} ({percent})",
        figures["false_successes"],
        *(spread(times[what][clock]) for what in ("plan", "all") for clock in CLOCKS),
    )


def _motions(name: str, figures: dict[str, Any]) -> tuple:
    saving, least = figures["saving_percent"], figures["least_clearance"]
    return (
        name,
        _shown(figures["torque_squared"], ".0f"),
        _shown(saving["torque_squared"], ".0f", " %"),
        _shown(figures["energy"], ".1f"),
        _shown(saving["energy"], ".0f", " %"),
        _shown(None if least is None else 1e3 * least, ".2f", " mm"),
        f"{figures['valid_baselines']}/{figures['valid_ends']}",
    )


def _shown(value: float | None, form: str, unit: str = "") -> str:
    return "none" if value is None else format(value, form) + unit


def goals(results: dict[str, Any]) -> list[Goal]:
    """Figures to reach; those that nothing was measured for are left out."""
    figures = results["total"]
    made = [Goal("false successes", figures["false_successes"], 0.0, "")]
    if figures["valid_ends"]:
        made.append(
            Goal("solved and valid, of those with valid ends", figures["percent_solved_and_valid"], 97.0, "%", least=True)
        )
    for clock in CLOCKS:
        if (times := figures["seconds"]["plan"][clock]) is not None:
            made.append(Goal(f"plan, median {clock} time", times["median"], 1.0, "s"))
            made.append(Goal(f"plan, 95th percentile of {clock} time", times["p95"], 10.0, "s"))
    if (saved := figures["saving_percent"]["torque_squared"]) is not None:
        made.append(Goal("median saving in ∫τ² against the path timed at the same duration", saved, 60.0, "%", least=True))
    return made


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not len(values):
        return None
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95)), "most": float(max(values))}


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None
