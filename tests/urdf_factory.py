"""URDF text of small robots whose dynamics are known in closed form.

    from urdf_factory import pendulum, planar_arm, sliders, write

`chain` is the general one; the others name the textbook cases. Every link is a rod of the given length along x with
its mass at `centers` (default: the middle) and the rod's inertia about it, unless inertias are given.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

LIMITS = {"lower": -6.0, "upper": 6.0, "velocity": 20.0, "effort": 500.0}


def planar_arm(
    lengths: Sequence[float],
    masses: Sequence[float],
    *,
    centers: Sequence[float] | None = None,
    inertias: Sequence[float] | None = None,
    axis: Sequence[float] = (0, -1, 0),
    **limits: float,
) -> str:
    """A planar chain of revolute joints; link i reaches from its joint along its own x axis.

    With the default axis (0, -1, 0) the motion is in the vertical x–z plane and positive angles lift the arm, so the
    angles are those of the textbook arm with x forward and z up; with axis (0, 0, 1) it is horizontal.

    Args:
        lengths: of the links [m]; masses: [kg]; centers: distance of the centre of mass from the joint [m].
        inertias: about the axis through the centre of mass [kg·m²]; a thin rod's m·l²/12 by default.
        axis: of every joint, in the y–z plane (links are thin along x).
        limits: lower, upper [rad], velocity [rad/s], effort [N·m], the same for all joints.
    """
    n = len(lengths)
    centers = [0.5 * length for length in lengths] if centers is None else centers
    inertias = [m * length**2 / 12 for m, length in zip(masses, lengths, strict=True)] if inertias is None else inertias
    return chain(
        axes=[axis] * n,
        origins=[(0, 0, 0), *((length, 0, 0) for length in lengths[:-1])],
        masses=masses,
        centers=[(c, 0, 0) for c in centers],
        inertias=[np.diag([0.0, i, i]) for i in inertias],
        tool=(lengths[-1], 0, 0),
        name="planar_arm",
        **limits,
    )


def pendulum(mass: float = 1.0, length: float = 1.0, inertia: float = 0.0, **limits: float) -> str:
    """A mass at the end of a massless rod: τ = (m l² + I) q̈ + m g l cos q, with q = 0 horizontal and q > 0 above it."""
    return planar_arm([length], [mass], centers=[length], inertias=[inertia], **limits)


def sliders(n: int = 1, masses: Sequence[float] | None = None, **limits: float) -> str:
    """n decoupled prismatic joints, each moving its own body of unit mass along x: τ = m q̈ with any gravity along z.

    The bodies hang side by side on one base, so the tree is branched; for n = 1 it is the double integrator.
    """
    return chain(
        axes=[(1, 0, 0)] * n,
        origins=[(0, i, 0) for i in range(n)],
        masses=[1.0] * n if masses is None else masses,
        centers=[(0, 0, 0)] * n,
        inertias=[0.01 * np.eye(3)] * n,
        types=["prismatic"] * n,
        parents=["base"] * n,
        name="sliders",
        **limits,
    )


def chain(
    *,
    axes: Sequence[Sequence[float]],
    origins: Sequence[Sequence[float]],
    masses: Sequence[float],
    centers: Sequence[Sequence[float]],
    inertias: Sequence[np.ndarray],
    types: Sequence[str] | None = None,
    parents: Sequence[str] | None = None,
    rpys: Sequence[Sequence[float]] | None = None,
    tool: Sequence[float] = (0, 0, 0),
    name: str = "chain",
    **limits: float,
) -> str:
    """Joints ``joint1…`` and links ``base, link1…``, plus a massless link ``tool`` fixed to the last one.

    Args:
        axes, origins [m], rpys [rad]: of the joints; masses [kg], centers [m], inertias [kg·m², 3×3]: of the links.
        types: of the joints, "revolute" by default; parents: names of parent links, the previous link by default.
    """
    n = len(axes)
    types = ["revolute"] * n if types is None else types
    parents = ["base", *(f"link{i}" for i in range(1, n))] if parents is None else parents
    rpys = [(0, 0, 0)] * n if rpys is None else rpys
    parts = [f'<robot name="{name}">', '<link name="base"/>']
    for i in range(n):
        parts.append(link(f"link{i + 1}", masses[i], centers[i], inertias[i]))
        parts.append(joint(f"joint{i + 1}", types[i], parents[i], f"link{i + 1}", origins[i], axes[i], rpys[i], **limits))
    parts += ['<link name="tool"/>', joint("tool_joint", "fixed", f"link{n}", "tool", tool), "</robot>"]
    return "\n".join(parts)


def link(name: str, mass: float, center: Sequence[float] = (0, 0, 0), inertia: np.ndarray | None = None) -> str:
    """A link with an inertial; the inertia is a sphere's of radius 0.1 m by default."""
    matrix = 0.004 * mass * np.eye(3) if inertia is None else np.asarray(inertia, dtype=float)
    entries = " ".join(f'i{"xyz"[r]}{"xyz"[c]}="{float(matrix[r, c])!r}"' for r in range(3) for c in range(r, 3))
    return (
        f'<link name="{name}"><inertial><origin xyz="{_words(center)}" rpy="0 0 0"/>'
        f'<mass value="{float(mass)!r}"/><inertia {entries}/></inertial></link>'
    )


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    origin: Sequence[float] = (0, 0, 0),
    axis: Sequence[float] = (0, 0, 1),
    rpy: Sequence[float] = (0, 0, 0),
    extra: str = "",
    **limits: float,
) -> str:
    """A joint; ``limits`` override lower, upper, velocity, effort; ``extra`` is XML put inside."""
    text = f'<joint name="{name}" type="{kind}"><origin xyz="{_words(origin)}" rpy="{_words(rpy)}"/>'
    text += f'<parent link="{parent}"/><child link="{child}"/>'
    if kind != "fixed":
        stated = " ".join(f'{key}="{float(value)!r}"' for key, value in {**LIMITS, **limits}.items())
        text += f'<axis xyz="{_words(axis)}"/><limit {stated}/>'
    return text + extra + "</joint>"


def write(folder: Path, text: str, name: str = "robot.urdf") -> Path:
    """Save a URDF in a folder (such as pytest's ``tmp_path``) and return its path."""
    path = Path(folder) / name
    path.write_text(text, encoding="utf-8")
    return path


def _words(values: Sequence[float]) -> str:
    return " ".join(repr(float(x)) for x in values)
