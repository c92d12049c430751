"""The parts of `energyopt.plotting`: the common look, and one module a figure."""
