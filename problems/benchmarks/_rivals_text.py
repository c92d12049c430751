"""The tables of `rivals.py`: as text, as goals, and in the documentation."""

from __future__ import annotations

from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from _rivals_case import rival
from _shared import Goal, table

from energyopt.io.pages import write_block
from energyopt.versions import versions

BEGIN, END = "<!-- rivals: begin (written by problems/benchmarks/rivals.py --docs) -->", "<!-- rivals: end -->"
FASTER = 15.0
JUDGED = ("one start", "energyopt_default")
DIFFERENT = 1.05
"""J over the lowest from which two motions of one move are held to be different optima."""
HEAD = ("", "solve [s]", "before [s]", "once [s]", "J", "J / best", "converged", "held", "worst violation")


def text(results: dict) -> str:
    parts = []
    for name, found in results["robots"].items():
        parts.append(table((f"{name}, {found['moves']} moves", *HEAD[1:]), _rows(found)))
        parts.append(f"  {_verdict(found)}\n\n")
    parts += [f"  {name}: {rival(name).says}\n" for name in _names(results)]
    head, rows = _optima(results)
    parts += ["\n", table(head, rows)] if rows else []
    return "".join([*parts, *(f"  {note}\n" for note in results["notes"])])


def goals(results: dict) -> list[Goal]:
    """As good as the best rival, from one start or by default, and from one start so much faster than the fastest rival of that
    quality, on every robot; a robot that cannot be compared has none."""
    made = []
    for name, found in results["robots"].items():
        for key, against in found["against"].items():
            if against["compared"] and key in JUDGED:
                share = 100.0 * against["as_good"] / against["compared"]
                made.append(Goal(f"{name}: moves on which {key} is as good as the best rival", share, 100.0, "%", least=True))
            if against["ratio"] is not None and key == JUDGED[0]:
                what = f"{name}: times less than the fastest rival of that quality, {key}"
                made.append(Goal(what, against["ratio"], FASTER, "×", least=True))
    return made


def write_page(path: Path, results: dict, host: dict[str, Any]) -> None:
    """The tables into a Markdown page."""
    write_block(path, (BEGIN, END), _markdown(results, host))


def _markdown(results: dict, host: dict[str, Any]) -> str:
    used = ", ".join(f"{name} {version}" for name, version in (versions() | _rival_versions()).items())
    parts = [f"{host['cpu']}, {host['cores']} cores, on which other programs ran too; {used}.\n"]
    for name, found in results["robots"].items():
        parts.append(
            _pipes((f"{name}, {found['moves']} moves", *HEAD[1:]), _rows(found))
            + f"\nAt a load of {found['load']:.1f}. {_verdict(found)}\n"
        )
    parts.append("".join(f"- `{name}`: {rival(name).says}\n" for name in _names(results)))
    head, rows = _optima(results)
    if rows:
        share = f"{100 * (DIFFERENT - 1):.0f} %"
        parts.append(f"Moves on which J differs by {share} or more: other optima, or coarser motions (in brackets: not held):\n")
        parts.append(_pipes(head, rows))
    parts += ["".join(f"- {note}\n" for note in results["notes"])] if results["notes"] else []
    parts.append(_statement(results))
    return "\n".join(parts)


def _rival_versions() -> dict[str, str]:
    """Of the rivals that are installed."""
    found = {}
    for name in ("crocoddyl", "mim-solvers", "drake"):
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def _statement(results: dict) -> str:
    found = goals(results)
    missed = [str(goal) for goal in found if not goal.met]
    listed = "\n".join(f"- {line}" for line in missed)
    aim = f"The goal, {FASTER:g} times less on every robot at a J at most 0.5 % above the best rival's,"
    return f"{aim} " + ("is met.\n" if found and not missed else f"is NOT met:\n\n{listed or '- nothing was compared'}\n")


def _rows(found: dict) -> list[tuple]:
    rows = []
    for name, entry in found["rivals"].items():
        count, ratio = len(entry["moves"]), entry["objective_over_best"]
        seconds = f"{entry['seconds']:.3f}", f"{entry['build']:.2f}", f"{entry['prepare']:.1f}"
        quality = f"{entry['objective']:.1f}", "–" if ratio is None else f"{ratio:.3f}"
        shares = f"{entry['converged']} of {count}", f"{entry['valid']} of {count}"
        rows.append((name, *seconds, *quality, *shares, f"{100 * entry['violation']:.2g} %"))
    return rows


def _verdict(found: dict) -> str:
    """How ours compare; of the several accuracies from one start, the fastest of the best rival's quality on each move."""
    against = dict(found["against"])
    if "one start" not in against:
        return ""
    one, default = against.pop("one start"), against.pop("energyopt_default", None)
    singly = "; ".join(f"`{key}` alone: {_counts(other)}" for key, other in against.items())
    counts = _counts(one, " that the fastest rival of that quality takes")
    said = f"As good as the best rival, or better: from one start on {counts} ({singly})"
    return f"{said}." if default is None else f"{said}; by default, with many guesses, on {_counts(default)}."


def _counts(against: dict, words: str = "") -> str:
    moves, ratio = f"{against['as_good']} of {against['compared']} moves", against["ratio"]
    if ratio is None:
        return moves
    share = f"1/{ratio:.1f} of" if ratio > 1 else f"{1 / ratio:.1f} times"
    return f"{moves}, in {share} the processor time{words}"


def _optima(results: dict) -> tuple[tuple, list[tuple]]:
    """Head and rows of J by rival on the moves where those that hold the limits differ."""
    names, rows = [name for name in _names(results) if name != "quintic"], []
    for found in results["robots"].values():
        for move in found["best"]:
            runs = {name: run for name, entry in found["rivals"].items() for run in entry["moves"] if run["move"] == move}
            values = [run["objective"] for name, run in runs.items() if run["valid"] and name != "quintic"]
            if len(values) > 1 and max(values) > DIFFERENT * min(values):
                rows.append((move, *(_shown(runs.get(name)) for name in names)))
    return ("J of", *names), rows


def _shown(run: dict | None) -> str:
    """J, in brackets where limits are broken."""
    if run is None:
        return "–"
    return f"{run['objective']:.1f}" if run["valid"] else f"({run['objective']:.1f})"


def _names(results: dict) -> list[str]:
    """All that ran anywhere, in order."""
    return list(dict.fromkeys(name for found in results["robots"].values() for name in found["rivals"]))


def _pipes(head: tuple, rows: list[tuple]) -> str:
    lines = [head, ("---", *["--:"] * (len(head) - 1)), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)
