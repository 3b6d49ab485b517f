"""The class of a joint: joints of one class have the same motor and position on the robot.

Calves are an example. A robot's description or a log may state the class of each joint; otherwise
it is in the joints' names.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches

from motorprior.exceptions import ConfigError, listed

# words of a joint's name that state its side or its leg, not its class
_SIDES = frozenset((
    *("fl", "fr", "rl", "rr", "bl", "br", "hl", "hr", "lf", "rf", "lh", "rh", "lb", "rb", "l", "r"),
    *("left", "right", "front", "rear", "hind", "back", "fore", "joint", "motor"),
))  # fmt: skip
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def class_in_name(joint_name: str) -> str:
    """A joint's name without sides and numbers, such as "calf" for FL_calf_joint."""
    words = [word.lower() for word in _WORD.findall(joint_name)]
    return " ".join(word for word in words if word not in _SIDES)


def classes_by_name(joint_names: Sequence[str]) -> tuple[str, ...]:
    """The class of each joint: `class_in_name` of its name.

    All joints have the class "" if a name states none, or if at least half of the joints would have
    a class of their own: such names number the joints, or name them one by one.
    """
    classes = tuple(class_in_name(name) for name in joint_names)
    alone = sum(classes.count(joint_class) == 1 for joint_class in classes)
    if "" in classes or 2 * alone >= len(classes):
        return ("",) * len(classes)
    return classes


def motor_classes(joint_names: Sequence[str], described: Sequence[str]) -> tuple[str, ...]:
    """The class of each joint's motor: the described one or, without descriptions, by name."""
    return tuple(described) or classes_by_name(joint_names)


def position_classes(joint_names: Sequence[str], described: Sequence[str]) -> tuple[str, ...]:
    """The class of each joint's position on the robot, whatever its motor.

    It is in the joints' names. If they state none, it is the described class, unless the same class
    is described for all joints. Otherwise every joint is a class, of its own name.
    """
    by_name = classes_by_name(joint_names)
    if any(by_name):
        return by_name
    has_several_classes = len(set(described)) > 1
    return tuple(described) if has_several_classes else tuple(joint_names)


def classes_among(
    existing: Collection[str],
    joint_names: Sequence[str],
    described: Sequence[str] = (),
    class_of_joint: Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """The class of each joint among ``existing`` classes, if one of them fits.

    A described class that exists comes first. The next one is the class of the joint of the same
    name in ``class_of_joint``, then the class in the joint's name. A joint that fits no existing
    class has the class that is described or, without descriptions, that of `classes_by_name`.
    """
    classes = []
    for joint, (name, by_name) in enumerate(
        zip(joint_names, classes_by_name(joint_names), strict=True)
    ):
        in_name = class_in_name(name)
        inferred = in_name if in_name in existing else by_name
        inferred = (class_of_joint or {}).get(name, inferred)
        described_class = described[joint] if any(described) else inferred
        uses_description = described_class in existing or inferred not in existing
        classes.append(described_class if uses_description else inferred)
    return tuple(classes)


def unknown_joint(name: str, existing: Sequence[str], description: str) -> ConfigError:
    """Error of a ``name`` that is not among the ``existing`` ones, with the nearest of these.

    ``description`` states what the name should be, such as "joint of the robot".
    """
    existing = list(dict.fromkeys(existing))
    nearest = get_close_matches(name, existing, 3)
    nearest = nearest or get_close_matches(class_in_name(name), existing, 3)
    remedy = f"use one of {listed(existing, 16)}"
    if nearest:
        remedy = f"did you mean {' or '.join(nearest)}?"
    return ConfigError(f"{name!r} is no {description}", remedy=remedy, argument="joints")


def unknown_class(name: str, classes: Sequence[str], joints: Sequence[str]) -> ConfigError:
    """Error of a name that is neither a class nor a joint of a prior, with the nearest names."""
    names = [existing for existing in (*classes, *joints) if existing]
    if not names:
        problem = f"{name!r}: the prior has one class, without a name"
        return ConfigError(problem, remedy="leave it out", argument="joints")
    return unknown_joint(name, names, "joint or class of the prior")
