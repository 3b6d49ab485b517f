"""Classes of joints: joints of one class have the same motor and the same position on the robot, such as calves."""

import re
from collections.abc import Sequence

# words of a joint's name that state its side or its leg, not its kind
_SIDES = frozenset((
    *("fl", "fr", "rl", "rr", "bl", "br", "hl", "hr", "lf", "rf", "lh", "rh", "lb", "rb", "l", "r"),
    *("left", "right", "front", "rear", "hind", "back", "fore", "joint", "motor"),
))  # fmt: skip
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def kind_of(joint_name: str) -> str:
    """A joint's name without sides and numbers, such as "calf" for FL_calf_joint."""
    words = (word.lower() for word in _WORD.findall(joint_name))
    return " ".join(word for word in words if word not in _SIDES)


def classes_by_name(joint_names: Sequence[str]) -> tuple[str, ...]:
    """The class of each joint: `kind_of` its name.

    If at least half of the joints have a kind of their own, or a joint has no kind, the names do
    not state kinds: all joints then have the class "".
    """
    found = tuple(map(kind_of, joint_names))
    alone = sum(found.count(kind) == 1 for kind in found)
    return ("",) * len(found) if "" in found or 2 * alone >= len(found) else found
