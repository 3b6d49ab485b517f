"""The command ``motorprior``; with the extra ``robot`` alone, only the commands for the robot's computer."""

import os
import sys


def main() -> None:
    """Run a command line; see `motorprior.cli.main` and `motorprior.hardware.__main__`."""
    try:
        from motorprior.cli.main import main as run
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("motorprior"):
            raise
        from motorprior.hardware.__main__ import main as run
    try:
        run()
    except SystemExit as stop:
        # threads of stages may still run; their checkpoints are saved
        if isinstance(stop.code, int) and stop.code:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(stop.code)
        raise


if __name__ == "__main__":
    main()
