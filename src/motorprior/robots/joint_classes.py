"""The class of a joint: joints of one class have the same motor and position on the robot.

Calves are an example. A robot's description or a log may state the class of each joint
(``given_classes``); otherwise it is in the joints' names (`classes_by_name`).
"""

import re
from collections.abc import Sequence

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
