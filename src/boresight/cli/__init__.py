"""The command line: thin commands over the public verbs, one file each.

A user's mistake is one clear line on standard error and exit code 2.  With ``--json`` a command prints its result on standard
output and nothing else there.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import cyclopts

from .. import __version__
from ..errors import BoresightError
from .assess import assess
from .calibrate import calibrate
from .compare import compare
from .convert import convert
from .correct import correct
from .demo import demo
from .info import info
from .plan import plan
from .simulate import simulate
from .study import study
from .verify import verify
from .warm import warm

app = cyclopts.App(
    name="boresight",
    help="Find, remove and prove the systematic errors of radars.",
    version=__version__,
    help_format="markdown",  # plain text would keep the line breaks of the docstrings
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
for _command in (demo, info, calibrate, correct, convert, assess, compare, verify, plan, simulate, study, warm):
    app.command(_command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 2 the user's input cannot be used, 130 interrupted."""
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    try:
        app(tokens, exit_on_error=False, print_error=False)
    except cyclopts.CycloptsError as error:
        _fail(" ".join(str(error).split()) + "  (boresight --help shows the commands and options)")
    except BoresightError as error:
        _fail(str(error))
    except BrokenPipeError:
        # The reader of our output (head, say) has gone: nothing more to tell it, and no traceback at exit either.
        sys.stdout = None
    except KeyboardInterrupt:
        _interrupted()
    except SystemError as error:
        # Ctrl-C while compiled code is entered or left comes out as this.
        if not isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            raise
        _interrupted()
    except OSError as error:
        _fail(f"{error.filename or 'the system'}: {error.strerror or error}")
    raise SystemExit(0)


def _interrupted() -> None:
    print("boresight: interrupted; nothing half-written was left", file=sys.stderr)
    raise SystemExit(130) from None


def _fail(message: str) -> None:
    print(f"boresight: {message}", file=sys.stderr)
    raise SystemExit(2) from None
