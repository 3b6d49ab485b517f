"""What commands print: notes and progress on stderr, tables on stdout."""

import shlex
import sys
from collections.abc import Sequence

from motorprior.progress import Lines

TERMINAL = Lines()
_WIDTH_OF_FILE = 120  # letters in a line of a table that is not printed to a terminal
_WITHOUT_EFFECT = ("--out", "--workers")  # options on which no result depends


def command_line() -> str:
    """The command line of this process, without options on which no result depends."""
    words: list[str] = []
    arguments = iter(["motorprior", *sys.argv[1:]])
    for word in arguments:
        if word in _WITHOUT_EFFECT:
            next(arguments, None)  # the value of the option
        elif word.partition("=")[0] not in _WITHOUT_EFFECT:
            words.append(word)
    return shlex.join(words)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; the first column is text, the others are numbers."""
    from rich.console import Console  # here: not on the robot's own computer
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for index, column in enumerate(columns):
        table.add_column(Text(column), justify="left" if index == 0 else "right")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))

    width = None if sys.stdout.isatty() else _WIDTH_OF_FILE
    Console(file=sys.stdout, highlight=False, width=width).print(table)
