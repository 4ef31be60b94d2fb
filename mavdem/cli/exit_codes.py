"""Exit codes of the command line, by which a shell or a script sees how a command ended."""

import signal

EXIT_DONE = 0
"""The command did what was requested."""

EXIT_UNSUPPORTED = 1
"""The data cannot support the request: for example, no model can be learned from the log."""

EXIT_ERROR = 2
"""Bad usage, unreadable input, or output that cannot be written. Click uses the same code for bad usage."""

SIGNAL_EXIT_BASE = 128
"""Exit code of a process that a signal has ended, less the number of the signal: the convention of POSIX shells."""

EXIT_INTERRUPTED = SIGNAL_EXIT_BASE + signal.SIGINT
"""The user has pressed Ctrl-C."""

EXIT_PIPE_CLOSED = SIGNAL_EXIT_BASE + 13
"""The program that reads standard output has closed the pipe, as ``head`` does. POSIX signals that by SIGPIPE, 13."""
