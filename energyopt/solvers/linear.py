"""Which solver of linear systems IPOPT uses: ours for programs along a time line, else MUMPS.

MUMPS is made for large systems; on those of a spline, some hundred unknowns in a band, it spends most of its time on itself.
`kkt.c` factors them within their profile, at half the time an iteration, and IPOPT loads it through the interface it has
for libraries that users bring along.
"""

from __future__ import annotations

from energyopt.solvers.native import library_path

MOST_UNKNOWNS = 6000
"""Unknowns, slacks and multipliers together, up to which the profile is used."""

MOST_ITERATIONS = 200
"""Iterations our solver is given: where it needs more, the system is too ill-conditioned to go without pivots."""

MUMPS = {
    "linear_solver": "mumps",
    "mumps_pivot_order": 0,
    "mumps_scaling": 0,
    "mumps_permuting_scaling": 0,
    "mumps_mem_percent": 50,
}


def linear_solvers(size: int, rows: int, equalities: int) -> list[dict]:
    """IPOPT options of the linear solvers to try, best first, for a program of ``size`` unknowns.

    Ours exchanges no pivots, which equality rows would need, and gives up early, so MUMPS always stands behind it.
    """
    small = equalities == 0 and size + 2 * rows <= MOST_UNKNOWNS
    library = _profile_library() if small else None
    if library is None:
        return [MUMPS]
    ours = {
        "linear_solver": "ma27",
        "hsllib": library,
        "ma27_la_init_factor": 1.0,
        "ma27_liw_init_factor": 1.0,
        "max_iter": MOST_ITERATIONS,
        "min_refinement_steps": 1,  # the digits that pivoting would have kept
    }
    return [ours, MUMPS]


def _profile_library() -> str | None:
    return library_path("kkt.c")
