"""What every command of this project does around its work: logging, and mistakes as one line and an exit code."""

import errno
import logging
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

from beso.errors import UserError

# Errors of the operating system that a user can mend.
USERS = {errno.ENOENT, errno.EEXIST, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG}
USERS |= {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS}


def log_to_stderr() -> None:
    """The library's log lines with the time of day, and others' warnings; worker processes need this too."""
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    logging.getLogger("beso").setLevel(logging.INFO)


def guard(main: Callable[..., Any], *given: Any) -> None:
    """Call `main` with arguments that it checks itself; exit 1 after a user's mistake, 130 after Ctrl-C."""
    log_to_stderr()
    try:
        main(*given)
        sys.stdout.flush()
    except BrokenPipeError:  # who reads the output has had enough, as `head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)
    except KeyboardInterrupt:
        _fail("interrupted; run the same command again: unfinished training continues, all else starts anew", 130)
    except UserError as error:
        _fail(f"error: {error}", 1)
    except OSError as error:
        if error.errno not in USERS:
            raise
        where = f": {error.filename}" if error.filename else ""
        _fail(f"error: {os.strerror(error.errno)}{where}; nothing was replaced", 1)


def _fail(message: str, code: int) -> None:
    print(message, file=sys.stderr)
    sys.exit(code)
