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
# what a constant means, with the speed v
MEANINGS = {
    "kp": "proportional gain: torque per angle error",
    "kd_over_kp": "derivative gain over proportional gain",
    "velocity_filter": "time constant of the low-pass of the velocity that the controller reads",
    "delay": "time from a command to its effect",
    "torque_limit": "largest torque of the control law",
    "armature": "inertia of the rotor, reflected through the gear",
    "coulomb": "dry friction, independent of the speed",
    "stribeck_torque": "additional dry friction at rest, which fades with the speed",
    "viscous_damping": "friction torque per speed of the rotor",
    "load_friction": "dry friction per torque through the gear",
    "gear_stiffness": "torque per twist of the gear",
    "backlash": "play of the gear, from stop to stop",
    "gear_damping": "torque per speed of the twist",
    "encoder_zero": "angle that the encoder reads at the joint's zero",
    "profile_speed": "largest speed of the reference that follows the target",
    "profile_acceleration": "largest acceleration of this reference",
    "output_encoder": "the controller reads the output shaft instead of the rotor",
    "dead_zone": "errors up to this value are ignored",
    "integral_rate": "growth of the integral torque: kp · integral_rate · angle error",
    "integral_limit": "largest integral torque",
    "stall_torque": "torque limit at rest: |torque| ≤ stall_torque · (1 − v/no_load_speed)",
    "no_load_speed": "speed at which this limit is zero",
    "current_time": "time constant with which the torque follows the control law",
    "asymmetry": "dry friction × (1 + asymmetry · sign(v))",
    "friction_slope": "dry friction × (1 + friction_slope · angle of the rotor)",
    "bristle_stiffness": "torque per angle of a rotor that dry friction holds",
    "output_damping": "friction torque per speed of the joint",
    "heat_loss": "share of the torque that a warm motor lacks",
    "heat_time": "time constant of warming up",
    "supply_share": "change of the control law's torque per relative change of the supply voltage",
    "temperature_loss": "share of the torque lost per 50 K of the motor's temperature",
}
# constants in the table of motor cards
CARD_CONSTANTS = ("armature", "coulomb", "viscous_damping", "kp", "delay")
WIDTH = "128"  # columns of the help of commands, so that lines of docstrings are not broken


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
    """Names, units and meanings of a motor's constants."""
    lines = ["# Constants", ""]
    lines += ["Every motor has these constants, which are at the output shaft."]
    lines += ["[The formula](../motor.md) combines them.", ""]
    lines += ["| constant | unit | meaning |", "|---|---|---|"]
    lines += [f"| `{name}` | {UNITS[name]} | {MEANINGS[name]} |" for name in PARAMETERS]
    lines += ["", "## Optional terms", ""]
    lines += ["A fit adds a term where it reduces the error on held-out parts of the logs.", ""]
    lines += ["| term | constant | unit | meaning |", "|---|---|---|---|"]
    for term_name, term in TERMS.items():
        for name, unit in [(c.name, c.unit) for c in term.constants] or [(term_name, "–")]:
            meaning = MEANINGS[name].replace("|", "\\|")
            lines.append(f"| `{term_name}` | `{name}` | {unit} | {meaning} |")
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
