"""A user's MJCF or URDF as MuJoCo's editable description, with what a URDF cannot state.

A URDF gets a free joint at its root link where the robot's base is free, and its meshes at their files; a mesh that is
not found, or has a format that MuJoCo does not read, is left out where the link states its inertia. A foot that is the
name of a link or body is its only sphere.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco

from motorprior.exceptions import ArtifactError
from motorprior.robots.model_source import is_urdf, mesh_file

_MESHES = (".stl", ".obj", ".msh")  # formats that MuJoCo reads


def read_spec(path: Path, is_free: bool, feet: Sequence[str]) -> Any:
    """The ``MjSpec`` of a model; raises ArtifactError for a missing mesh that gives a link its inertia."""
    spec = mujoco.MjSpec.from_file(str(path))
    if is_urdf(path):
        # a link keeps its name, the base its body, and shapes that touch nothing stay for films
        spec.compiler.fusestatic = spec.compiler.discardvisual = False
        _place_meshes(spec, path)
        base = spec.worldbody.first_body()
        if is_free and base is not None and base.first_joint() is None:
            base.add_freejoint()
    for foot in feet:
        body, known = spec.body(foot), {geom.name for geom in spec.geoms}
        spheres = [geom for geom in body.geoms if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE] if body else []
        if foot not in known and len(spheres) == 1:
            spheres[0].name = foot
    return spec


def _place_meshes(spec: Any, path: Path) -> None:
    for mesh in spec.meshes:
        file = mesh_file(path, mesh.file, spec.meshdir)
        if file is not None and file.suffix.lower() in _MESHES:
            mesh.file = str(file)
            continue
        for geom in [geom for geom in spec.geoms if geom.meshname == mesh.name]:
            if not geom.parent.explicitinertial:
                problem = f"link {geom.parent.name!r} has no <inertial>, and its mesh {mesh.file!r} cannot be read"
                remedy = f"give the link an <inertial>, or put an .stl or .obj at this path below {path.parent}"
                raise ArtifactError(problem, where=path, remedy=f"{remedy} or a folder above it")
            spec.delete(geom)
        spec.delete(mesh)
