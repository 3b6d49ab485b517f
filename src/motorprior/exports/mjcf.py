"""The user's MJCF, of which comments and the order of elements stay."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from xml.dom import minidom
from xml.parsers.expat import ExpatError

import mujoco
import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.user_model import cannot_read
from motorprior.simulation.driven_joints import drives

Element: TypeAlias = Any  # minidom element; minidom's types allow every parent to be None


@dataclass
class Mjcf:
    """A document, and the model that it was before any change."""

    document: Any  # minidom document
    compiled: mujoco.MjModel
    path: Path | None
    in_degrees: bool  # unit of its angles
    drivers: np.ndarray  # (actuators, joints) see `drives`
    dropped: tuple[int, ...] = ()  # addresses of activations that were removed from keyframes
    # for each rotor that was added, the first joint of the body that it stands before
    rotors: tuple[int, ...] = ()

    @classmethod
    def read(cls, text: str, path: Path | None = None) -> "Mjcf":
        """Parse the text of a file; raises ArtifactError if it is not a well-formed MJCF."""
        try:
            spec = (
                mujoco.MjSpec.from_string(text)
                if path is None
                else mujoco.MjSpec.from_file(str(path))
            )
            compiled = spec.compile()
            return cls(
                minidom.parseString(text.encode()),
                compiled,
                path,
                spec.compiler.degree,
                drives(compiled),
            )
        except (ExpatError, ValueError) as error:
            raise cannot_read(path, str(error)) from error

    def joint(self, name: str) -> Element:
        """The joint of this name in the bodies; raises ConfigError for one of an included file."""
        for each in self._inside("worldbody", "joint"):
            if each.getAttribute("name") == name:
                return each
        problem = f"joint {name!r} is in an included file"
        raise ConfigError(problem, where=self.path, remedy="give that file", argument="joints")

    def actuator_of(self, joint: str) -> tuple[Element, int] | None:
        """The element and index of the actuator that drives a joint, None without any.

        ConfigError for several, for one in another file, and for one that drives it by a tendon.
        """
        every = self._inside("actuator", "*")
        found = [
            each for each in every if joint in map(each.getAttribute, ("joint", "jointinparent"))
        ]
        drivers = np.flatnonzero(self.drivers[:, self.compiled.joint(joint).id]).tolist()
        if len(drivers) > 1 or len(drivers) > len(found):
            problem = f"joint {joint!r} has {len(drivers)} actuators, {len(found)} of them on it and in this file"
            remedy = "leave one at most, on it and in this file: the motor takes its place"
            raise ConfigError(problem, where=self.path, remedy=remedy, argument="model")
        return (found[0], drivers[0]) if drivers else None

    def _inside(self, section: str, element: str) -> list[Element]:
        sections = self.document.getElementsByTagName(section)
        return [found for each in sections for found in each.getElementsByTagName(element)]

    def section(self, name: str) -> Element:
        """The last section of this name, which is added if there is none."""
        root = self.document.documentElement
        found = [each for each in root.childNodes if each.nodeName == name]
        return found[-1] if found else self.add(root, name)

    def element(self, tag: str, /, **attributes: str) -> Element:
        """A new element, not yet in the document."""
        made = self.document.createElement(tag)
        for key, value in attributes.items():
            made.setAttribute(key, value)
        return made

    def add(
        self, parent: Element, tag: str, before: Element | None = None, /, **attributes: str
    ) -> Element:
        """Add an element to another, before one of its children or at its end."""
        made = parent.insertBefore(self.element(tag, **attributes), before)
        parent.insertBefore(self.document.createTextNode("\n"), before)
        return made

    def edit_keyframes(self, name: str, edit: Callable[[list[str], int], object]) -> None:
        """Change the words of an attribute of each keyframe that has it; ConfigError for keyframes in another file."""
        keys = self.document.getElementsByTagName("key")
        if len(keys) != self.compiled.nkey:
            remedy = "move them into this file"
            raise ConfigError(
                "keyframes in an included file", where=self.path, remedy=remedy, argument="model"
            )
        for index, key in enumerate(keys):
            if words := key.getAttribute(name).split():
                edit(words, index)
                key.setAttribute(name, " ".join(words))

    def text(self) -> str:
        """The document as text."""
        return "\n".join(each.toxml() for each in self.document.childNodes)


def number(*values: float) -> str:
    """Numbers of an attribute."""
    return " ".join(f"{value:.6g}" for value in values)
