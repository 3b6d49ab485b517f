"""The command ``motorprior``."""

import os
import sys

from motorprior.cli.main import main as run_command_line


def main() -> None:
    """Run a command line; see `motorprior.cli.main`."""
    try:
        run_command_line()
    except SystemExit as stop:
        if isinstance(stop.code, int) and stop.code:
            # threads of stages may still run; their checkpoints are saved
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(stop.code)
        raise


if __name__ == "__main__":
    main()
