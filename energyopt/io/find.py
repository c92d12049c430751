"""Where the catalogue problems are: beside the package in a checkout, inside it once installed from a wheel."""

from __future__ import annotations

import difflib
from pathlib import Path

from energyopt.errors import FileError
from energyopt.robots.messages import shown

_PACKAGE = Path(__file__).resolve().parents[1]


def problems_folder() -> Path:
    """The folder with the catalogue problems and, in ``benchmarks``, the scripts that measure.

    Raises:
        FileError: neither place exists (a broken installation).
    """
    for folder in (_PACKAGE / "_problems", _PACKAGE.parent / "problems"):
        if (folder / "panda_reach.toml").is_file():
            return folder
    raise FileError(f"{_PACKAGE}: the catalogue problems are missing; install energyopt again")


def catalogue_problems() -> tuple[str, ...]:
    """Names of the catalogue problems, sorted."""
    return tuple(sorted(path.stem for path in problems_folder().glob("*.toml")))


def find_problem(path_or_name: str | Path) -> Path:
    """The file of a problem given by its path, or by the bare name of a catalogue problem.

    Raises:
        FileError: there is none; the message lists the nearest names.
    """
    if not isinstance(path_or_name, (str, Path)):
        raise FileError(f"load_problem: got {shown(path_or_name)}; expected the path of a TOML file, or a catalogue name")
    given = str(path_or_name)
    path = Path(given).expanduser() if given.startswith("~/") else Path(given)
    try:
        exists = path.exists()
    except (OSError, ValueError) as error:
        raise FileError(f"{given!r:.100}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    bare = given and path.name == given and path.suffix in ("", ".toml")
    if bare and not (exists and path.is_file()):
        known = problems_folder() / f"{path.stem}.toml"
        if path.stem in catalogue_problems():
            return known
    if exists and given:
        return path
    raise FileError(f"{given[:200] or 'an empty name'}: no such problem file; {_hint(path)}")


def _hint(path: Path) -> str:
    names = catalogue_problems()
    near = difflib.get_close_matches(path.stem.lower(), names, n=3, cutoff=0.5)
    folder = path.parent
    if folder.is_dir():
        near += difflib.get_close_matches(path.name, [p.name for p in folder.glob("*.toml")], n=3, cutoff=0.6)
    return f"did you mean {' or '.join(dict.fromkeys(near))}?" if near else f"catalogue problems: {', '.join(names)}"
