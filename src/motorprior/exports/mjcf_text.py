"""Change the text of an MJCF where it must change, and nowhere else: comments, order and spaces of the user stay."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.parsers import expat

import mujoco

from motorprior.artifacts import read_text
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.robots.user_model import cannot_read

OF_JOINTS = ("joint", "jointinparent")  # attributes by which an actuator names its joint


@dataclass(frozen=True)
class Tag:
    """A start tag, and the place of its element."""

    element: str
    attributes: dict[str, str]
    path: tuple[int, ...]  # index of every enclosing tag, from the outermost
    start: int  # of the tag in the file's bytes
    ends: list[int] = field(default_factory=list)  # start of the end tag; that of the start tag if it has none


class MjcfText:
    """The text of an MJCF and its tags; raises ArtifactError if it is not XML."""

    def __init__(self, path: Path):
        self._path = path
        self._data = read_text(path).encode()
        self.tags: list[Tag] = []
        parser, open_tags = expat.ParserCreate(), []

        def begin(element: str, attributes: dict[str, str]) -> None:
            open_tags.append(len(self.tags))
            self.tags.append(Tag(element, attributes, tuple(open_tags[:-1]), parser.CurrentByteIndex))

        def end(element: str) -> None:
            self.tags[open_tags.pop()].ends.append(parser.CurrentByteIndex)

        parser.StartElementHandler, parser.EndElementHandler = begin, end
        try:
            parser.Parse(self._data, True)
        except expat.ExpatError as error:
            raise ArtifactError(f"not XML ({error})", where=path, remedy="give an MJCF") from error
        self._edits: list[tuple[int, int, bytes]] = []
        self._options: set[str] = set()

    @cached_property
    def compiled(self) -> mujoco.MjModel:
        """The user's model, compiled; raises ArtifactError if MuJoCo cannot read it."""
        try:
            return mujoco.MjModel.from_xml_path(str(self._path))
        except ValueError as error:
            raise cannot_read(self._path, str(error)) from error

    @property
    def timestep(self) -> float:
        """Physics step of the model [s]."""
        return float(self.compiled.opt.timestep)

    def joint(self, name: str) -> Tag:
        """The joint in the bodies; raises ConfigError if this file has none of the name."""
        joints = [tag for tag in self.tags if tag.element == "joint" and "worldbody" in self._parents(tag)]
        for tag in joints:
            if tag.attributes.get("name") == name:
                return tag
        names = ", ".join(tag.attributes.get("name", "?") for tag in joints) or "no joints"
        remedy = f"it has {names}; joints of an included file: give that file"
        raise ConfigError(f"no joint {name!r}", where=self._path, remedy=remedy, argument="joints")

    def set_option(self, name: str, value: str) -> None:
        """Set an attribute of the root's <option>, which is added if there is none; a second time has no effect."""
        if name in self._options:
            return
        self._options.add(name)
        own = [tag for tag in self.tags if tag.element == "option" and len(tag.path) == 1]
        if own:
            self.set(own[-1], {name: value})
        else:
            at = self.tags[0].ends[0]
            self._edits.append((at, at, f'  <option {name}="{value}"/>\n'.encode()))

    def actuator_of(self, joint: str) -> Tag | None:
        """The first actuator that names the joint."""
        for tag in self.tags:
            named = {tag.attributes.get(key) for key in OF_JOINTS}
            if joint in named and "actuator" in self._parents(tag):
                return tag
        return None

    def _parents(self, tag: Tag) -> set[str]:
        return {self.tags[index].element for index in tag.path}

    def set(self, tag: Tag, values: Mapping[str, str], element: str | None = None, drop: tuple[str, ...] = ()) -> None:
        """Set attributes of a start tag, delete those in ``drop``, and rename the element."""
        stop = self._end_of(tag.start)
        text = self._data[tag.start : stop].decode()
        for name in (*values, *drop):
            text = re.sub(rf"\s+{re.escape(name)}\s*=\s*(\"[^\"]*\"|'[^']*')", "", text, count=1)
        close = "/>" if text.endswith("/>") else ">"
        added = "".join(f' {name}="{value}"' for name, value in values.items())
        text = text.removesuffix(close).rstrip() + added + close
        if element is not None and element != tag.element:
            text = f"<{element}" + text[1 + len(tag.element) :]
            if close == ">":  # the end tag
                at = tag.ends[0]
                self._edits.append((at, at + len(f"</{tag.element}".encode()), f"</{element}".encode()))
        self._edits.append((tag.start, stop, text.encode()))

    def insert_in(self, section: str, lines: list[str], apart: bool = False) -> None:
        """Insert elements at the end of a section of the root; in one more section if there is none, or ``apart``."""
        own = (
            []
            if apart
            else [
                tag for tag in self.tags if tag.element == section and len(tag.path) == 1 and tag.ends[0] != tag.start
            ]
        )
        inner = "".join(f"  {line}\n  " for line in lines)
        if own:
            at = own[0].ends[0]
            self._edits.append((at, at, inner.encode()))
            return
        at = self.tags[0].ends[0]
        self._edits.append((at, at, f"  <{section}>\n  {inner}</{section}>\n".encode()))

    def insert_before_body_of(self, joint: Tag, lines: list[str]) -> None:
        """Insert elements in front of the body that a joint moves."""
        body = next(self.tags[index] for index in reversed(joint.path) if self.tags[index].element == "body")
        self._edits.append((body.start, body.start, "".join(f"{line}\n" for line in lines).encode()))

    def text(self) -> str:
        """The text with all changes."""
        data = self._data
        order = sorted(range(len(self._edits)), key=lambda index: (self._edits[index][0], index), reverse=True)
        for start, stop, new in (self._edits[index] for index in order):
            data = data[:start] + new + data[stop:]
        return data.decode()

    def _end_of(self, start: int) -> int:
        match = re.compile(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>").match(self._data, start)
        assert match is not None  # expat has parsed it
        return match.end()
