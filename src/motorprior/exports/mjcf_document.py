"""The user's MJCF as an XML document, of which comments and the order of elements stay."""

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
    # for each rotor that was added, the first joint of the link that it stands before
    rotors: tuple[int, ...] = ()

    @classmethod
    def read(cls, text: str, path: Path | None = None) -> "Mjcf":
        """Parse the text of a file; raises ArtifactError if it is not a well-formed MJCF."""
        try:
            if path is None:
                spec = mujoco.MjSpec.from_string(text)
            else:  # finds meshes and included files relative to the file
                spec = mujoco.MjSpec.from_file(str(path))
            compiled = spec.compile()
            document = minidom.parseString(text.encode())
        except (ExpatError, ValueError) as error:
            raise cannot_read(path, str(error)) from error
        return cls(document, compiled, path, spec.compiler.degree, drives(compiled))

    def joint(self, name: str) -> Element:
        """The joint of this name below the worldbody.

        Raises ConfigError for a joint of an included file.
        """
        for joint in self._elements_inside("worldbody", "joint"):
            if joint.getAttribute("name") == name:
                return joint

        raise ConfigError(
            f"joint {name!r} is in an included file",
            where=self.path,
            remedy="give that file",
            argument="joints",
        )

    def actuator_of(self, joint: str) -> tuple[Element, int] | None:
        """The element and index of the actuator that drives a joint, None without any.

        Raises ConfigError for several actuators, for an actuator in another file, and for one that
        drives the joint by a tendon.
        """
        elements = []
        for actuator in self._elements_inside("actuator", "*"):
            attributes = ("joint", "jointinparent")
            if joint in map(actuator.getAttribute, attributes):
                elements.append(actuator)
        drivers = np.flatnonzero(self.drivers[:, self.compiled.joint(joint).id]).tolist()

        if len(drivers) > 1 or len(drivers) > len(elements):
            problem = (
                f"joint {joint!r} has {len(drivers)} actuators, "
                f"{len(elements)} of them on it and in this file"
            )
            remedy = "leave one at most, on it and in this file: the motor takes its place"
            raise ConfigError(problem, where=self.path, remedy=remedy, argument="model")
        if not drivers:
            return None
        return elements[0], drivers[0]

    def _elements_inside(self, section_name: str, tag: str) -> list[Element]:
        elements = []
        for section in self.document.getElementsByTagName(section_name):
            elements.extend(section.getElementsByTagName(tag))
        return elements

    def section(self, name: str) -> Element:
        """The last section of this name, which is added if there is none."""
        root = self.document.documentElement
        sections = [child for child in root.childNodes if child.nodeName == name]
        if sections:
            return sections[-1]
        return self.add(root, name)

    def element(self, tag: str, /, **attributes: str) -> Element:
        """A new element, not yet in the document."""
        element = self.document.createElement(tag)
        for name, value in attributes.items():
            element.setAttribute(name, value)
        return element

    def add(
        self, parent: Element, tag: str, next_sibling: Element | None = None, /, **attributes: str
    ) -> Element:
        """Add an element to another, before one of its children or at its end."""
        element = self.element(tag, **attributes)
        parent.insertBefore(element, next_sibling)
        parent.insertBefore(self.document.createTextNode("\n"), next_sibling)
        return element

    def edit_keyframes(self, attribute: str, edit: Callable[[list[str], int], object]) -> None:
        """Change the words of an attribute of each keyframe that has it, in place.

        ``edit`` gets the words and the index of the keyframe. Raises ConfigError for keyframes in
        another file.
        """
        keyframes = self.document.getElementsByTagName("key")
        if len(keyframes) != self.compiled.nkey:
            raise ConfigError(
                "keyframes in an included file",
                where=self.path,
                remedy="move them into this file",
                argument="model",
            )
        for index, keyframe in enumerate(keyframes):
            words = keyframe.getAttribute(attribute).split()
            if words:
                edit(words, index)
                keyframe.setAttribute(attribute, " ".join(words))

    def text(self) -> str:
        """The document as text."""
        return "\n".join(node.toxml() for node in self.document.childNodes)


def number(*values: float) -> str:
    """Numbers of an attribute as text."""
    return " ".join(f"{value:.6g}" for value in values)
