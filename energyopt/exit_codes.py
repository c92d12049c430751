"""Exit codes of the command line."""

VALID, INVALID, BAD_INPUT, INTERRUPTED, BROKEN_PIPE = 0, 1, 2, 130, 141
