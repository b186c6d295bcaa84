"""Exit codes of the command line."""

DONE = 0
FAILED = 1  # a case failed; the others are done
INPUT = 2  # what the user gave cannot be used; nothing was done
INTERRUPTED = 130  # Ctrl-C
CLOSED = 141  # whoever read the output has closed it: what a shell says of SIGPIPE
