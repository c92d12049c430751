"""Problem × parameterisation → nonlinear program, with exact derivatives."""

from energyopt.transcription.cuts import Cuts
from energyopt.transcription.program import NonlinearProgram, transcribe

__all__ = ["Cuts", "NonlinearProgram", "transcribe"]
