"""energyopt against other ways to plan the same motions: same moves, same machine, same run, same evaluator.

Moves are those of all suites (`random_moves`): rest to rest, limits on position, velocity and torque, no self-collision, which
the rivals do not know. Each rival plans on its own terms, from the same guess (the quintic), in a process of its own for each
robot, on one thread, one process after the other; what it gives is judged by `_rivals_judge.py`. Seconds are processor time of
the solver call; compilation, differentiation and building are stated apart. A rival that is not installed is skipped with a note,
one that takes longer than `--most-seconds` on a robot is ended, and what it finished counts.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from _rival import missing
from _rivals_case import RIVALS, rival
from _rivals_text import goals, text, write_page
from _shared import Report, machine, parser, publish, settings

MEASURES = "processor seconds, J and held limits of energyopt and of other ways to plan, on the same random moves"
ONE_START = ("energyopt_coarse", "energyopt", "energyopt_tighter")
OURS = (*ONE_START, "energyopt_default")
NO_RIVAL = ("quintic", *OURS)
QUALITY = 1.005
"""J over the best rival's up to which a motion counts as one of that quality."""
SAME = 1e-5
"""Relative difference of J up to which a motion is the same as in another run."""
FOLDER = Path(__file__).resolve().parent
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}


def main() -> int:
    made = parser("rivals", MEASURES)
    made.add_argument("--robots", nargs="*", default=["panda", "ur5", "xarm7", "baxter"], metavar="NAME")
    made.add_argument("--moves", type=int, default=3, metavar="N", help="random moves a robot")
    made.add_argument("--rivals", nargs="+", choices=RIVALS, default=list(RIVALS), metavar="NAME", help=", ".join(RIVALS))
    made.add_argument("--most-seconds", type=float, default=300.0, metavar="S", help="wall time for one rival on one robot")
    made.add_argument("--docs", type=Path, metavar="FILE", help="write the tables there too, between the markers")
    beside = "add what earlier runs found (--json), the latest first; of times for the same motion the least count"
    made.add_argument("--beside", type=Path, nargs="*", default=[], metavar="FILE", help=beside)
    parsed = made.parse_args()
    results = {name: _robot(name, parsed) for name in parsed.robots}
    notes = [note for found in results.values() for note in found.pop("notes")]
    for path in parsed.beside:
        earlier = json.loads(path.read_text())
        notes += earlier["results"]["notes"]
        for name, found in earlier["results"]["robots"].items():
            found = {"load": earlier["machine"]["load"], **found}
            rivals = _least(found["rivals"], results.get(name, {"rivals": {}})["rivals"])
            results[name] = found | {"rivals": {key: rivals[key] for key in RIVALS if key in rivals}} | compare(rivals)
    done = [f"{key} on {n}: " for n, r in results.items() for key, e in r["rivals"].items() if len(e["moves"]) == r["moves"]]
    notes = [note for note in dict.fromkeys(notes) if not note.startswith(tuple(done))]
    results = {"robots": results, "notes": notes}
    if parsed.docs is not None:
        write_page(parsed.docs, results, machine())
    chosen = {key: value for key, value in settings(parsed).items() if key not in ("docs", "beside")}
    return publish(Report("rivals", MEASURES, chosen, results, text(results), goals(results)), parsed.json)


def _robot(name: str, parsed) -> dict:
    """All rivals on one robot, and what follows."""
    found, notes = {}, []
    for key in parsed.rivals:
        lacking = missing(rival(key))
        if lacking:
            notes.append(f"{key} is skipped: {', '.join(lacking)} not installed (pip install 'energyopt[rivals]')")
            continue
        print(f"  {name}: {key}", file=sys.stderr, flush=True)
        lines, fault = run_case({"rival": key, "robot": name, "moves": parsed.moves, "seed": parsed.seed}, parsed.most_seconds)
        if fault:
            notes.append(f"{key} on {name}: {fault}; {max(len(lines) - 1, 0)} of {parsed.moves} moves done")
        if len(lines) > 1:
            found[key] = {"prepare": lines[0]["prepare"], "moves": lines[1:]}
    return {"rivals": found, "moves": parsed.moves, "notes": notes, "load": machine()["load"], **compare(found)}


