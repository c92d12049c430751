"""Problem × parameterisation → nonlinear program, with exact derivatives."""

from energyopt.transcription.layout import TorqueRows
from energyopt.transcription.linear import SampleRow
from energyopt.transcription.program import NonlinearProgram, transcribe

__all__ = ["NonlinearProgram", "SampleRow", "TorqueRows", "transcribe"]
