"""The textbook formulation of `_textbook.py` as a rival."""

from __future__ import annotations

from _rival import Attempt, Rival, timed
from _textbook import VARIANTS, Textbook

import energyopt as eo

CONTROL_POINTS = 24


class Splines(Rival):
    says = (
        f"CasADi as its examples write it: inverse dynamics mapped over the nodes of a cubic spline of {CONTROL_POINTS} points, \
CasADi's derivatives, IPOPT with MUMPS tuned"
    )

    def solve(self, problem):
        space = eo.BSpline(control_points=CONTROL_POINTS).space(problem.duration)
        textbook, build = timed(lambda: Textbook(problem, space, VARIANTS["map_tuned"]))
        solved = textbook.solve()
        return Attempt(textbook.motion, solved.success, solved.iterations, solved.cpu, build)
