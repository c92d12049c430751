"""When and how fast: time laws on paths, uniform scaling, least durations."""

from energyopt.timing.uniform import UniformScaling, uniform_scaling

__all__ = ["UniformScaling", "uniform_scaling"]
