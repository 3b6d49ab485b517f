"""An MJCF as a document into which motors are written; comments and the order of elements stay."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias
from xml.dom import minidom
from xml.parsers.expat import ExpatError

import mujoco

from motorprior.artifacts import read_text
from motorprior.exceptions import ArtifactError, ConfigError

Element: TypeAlias = Any  # of minidom, whose types let every parent be None


@dataclass
class Mjcf:
    """A document, and the model that it was before any change."""

    document: Any  # of minidom
    compiled: mujoco.MjModel
    path: Path | None = None

    @classmethod
    def load(cls, path: Path) -> Mjcf:
        """Read a file; raises ArtifactError if it is not a well-formed MJCF."""
        text = read_text(path)
        try:
            return cls(minidom.parseString(text.encode()), mujoco.MjModel.from_xml_path(str(path)), path)
        except (ExpatError, ValueError) as error:
            reason = " ".join(str(error).split())[:300]
            raise ArtifactError(f"cannot be read as MJCF ({reason})", where=path, remedy="correct the model") from error

    def joint(self, name: str) -> Element:
        """The joint of this name in the bodies; raises ConfigError if this file has none."""
        joints = {each.getAttribute("name"): each for each in self._inside("worldbody", "joint")}
        if name not in joints:
            remedy = f"it has {', '.join(joints) or 'no joints'}; joints of an included file: give that file"
            raise ConfigError(f"no joint {name!r}", where=self.path, remedy=remedy, argument="joints")
        return joints[name]

    def actuator_of(self, joint: str) -> Element | None:
        """The first actuator that names the joint."""
        every = self._inside("actuator", "*")
        return next((each for each in every if joint in map(each.getAttribute, ("joint", "jointinparent"))), None)

    def _inside(self, section: str, element: str) -> list[Element]:
        sections = self.document.getElementsByTagName(section)
        return [found for each in sections for found in each.getElementsByTagName(element)]

    def section(self, name: str) -> Element:
        """The first section of this name, which is added if there is none."""
        root = self.document.documentElement
        return next((each for each in root.childNodes if each.nodeName == name), None) or self.add(root, name)

    def element(self, tag: str, /, **attributes: str) -> Element:
        """A new element, not yet in the document."""
        made = self.document.createElement(tag)
        for key, value in attributes.items():
            made.setAttribute(key, value)
        return made

    def add(self, parent: Element, tag: str, before: Element | None = None, /, **attributes: str) -> Element:
        """Add an element to another, before one of its children or at its end."""
        made = parent.insertBefore(self.element(tag, **attributes), before)
        parent.insertBefore(self.document.createTextNode("\n"), before)
        return made

    def text(self) -> str:
        """The document as text."""
        return "\n".join(each.toxml() for each in self.document.childNodes)
