"""Change the text of an MJCF where it must change, and nowhere else: comments, order and spaces of the user stay."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.parsers import expat

import mujoco

from motorprior.artifacts import read_text
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.robots.user_model import cannot_read

OF_JOINTS = ("joint", "jointinparent")  # attributes by which an actuator names its joint
_START_TAG = re.compile(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>")


@dataclass
class Tag:
    """A start tag, and the place of its element."""

    element: str
    attributes: dict[str, str]
    parents: tuple[Tag, ...]  # from the outermost
    start: int  # of the tag in the file's bytes
    end: int = 0  # of the element: start of the end tag; that of the start tag if it has none

    def is_in(self, element: str) -> bool:
        """Whether an enclosing element has this name."""
        return any(each.element == element for each in self.parents)


class MjcfText:
    """The text of an MJCF and its tags; raises ArtifactError if it is not XML."""

    def __init__(self, path: Path):
        self._path = path
        self._data = read_text(path).encode()
        self._edits: list[tuple[int, int, bytes]] = []
        self.tags: list[Tag] = []
        parser, enclosing = expat.ParserCreate(), []

        def begin(element: str, attributes: dict[str, str]) -> None:
            enclosing.append(Tag(element, attributes, tuple(enclosing), parser.CurrentByteIndex))
            self.tags.append(enclosing[-1])

        def end(_: str) -> None:
            enclosing.pop().end = parser.CurrentByteIndex

        parser.StartElementHandler, parser.EndElementHandler = begin, end
        try:
            parser.Parse(self._data, True)
        except expat.ExpatError as error:
            raise ArtifactError(f"not XML ({error})", where=path, remedy="give an MJCF") from error

    @cached_property
    def compiled(self) -> mujoco.MjModel:
        """The user's model, compiled; raises ArtifactError if MuJoCo cannot read it."""
        try:
            return mujoco.MjModel.from_xml_path(str(self._path))
        except ValueError as error:
            raise cannot_read(self._path, str(error)) from error

    def joint(self, name: str) -> Tag:
        """The joint in the bodies; raises ConfigError if this file has none of the name."""
        inside = (tag for tag in self.tags if tag.element == "joint" and tag.is_in("worldbody"))
        joints = {tag.attributes.get("name", "?"): tag for tag in inside}
        if name not in joints:
            remedy = f"it has {', '.join(joints) or 'no joints'}; joints of an included file: give that file"
            raise ConfigError(f"no joint {name!r}", where=self._path, remedy=remedy, argument="joints")
        return joints[name]

    def actuator_of(self, joint: str) -> Tag | None:
        """The first actuator that names the joint."""
        named = (tag for tag in self.tags if joint in map(tag.attributes.get, OF_JOINTS) and tag.is_in("actuator"))
        return next(named, None)

    def set(self, tag: Tag, values: Mapping[str, str], element: str | None = None, drop: tuple[str, ...] = ()) -> None:
        """Set attributes of a start tag, delete those in ``drop``, and rename the element."""
        found = _START_TAG.match(self._data, tag.start)
        assert found is not None  # expat has parsed it
        text = found[0].decode()
        for name in (*values, *drop):
            text = re.sub(rf"\s+{re.escape(name)}\s*=\s*(\"[^\"]*\"|'[^']*')", "", text, count=1)
        close = "/>" if text.endswith("/>") else ">"
        text = text.removesuffix(close).rstrip() + " " + attribute_text(values) + close
        if element is not None:
            text = f"<{element}" + text[1 + len(tag.element) :]
            if close == ">":
                self._edit(tag.end, f"</{element}", tag.end + len(f"</{tag.element}"))
        self._edit(tag.start, text, found.end())

    def set_option(self, name: str, value: str) -> None:
        """Set an attribute of the root's <option>, which is added if there is none."""
        if own := self._sections("option"):
            self.set(own[-1], {name: value})
        else:
            self._edit(self.tags[0].end, f'  <option {name}="{value}"/>\n')

    def insert_in(self, section: str, line: str, apart: bool = False) -> None:
        """Insert an element at the end of a section of the root; in one more section if there is none, or ``apart``."""
        own = [tag for tag in self._sections(section) if tag.end != tag.start]
        if own and not apart:
            self._edit(own[0].end, f"  {line}\n  ")
        else:
            self._edit(self.tags[0].end, f"  <{section}>\n    {line}\n  </{section}>\n")

    def insert_before_body_of(self, joint: Tag, line: str) -> None:
        """Insert an element in front of the body that a joint moves."""
        body = next(tag for tag in reversed(joint.parents) if tag.element == "body")
        self._edit(body.start, f"{line}\n")

    def _sections(self, name: str) -> list[Tag]:
        return [tag for tag in self.tags if tag.element == name and len(tag.parents) == 1]

    def _edit(self, start: int, text: str, stop: int | None = None) -> None:
        edit = start, start if stop is None else stop, text.encode()
        if edit not in self._edits:  # options are set once per joint
            self._edits.append(edit)

    def text(self) -> str:
        """The text with all changes."""
        parts, at = [], 0
        for start, stop, new in sorted(self._edits, key=lambda edit: edit[0]):
            parts += [self._data[at:start], new]
            at = stop
        return b"".join([*parts, self._data[at:]]).decode()


def attribute_text(values: Mapping[str, str]) -> str:
    """Attributes as they stand in a tag."""
    return " ".join(f'{name}="{value}"' for name, value in values.items())
