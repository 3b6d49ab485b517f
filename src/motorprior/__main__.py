"""The command ``motorprior``; with the extra ``robot`` alone, only the commands for the robot's computer."""

from __future__ import annotations

import os
import sys

ON_THE_ROBOT = ("deploy", "record", "doctor")


def main() -> None:
    """Run a command line; see `motorprior.cli.main` and `motorprior.hardware.__main__`."""
    try:
        from motorprior.cli.main import main as run
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("motorprior"):
            raise
        command = next((word for word in sys.argv[1:] if not word.startswith("-")), ON_THE_ROBOT[0])
        if command not in ON_THE_ROBOT:
            print(
                f"error: `motorprior {command}` needs {error.name}, which is not installed -> "
                f"pip install 'motorprior[full]'; without it only {', '.join(ON_THE_ROBOT)} are available",
                file=sys.stderr,
            )
            raise SystemExit(2) from None
        from motorprior.hardware.__main__ import main as run
    try:
        run()
    except SystemExit as stop:
        if isinstance(stop.code, int) and stop.code:  # threads of stages may still run; their checkpoints are saved
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(stop.code)
        raise


if __name__ == "__main__":
    main()
