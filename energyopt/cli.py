"""The command line: arguments in, exit code out. The work is done by `cli_commands`, `workflow`, `tables` and `io`.

Exit codes: 0 solved and valid, 1 no valid plan, 2 bad input (one line on stderr says what and where), 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from energyopt.cli_commands import COMMANDS
from energyopt.cli_parser import make_parser
from energyopt.errors import EnergyOptError
from energyopt.exit_codes import BAD_INPUT, BROKEN_PIPE, INTERRUPTED
from energyopt.stopping import say_at_the_end

SAID = "energyopt: interrupted"
"""After Ctrl-C."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # terminals without Greek letters get a question mark
    say_at_the_end(SAID)
    try:
        parsed = make_parser().parse_args(arguments)
        code = COMMANDS[parsed.command](parsed)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader, such as head, has what it wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except KeyboardInterrupt:
        return INTERRUPTED
    except EnergyOptError as error:
        print(f"energyopt: error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
