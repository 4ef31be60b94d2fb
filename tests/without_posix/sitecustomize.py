"""Takes away from mavdem what Windows does not have: modules, functions, signals, and the kernel's stamps.

Python imports a module of this name when it starts, also in worker processes. Only what mavdem and its scenarios import
is changed: the standard library of this system, and other packages, need what it has.
"""

import builtins
import os
import signal
import socket
import sys
import time
import warnings
from types import ModuleType

POSIX_MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}
POSIX_NAMES = {
    os: """O_NOCTTY O_NONBLOCK chown fork forkpty getegid geteuid getgid getloadavg getpgid getpriority getuid killpg
        mkfifo nice openpty pwrite register_at_fork sched_getaffinity setpgid setpriority setsid statvfs sysconf uname
        wait wait3 wait4""",
    signal: """SIGALRM SIGCHLD SIGCONT SIGHUP SIGKILL SIGPIPE SIGQUIT SIGSTOP SIGTSTP SIGUSR1 SIGUSR2 SIGXCPU SIG_BLOCK
        SIG_SETMASK SIG_UNBLOCK alarm pause pthread_kill pthread_sigmask setitimer sigwait""",
    socket: "AF_UNIX SO_REUSEPORT send_fds recv_fds socketpair",
    time: "tzset",
}
OWN_PACKAGES = {"mavdem", "sitl_scenarios"}


class WindowsModule(ModuleType):
    """A module of this system as a program on Windows finds it."""

    def __init__(self, module, missing_names=(), **values):
        super().__init__(module.__name__)
        self.__dict__.update(_module=module, _missing_names=missing_names, _values=values)

    def __getattr__(self, name):
        if name in self._missing_names:
            raise AttributeError(f"Windows has no {self.__name__}.{name}")
        if name in self._values:
            return self._values[name]
        return getattr(self._module, name)

    def __setattr__(self, name, value):
        setattr(self._module, name, value)


MODULES = {
    module.__name__: WindowsModule(module, names.split()) for module, names in POSIX_NAMES.items()
}
MODULES["sys"] = WindowsModule(sys, platform="win32")
real_import = builtins.__import__


def import_as_on_windows(name, globals=None, locals=None, fromlist=(), level=0):
    importer = ((globals or {}).get("__package__") or "").partition(".")[0]
    if importer in OWN_PACKAGES and level == 0:
        if name.partition(".")[0] in POSIX_MODULES:
            raise ModuleNotFoundError(f"Windows has no module {name}")
        if name in MODULES:
            return MODULES[name]
    return real_import(name, globals, locals, fromlist, level)


builtins.__import__ = import_as_on_windows
# With PYTHONWARNDEFAULTENCODING a text file without a named encoding is an error.
warnings.filterwarnings("error", category=EncodingWarning, module="mavdem|sitl_scenarios")