def run_case(case: dict, most_seconds: float) -> tuple[list[dict], str]:
    """The lines a case printed, and what went wrong, or ""."""
    command = [sys.executable, str(FOLDER / "_rivals_case.py"), json.dumps(case)]
    path = os.pathsep.join([str(FOLDER.parents[1]), os.environ.get("PYTHONPATH", "")])
    environment, fault = os.environ | ONE_THREAD | {"PYTHONPATH": path}, ""
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=most_seconds, check=False)
        printed = done.stdout
        if done.returncode:
            last = done.stderr.strip().splitlines()[-1:] or [""]
            fault = f"ended with code {done.returncode} ({last[0][:120]})"
    except subprocess.TimeoutExpired as late:
        printed, fault = (late.stdout or b"").decode(), f"ended after {most_seconds:g} s"
    return [json.loads(line) for line in printed.splitlines() if line.startswith("{") and line.endswith("}")], fault


def _least(earlier: dict, later: dict) -> dict:
    """Rivals of two runs. The same motion planned twice counts with the lesser time, as a machine with other users is slow for
    minutes now and then; of different ones the later counts."""
    merged = earlier | later
    for key in earlier.keys() & later.keys():
        by_move = {run["move"]: run for run in earlier[key]["moves"]}
        for run in later[key]["moves"]:
            before = by_move.get(run["move"], run)
            same = abs(before["objective"] - run["objective"]) <= SAME * abs(run["objective"])
            by_move[run["move"]] = before if same and before["seconds"] < run["seconds"] else run
        merged[key] = later[key] | {"moves": list(by_move.values())}
    return merged


def compare(found: dict) -> dict:
    """For each rival its medians; for each of ours the ratio to the fastest rival of the best rival's quality.

    A move counts for the ratio where a rival's motion and ours hold all limits and our J is at most
    `QUALITY` of the best rival's. Under "one start" the fastest accuracy of that quality counts on each move: of the rivals, too,
    the fastest of that quality counts, and some of them run with fewer intervals as well.
    """
    moves = sorted({run["move"] for entry in found.values() for run in entry["moves"]})
    by_move = {m: {key: run for key, entry in found.items() for run in entry["moves"] if run["move"] == m} for m in moves}
    best = {m: min((run["objective"] for run in runs.values() if run["valid"]), default=None) for m, runs in by_move.items()}
    for entry in found.values():
        entry |= _medians(entry["moves"], best)
    ours = [key for key in OURS if key in found]
    one_start = [key for key in ONE_START if key in found]
    against = {"one start": _against(one_start, by_move)} if one_start else {}
    return {"best": best, "against": against | {key: _against([key], by_move) for key in ours}}


def _medians(runs: list[dict], best: dict) -> dict:
    ratio = [run["objective"] / best[run["move"]] for run in runs if best[run["move"]]]
    return {
        "seconds": float(np.median([run["seconds"] for run in runs])),
        "build": float(np.median([run["build"] for run in runs])),
        "objective": float(np.median([run["objective"] for run in runs])),
        "objective_over_best": float(np.median(ratio)) if ratio else None,
        "converged": sum(run["converged"] for run in runs),
        "valid": sum(run["valid"] for run in runs),
        "violation": max(run["violation"] for run in runs),
    }


def _against(keys: list[str], by_move: dict) -> dict:
    """Moves on which one of ours is as good as the best rival, and by how much faster than the fastest rival of that quality."""
    ratios, lower, compared = [], 0, 0
    for runs in by_move.values():
        rivals = [run for name, run in runs.items() if name not in NO_RIVAL and run["valid"]]
        ours = [runs[key] for key in keys if key in runs]
        if not rivals or not ours:
            continue
        compared, enough = compared + 1, QUALITY * min(run["objective"] for run in rivals)
        times = [run["seconds"] for run in ours if run["valid"] and run["objective"] <= enough]
        if times:
            lower += 1
            ratios.append(min(run["seconds"] for run in rivals if run["objective"] <= enough) / min(times))
    return {"compared": compared, "as_good": lower, "ratios": ratios, "ratio": float(np.median(ratios)) if ratios else None}


if __name__ == "__main__":
    sys.exit(main())
