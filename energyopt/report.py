"""`write_report`: one HTML page that says what was asked, what was found, and how far it can be trusted.

The page needs nothing beside itself: style and figures are inside, no script, no address. Every text from a problem, robot
or file is escaped.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from energyopt.io import write_atomic
from energyopt.optima import described
from energyopt.plans import Plan, Status, Violations
from energyopt.plots.svg import inline_svg
from energyopt.plotting import plot_joints, plot_metrics
from energyopt.report_energy import energy_sections
from energyopt.report_parts import Cell, Markup, definitions, escape, numbers, percent, plain_name, section, table
from energyopt.report_problem import problem_sections
from energyopt.report_scene import scene_sections
from energyopt.sampling import polynomial_pieces
from energyopt.validation import verdict
from energyopt.verification import LIMIT_NAMES, RELATIVE_TOLERANCES, TOLERANCES, UNITS, excessive
from energyopt.versions import versions

if TYPE_CHECKING:
    from energyopt.simulation.log import ReplayLog
    from energyopt.validation import BaselineComparison, ValidationReport

MOST_TOUCHES = 12
"""Contacts listed one by one."""
REFERENCE = "quintic"
"""The baseline of the headline: the minimum-jerk motion of the same duration."""


def write_report(plan: Plan, log: ReplayLog | None, report: ValidationReport, path: str | Path) -> None:
    """Write the page of a plan; it appears whole or not at all.

    Args:
        plan: the motion.
        log: its replay; None where there is none.
        report: from `energyopt.validate` of the two.
        path: of the HTML file.

    Raises:
        FileError: the file cannot be written.
    """
    write_atomic(path, report_page(plan, log, report).encode())


def report_page(plan: Plan, log: ReplayLog | None, report: ValidationReport) -> str:
    """The page as text."""
    name = plan.problem.name or "A motion"
    parts = [
        _header(plan, report, name),
        _headline(report),
        _baselines(plan, report),
        _figure("How it moves", plot_metrics(plan, log), "over-time", "Power, acceleration, energy and velocity over time."),
        *energy_sections(plan, report),
        *scene_sections(plan, log),
        _limits(plan, report),
        _figure("Joints against their limits", plot_joints(plan, log), "joints", "Position, velocity and torque of every joint."),
        _checks(report),
        _replay(log, report),
        *problem_sections(plan.problem),
        _method(plan),
        _notes(plan, report),
        Markup(f"<footer>{escape(', '.join(f'{key} {value}' for key, value in versions().items()))}</footer>"),
    ]
    style = (files("energyopt") / "report.css").read_text(encoding="utf-8")
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(name)} – energyopt</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(parts)
        + "\n</main>\n</body>\n</html>\n"
    )


def _header(plan: Plan, report: ValidationReport, name: str) -> str:
    robot = plan.problem.robot
    good = plan.solved and report.passed
    passed = sum(check.passed for check in report.checks)
    sentence = verdict(report) if plan.solved else plan.message
    return (
        f"<header>\n<h1>{escape(name)}</h1>\n"
        f"<p>{escape(robot.name)}, {robot.nv} joint{'s' if robot.nv > 1 else ''}, {plan.duration:g} s</p>\n"
        f'<div class="verdict {"good" if good else "bad"}"><b>{escape(plan.status.value)}</b>'
        f"<span>{escape(sentence)}; {passed} of {len(report.checks)} checks passed.</span></div>\n</header>"
    )


def _headline(report: ValidationReport) -> str:
    ours, other = report.plan_metrics, report.baselines[REFERENCE]
    held = "" if other.within_limits else ", which breaks its limits"
    tight = min(report.violations.margin, key=report.violations.margin.get, default="")
    joint, time = report.violations.worst.get(tight, ("", 0.0))
    boxes = [
        (
            "Objective J",
            f"{report.objective:.5g}",
            f"{_more_or_less(other.saving_percent)} the quintic of the same duration{held}",
        ),
        (
            "Mechanical energy Σ∫|τq̇|dt",
            f"{ours.mechanical_abs_J:.4g} J",
            f"{_more_or_less(other.energy_saving_percent)} the quintic; it is reported, not minimised",
        ),
        (
            "Least margin",
            _margin(report.violations.margin[tight]) if tight else "–",
            f"{plain_name(tight)} of {joint} at {time:.2f} s" if tight else "no joint has a finite limit",
        ),
        _replay_box(report),
    ]
    return numbers(boxes)


def _replay_box(report: ValidationReport) -> tuple[str, str, str]:
    if report.tracking is None or report.energy_gap_percent is None:
        return "Replay in MuJoCo", "–", "there is no replay"
    gap = f"largest joint error; energy {report.energy_gap_percent:+.2g} % against the plan"
    return "Replay in MuJoCo", f"{report.tracking.joint_max:.2g} rad", gap


def _more_or_less(saving: float | None) -> str:
    if saving is None:
        return "not comparable with"
    return f"{saving:.1f} % below" if saving >= 0 else f"{-saving:.1f} % above"


def _checks(report: ValidationReport) -> str:
    rows = [
        [check.name, Cell(f"{check.value:.3g}", "n"), Cell(f"{check.threshold:g}", "n"), check.unit, _ok(check.passed)]
        for check in report.checks
    ]
    text = "Recomputed from the motion itself, not taken from the solver."
    return section("Checks", table(["Check", "Value|n", "At most|n", "Unit", ""], rows), text)


def _ok(passed: bool) -> Cell:
    return Cell("passed", "good") if passed else Cell("FAILED", "bad")


def _limits(plan: Plan, report: ValidationReport) -> str:
    violations, broken, rows = report.violations, excessive(report.violations), []
    for name, amount in violations.amount.items():
        joint, time = violations.worst.get(name, ("", 0.0))
        margin = _least_distance(violations) if name == "clearance" else _margin_words(violations.margin.get(name))
        allowed = (
            f"{RELATIVE_TOLERANCES[name]:g} % of limit" if name in RELATIVE_TOLERANCES else f"{TOLERANCES[name]:g} {_unit(name)}"
        )
        rows.append([
            plain_name(name), Cell(margin, "n"), joint or "–", Cell(f"{time:.3f} s", "n"),
            Cell(f"{amount:.2g} {_unit(name)}", "n"), Cell(allowed, "n"), _where(plan, name), _ok(name not in broken),
        ])  # fmt: skip
    head = ["Limit or condition", "Least margin|n", "Where", "When|n", "Excess|n", "Allowed|n", "Holds", ""]
    text = (
        "Margins are in per cent of the limit; of a position, in per cent of half its range; of the clearance, the distance of "
        "the closest pair. Limits that are not set have no row."
    )
    return section("Limits and conditions", table(head, rows), text)


def _margin_words(margin: float | None) -> str:
    return "–" if margin is None else _margin(margin)


def _least_distance(violations: Violations) -> str:
    """Of the closest pair, over the whole motion."""
    return f"{1e3 * violations.distance:.1f} mm".replace("-", "−")


def _margin(margin: float) -> str:
    return "< 0.01 %" if 0 <= margin < 0.01 else f"{margin:.2f} %".replace("-", "−")


def _unit(name: str) -> str:
    return "%" if name == "torque_percent" else UNITS[name].split(" (")[0]


def _where(plan: Plan, name: str) -> str:
    if name in ("torque_percent", "torque_rate"):
        return "at dense samples"
    if name == "clearance":
        return "for all t"
    if name not in LIMIT_NAMES:
        return "at its times"
    return "for all t" if polynomial_pieces(plan.trajectory) is not None else "at dense samples and the extrema between"


def _baselines(plan: Plan, report: ValidationReport) -> str:
    ours, replayed = report.plan_metrics, report.replay_metrics
    rows = [["this plan", Cell(f"{report.objective:.5g}", "n"), "", Cell(f"{ours.mechanical_abs_J:.4g}", "n"), "", "", ""]]
    rows[0][-1] = _ok(plan.solved)
    rows[0][-2] = Cell(f"{ours.peak_speed:.3g}", "n")
    rows += [_baseline_row(name, other) for name, other in report.baselines.items()]
    if replayed is not None:
        rows.append(
            ["its replay", "", "", Cell(f"{replayed.mechanical_abs_J:.4g}", "n"), "", Cell(f"{replayed.peak_speed:.3g}", "n"), ""]
        )
    head = ["Motion", "J|n", "J saved|n", "Energy [J]|n", "Energy saved|n", "Peak ‖q̇‖ [rad/s]|n", "Limits"]
    text = (
        "Ordinary motions between the same ends in the same time. J is what the plan minimises; the mechanical energy Σ∫|τq̇|dt "
        "is a different quantity and may go either way. A saving against a motion that breaks the limits compares with "
        "something the arm cannot do."
    )
    return section("Against ordinary motions of the same duration", table(head, rows), text)


def _baseline_row(name: str, other: BaselineComparison) -> list:
    broken = [plain_name(entry) for entry in excessive(other.violations) if entry in (*LIMIT_NAMES, "clearance")]
    holds = Cell("held", "good") if other.within_limits else Cell(f"broken: {', '.join(broken) or 'it jumps'}", "bad")
    savings = [Cell(percent(value), "n") for value in (other.saving_percent, other.energy_saving_percent)]
    energy, speed = Cell(f"{other.metrics.mechanical_abs_J:.4g}", "n"), Cell(f"{other.metrics.peak_speed:.3g}", "n")
    return [name, Cell(f"{other.objective:.5g}", "n"), savings[0], energy, savings[1], speed, holds]


def _figure(title: str, figure, name: str, description: str) -> str:
    return section(title, Markup(inline_svg(figure, name, description)))


def _replay(log: ReplayLog | None, report: ValidationReport) -> str:
    tracking = report.tracking
    if log is None or tracking is None:
        return section("Replay in MuJoCo", "", "There is no replay: nothing here has been simulated.")
    settings = [f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in log.settings.items()]
    facts = {
        "Joint error": f"{tracking.joint_rms:.3g} rad RMS, {tracking.joint_max:.3g} rad largest",
        "Tool error": f"{1e3 * tracking.tool_rms:.3g} mm RMS, {1e3 * tracking.tool_max:.3g} mm largest",
        "Tool turned": f"{tracking.tool_turn_max:.3g} rad largest",
        "Energy gap": f"{report.energy_gap_percent:+.3g} % of Σ∫|τq̇|dt",
        "Motors at their limit": f"{log.saturated_steps} of {len(log.t)} steps",
        "Contacts": _contacts(log),
        "Physics step": f"{1e3 * log.physics_step:.3g} ms",
        "Settings": ", ".join(settings),
        "Time to simulate": f"{log.wall_s:.3g} s",
    }
    text = (
        "The planned torque as feed-forward, corrected for where the arm is, plus feedback scaled by the mass matrix, "
        "cut at the torque limits."
    )
    return section("Replay in MuJoCo", definitions(facts), text)


def _contacts(log: ReplayLog) -> str:
    if log.contacts is None:
        return "not looked for"
    shown = "; ".join(str(touch) for touch in log.touches[:MOST_TOUCHES])
    more = f"; and {len(log.touches) - MOST_TOUCHES} more" if len(log.touches) > MOST_TOUCHES else ""
    return f"{shown}{more}" or "none"


def _method(plan: Plan) -> str:
    error = plan.discretization_error
    facts = {
        "Outcome": plan.message,
        "Distance to the optimum near this motion": "not estimated" if error is None else f"{100 * error:.2g} % of J (estimate)",
        "Iterations": str(plan.iterations),
        "Time": ", ".join(f"{name} {seconds:.3g} s" for name, seconds in plan.time_s.items()),
        "Seed": str(plan.seed),
        **({"Optima": described(plan.optima)} if plan.optima else {}),
        "Options": ", ".join(f"{key} = {value}" for key, value in plan.options.items()),
    }
    return section("How it was found", definitions(facts))


def _notes(plan: Plan, report: ValidationReport) -> str:
    notes = [*plan.notes]
    notes.append("The motion is a local optimum; further guesses (option starts) may lead to a lower one.")
    notes.append("Friction, armature and payload count only as far as the problem states them.")
    if report.violations.distance is None:
        notes.append("Nothing was asked to keep clear of, or no collision geometry was found: clearance is not judged.")
    if plan.status is not Status.SOLVED:
        notes.insert(0, f"This motion is not a solution: {plan.message}.")
    if any(not other.within_limits for other in report.baselines.values()):
        notes.append("Some baselines break limits that the plan holds: see the table before quoting a saving.")
    items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return section("Notes and limitations", Markup(f"<ul>{items}</ul>"))
