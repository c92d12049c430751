"""Workspace: a region that an arm, or some of its frames, may not leave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from energyopt.errors import GeometryError
from energyopt.geometry.shapes import Box, HalfSpace
from energyopt.geometry.shapes.half_space import workspace_walls
from energyopt.robots.messages import shown


@dataclass(frozen=True, eq=False)
class Workspace:
    """Where to stay.

    Attributes:
        region: a `Box` to stay inside of, or a `HalfSpace` to stay out of (its normal points to the free side).
        frames: names of frames whose origins have to obey, one name or several; none means every link that moves, whole.

    Raises:
        GeometryError: the region is something else, or moves; frames are no names.
    """

    region: Box | HalfSpace
    frames: Any = ()

    def __post_init__(self):
        if not isinstance(self.region, (Box, HalfSpace)):
            expected = "a Box to stay inside of or a HalfSpace to stay out of"
            raise GeometryError(f"workspace is {shown(self.region)}; expected {expected}")
        if self.region.moves:
            raise GeometryError("workspace: the region moves; expected one at rest (give what moves as an obstacle)")
        frames = (self.frames,) if isinstance(self.frames, str) else self.frames
        if not isinstance(frames, (list, tuple)) or not all(isinstance(name, str) for name in frames):
            raise GeometryError(f"workspace: frames is {shown(self.frames)}; expected names of frames")
        object.__setattr__(self, "frames", tuple(dict.fromkeys(frames)))

    @property
    def walls(self) -> tuple[HalfSpace, ...]:
        """What may not be entered."""
        if isinstance(self.region, HalfSpace):
            return (self.region,)
        return workspace_walls(self.region.size, self.region.pose, self.region.name or "workspace")
