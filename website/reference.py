"""Pages of the reference that are written from the package: API, commands, constants."""

import contextlib
import io
import os
from collections import defaultdict

import motorprior
from motorprior.actuator.constants import UNITS, ConstantSummary
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.motor_prior import shipped_cards
from motorprior.actuator.optional_terms import TERMS
from motorprior.cli.command_table import COMMANDS
from motorprior.cli.parse import parse

# folder of the package -> page of the API, its title
SECTIONS = {
    "logs": ("logs", "Logs"),
    "robots": ("robots", "Robots"),
    "bench": ("logs", "Logs"),
    "excitation": ("logs", "Logs"),
    "identification": ("priors", "Priors"),
    "priors": ("priors", "Priors"),
    "actuator": ("motors", "Motors"),
    "simulation": ("simulation", "Simulation and training"),
    "studies": ("simulation", "Simulation and training"),
    "locomotion": ("simulation", "Simulation and training"),
    "environments": ("simulation", "Simulation and training"),
    "report": ("simulation", "Simulation and training"),
    "exports": ("exports", "Exports"),
    "exceptions": ("errors", "Errors and progress"),
    "progress": ("errors", "Errors and progress"),
}
# classes of other simulators, which the package does not import by itself
OPTIONAL = {
    "exports": (
        "motorprior.exports.mjlab.MotorPriorActuatorCfg",
        "motorprior.exports.mjlab.per_world_damping",
        "motorprior.exports.newton.MotorPriorDrive",
    )
}
# constants in the table of motor cards
CARD_CONSTANTS = ("armature", "coulomb", "viscous_damping", "kp", "delay")
WIDTH = "118"  # columns of the help of commands, so that lines of docstrings are not broken


def pages() -> dict[str, str]:
    """Markdown by page."""
    return api_pages() | {
        "reference/command-options.md": command_page(),
        "reference/constants.md": constants_page(),
    }


def api_pages() -> dict[str, str]:
    """One page per part of the library, with every public name."""
    names_of_page: dict[str, list[str]] = defaultdict(list)
    titles = {}
    for name, module in motorprior._MODULES.items():
        page, title = SECTIONS[module.split(".")[1]]
        titles[page] = title
        names_of_page[page].append(name)

    written = {}
    for page, names in names_of_page.items():
        lines = [f"# {titles[page]}", "", "`import motorprior as mp`", ""]
        for name in sorted(names, key=str.lower):
            lines += _entry(f"{motorprior._MODULES[name]}.{name}", f"mp.{name}")
        for path in OPTIONAL.get(page, ()):
            lines += _entry(path, path.rpartition(".")[2])
        written[f"reference/api/{page}.md"] = "\n".join(lines)
    return written


def _entry(path: str, heading: str) -> list[str]:
    return [f"::: {path}", "    options:", f'      heading: "{heading}"', ""]


def command_page() -> str:
    """Every command with all its options."""
    lines = ["# Commands and options", ""]
    for name in COMMANDS:
        lines += [f"## motorprior {name}", "", "```text", _help(name), "```", ""]
    return "\n".join(lines)


def _help(name: str) -> str:
    text = io.StringIO()
    columns = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = WIDTH
    try:
        with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
            parse([*name.split(), "--help-all"])
    finally:
        if columns is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = columns
    return text.getvalue().rstrip()


def constants_page() -> str:
    """Names, symbols' units and terms of a motor's constants."""
    lines = ["# Constants", ""]
    lines += ["Constants of every motor, at the output shaft. [The formula](../motor.md)", ""]
    lines += ["| constant | unit |", "|---|---|"]
    lines += [f"| `{name}` | {UNITS[name]} |" for name in PARAMETERS]
    lines += ["", "## Optional terms", ""]
    lines += ["| term | constant | unit |", "|---|---|---|"]
    for term_name, term in TERMS.items():
        for constant in term.constants:
            lines.append(f"| `{term_name}` | `{constant.name}` | {constant.unit} |")
        if not term.constants:
            lines.append(f"| `{term_name}` | – | |")
    return "\n".join(lines) + "\n"


def card_table() -> str:
    """Medians of the constants of all shipped motor cards, a row per class of joints."""
    lines = [
        f"| card | joint | {' | '.join(f'{name} [{UNITS[name]}]' for name in CARD_CONSTANTS)} |"
    ]
    lines += ["|---" * (len(CARD_CONSTANTS) + 2) + "|"]
    for card in shipped_cards():
        prior = motorprior.from_pretrained(card)
        for joint_class in prior.classes.names:
            rows = {row.name: row for row in prior.constants(joint_class).rows}
            cells = [_median(rows.get(name)) for name in CARD_CONSTANTS]
            lines.append(f"| `{card}` | {joint_class or 'all'} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", "In italics: the logs do not identify the constant."])


def _median(row: ConstantSummary | None) -> str:
    if row is None:
        return "per register"
    value = f"{row.median:.2g}"
    return value if row.identifiable else f"*{value}*"
