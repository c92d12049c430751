"""A validation report as a table for people and as plain numbers for files."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from energyopt.plans import Violations
    from energyopt.simulation.contacts import Contact
    from energyopt.validation import BaselineComparison, ValidationReport


def report_table(report: ValidationReport) -> str:
    """Verdict, energies, baselines and checks, 60 to 100 characters wide."""
    from energyopt.validation import verdict

    ours, replayed = report.plan_metrics, report.replay_metrics
    lines = [verdict(report), ""]
    lines.append(f"{'':14} {'J':>11} {'Σ∫|τq̇|dt [J]':>14} {'saving J':>10} {'saving E':>10}  limits")
    lines.append(f"{'plan':14} {report.objective:11.5g} {ours.mechanical_abs_J:14.4g}")
    if replayed is not None:
        lines.append(f"{'replay':14} {'':>11} {replayed.mechanical_abs_J:14.4g}   gap {report.energy_gap_percent:+.3f} %")
    lines += [_baseline_line(name, b) for name, b in report.baselines.items()]
    lines += ["", *_joules(report)]
    lines += ["", f"{'check':28} {'value':>11} {'at most':>9}"]
    for check in report.checks:
        mark = "ok" if check.passed else "FAILED"
        lines.append(f"{check.name:28} {check.value:11.3g} {check.threshold:9.3g} {check.unit:12} {mark}".rstrip())
    return "\n".join(lines)


def report_dict(report: ValidationReport) -> dict[str, Any]:
    """Plain numbers; ``energy``, ``baseline``, ``max_violation``, ``replay`` and ``smoothness`` as in the summary file."""
    ours, replayed, tracking = report.plan_metrics, report.replay_metrics, report.tracking
    result: dict[str, Any] = {
        "passed": report.passed,
        "objective": report.objective,
        "cost_terms": dict(report.cost_terms),
        "torque_squared": ours.torque_squared,
        "velocity_squared": ours.velocity_squared,
        "energy": {
            "mechanical_abs_J": ours.mechanical_abs_J,
            "mechanical_positive_J": ours.mechanical_positive_J,
            "energy_error_J": ours.energy_error_J,
            "electrical_J": report.account.electrical_J,
            "account": report.account.as_dict(),
        },
        "metrics": ours.as_dict(),
        "smoothness": _smoothness(ours.as_dict()),
        "max_violation": _violations(report.violations),
        "clearance": _clearance(report.violations),
        "margin_percent": dict(report.violations.margin),
        "inverse_dynamics_error": report.inverse_dynamics_error,
        "baseline": {name: _baseline_dict(b) for name, b in report.baselines.items()},
        "checks": {
            check.name: {"value": check.value, "threshold": check.threshold, "unit": check.unit, "passed": check.passed}
            for check in report.checks
        },
    }
    if replayed is not None and tracking is not None:
        result["replay"] = {
            "tracking_rms_rad": tracking.joint_rms,
            "tracking_max_rad": tracking.joint_max,
            "tool_tracking_rms_m": tracking.tool_rms,
            "tool_tracking_max_m": tracking.tool_max,
            "tool_turn_max_rad": tracking.tool_turn_max,
            "energy_mechanical_abs_J": replayed.mechanical_abs_J,
            "energy_mechanical_positive_J": replayed.mechanical_positive_J,
            "energy_gap_percent": report.energy_gap_percent,
            "energy_electrical_J": report.replay_electrical_J,
            "torque_squared": replayed.torque_squared,
            "saturated_steps": report.saturated_steps,
            "smoothness": _smoothness(replayed.as_dict()),
            "contacts": None if report.touches is None else [_touch(touch) for touch in report.touches],
        }
    return result


def _baseline_line(name: str, b: BaselineComparison) -> str:
    from energyopt.verification import LIMIT_NAMES, excessive

    broken = [n.removesuffix("_percent").replace("_", " ") for n in excessive(b.violations) if n in (*LIMIT_NAMES, "clearance")]
    savings = " ".join(f"{'–' if s is None else f'{s:.2f} %':>10}" for s in (b.saving_percent, b.energy_saving_percent))
    holds = "hold" if b.within_limits else f"broken: {', '.join(broken) or 'it jumps'}"
    return f"{name:14} {b.objective:11.5g} {b.metrics.mechanical_abs_J:14.4g} {savings}  {holds}"


def _joules(report: ValidationReport) -> list[str]:
    """Where the joules go, and what the supply delivers for the baselines."""
    from energyopt.energy.text import cause_lines

    lines = cause_lines(report.account)
    words = []
    for name, b in report.baselines.items():
        if b.account is not None:
            saved = "–" if b.electrical_saving_percent is None else f"{b.electrical_saving_percent:.1f} %"
            words.append(f"{name} {b.account.electrical_J:.4g} J ({saved})")
    return [*lines, f"of the same duration (saved): {', '.join(words)}"] if words else lines


def _baseline_dict(b: BaselineComparison) -> dict[str, Any]:
    return {
        "objective": b.objective,
        "mechanical_abs_J": b.metrics.mechanical_abs_J,
        "mechanical_positive_J": b.metrics.mechanical_positive_J,
        "torque_squared": b.metrics.torque_squared,
        "velocity_squared": b.metrics.velocity_squared,
        "saving_percent": b.saving_percent,
        "energy_saving_percent": b.energy_saving_percent,
        "electrical_J": None if b.account is None else b.account.electrical_J,
        "electrical_saving_percent": b.electrical_saving_percent,
        "account": None if b.account is None else b.account.as_dict(),
        "within_limits": b.within_limits,
        "valid": b.valid,
        "max_violation": _violations(b.violations),
    }


def _violations(violations: Violations) -> dict[str, float | None]:
    """Excess by limit; ``clearance_m`` is None where nothing was looked at."""
    amount = dict(violations.amount)
    clearance = amount.pop("clearance", None)
    return amount | {"clearance_m": clearance}


def _clearance(violations: Violations) -> dict[str, Any] | None:
    """The closest pair over the whole motion; None where nothing was looked at."""
    if violations.distance is None:
        return None
    pair, time = violations.worst.get("clearance", ("", None))
    return {"distance_m": violations.distance, "pair": pair, "time_s": time}


def _touch(touch: Contact) -> dict[str, Any]:
    keys = {"begin": "begin_s", "end": "end_s", "depth": "depth_m", "time": "time_s"}
    return {keys.get(key, key): value for key, value in asdict(touch).items()}


def _smoothness(numbers: dict[str, Any]) -> dict[str, Any]:
    return {key: numbers[key] for key in ("peak_jerk", "rms_jerk", "log_dimensionless_jerk")}
