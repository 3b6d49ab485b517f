"""Format mjcf: variants of the user's MJCF, with every motor as a plain joint."""

import os
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

from motorprior.artifacts import write_text
from motorprior.exports.exporter import Exporter, Request, described_loss, prior_of
from motorprior.exports.mjcf_document import Mjcf
from motorprior.exports.plain_joint import NOT_EXPRESSED, WriteMotor, replayed, write_plain
from motorprior.exports.table import write_table
from motorprior.robots.model_source import model_files
from motorprior.simulation.driven_joints import hinge, require_uncoupled


def write_variants(request: Request, write: WriteMotor) -> list[Path]:
    """Write K variants of the user's MJCF, with copies of the files that it names, and motors.json.

    Files keep their positions relative to each other: if a model in scene/ has meshes in ../assets,
    both folders are written. Raises ArtifactError if a variant cannot be compiled.
    """
    original = request.model
    assert original is not None
    hinges = [hinge(original.compiled, name) for name in request.joint_names]
    require_uncoupled(original.compiled, hinges)
    model_path = _copy_files(request)

    variants = []
    for _ in range(len(request.constants["kp"])):
        variants.append(replace(original, document=original.document.cloneNode(True)))
    for index, joint, values in request.motors():
        write(variants[index], joint, values)

    paths = []
    comment = _comment(request)
    for index, variant in enumerate(variants):
        path = model_path.with_name(f"{model_path.stem}_{index:03d}.xml")
        text = f"{variant.text()}\n<!-- {comment} -->\n"
        write_text(path, text)
        Mjcf.read(text, path)  # raises ArtifactError if it cannot be compiled
        paths.append(path)
    return [*paths, *write_table(request)]


def _copy_files(request: Request) -> Path:
    """Copy the files that the model names; returns the path of the model next to the copies."""
    original = request.model
    assert original is not None and original.path is not None
    model, *named_files = model_files(original.path)
    root = Path(os.path.commonpath([file.parent for file in (model, *named_files)]))
    for file in named_files:
        target = request.out / file.relative_to(root)
        if target.resolve() != file:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
    return request.out / model.relative_to(root)


def _comment(request: Request) -> str:
    """Origin and loss of the motors, as an XML comment."""
    motor = prior_of(request.source).motor
    loss = described_loss(request.losses, request.not_expressed)
    text = f"motors of {motor}, seed {request.seed}; {loss}"
    return re.sub("-{2,}", "-", text)  # an XML comment must not contain two dashes


MJCF = Exporter(
    name="mjcf",
    not_expressed=NOT_EXPRESSED,
    write=partial(write_variants, write=write_plain),
    replay=partial(replayed, write=write_plain),
    needs_model=True,
)
