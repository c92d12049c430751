"""Small problems for the tests of batches: quick moves of an arm of two joints, and ones that go wrong."""

import os
from dataclasses import replace

import numpy as np

import energyopt as eo

SPLINE = eo.BSpline(control_points=10, accuracy=None)


def moves(count, robot=None, seed=3):
    """Random moves, each of its own cost."""
    robot = eo.load_robot("twodof") if robot is None else robot
    rng = np.random.default_rng(seed)
    for k in range(count):
        start, goal = rng.uniform(-1.0, 1.0, (2, robot.nv))
        yield eo.Problem(robot, start, goal, duration=4.0, name=f"move {k}", self_collision=False)


class Deadly:
    """Ends whatever process unpickles it."""

    def __reduce__(self):
        return os._exit, (7,)


class DeadlyOnce:
    """Ends the first process that unpickles it."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        code = f"import os\nif not os.path.exists({str(self.mark)!r}):\n    open({str(self.mark)!r}, 'w')\n    os._exit(7)"
        return exec, (code,)


class Odd(Exception):
    """Can be sent to another process, and not be read there."""

    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def raise_odd():
    raise Odd("this", "that")


class Spoiler:
    """Cannot be unpickled."""

    def __reduce__(self):
        return raise_odd, ()


def spoiled(problem, key, value):
    """A problem one of whose attributes is not what `Problem` would have let through."""
    other = replace(problem)
    object.__setattr__(other, key, value)
    return other


def counting_compiler(folder):
    """A C compiler that notes each call in a file; environment that uses it with an empty cache, and the file."""
    folder.mkdir()
    notes, script = folder / "calls", folder / "counted-cc"
    script.write_text(f'#!/bin/sh\necho "$@" >> {notes}\nexec cc "$@"\n')
    script.chmod(0o755)
    return {"ENERGYOPT_CC": str(script), "ENERGYOPT_CACHE": str(folder / "cache")}, notes
