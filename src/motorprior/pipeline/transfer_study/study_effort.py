"""What the models of a study took to fit, from the files in its folder, as a section of its page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from motorprior.artifacts import read_json
from motorprior.exceptions import ArtifactError
from motorprior.pipeline.stage import MARKER, seconds_of
from motorprior.pipeline.transfer_study.study_pds import ROBOT_PD
from motorprior.pipeline.transfer_study.study_settings import AGAIN, FITS, SPREADS

if TYPE_CHECKING:
    from motorprior.report.page import Section


def effort_sections(run: Path) -> tuple[Section, ...]:
    """The section, of a study that fitted a PD; none of another.

    Raises:
        ArtifactError: a file is damaged.
    """
    from motorprior.report.study_effort import Effort, effort_section  # here: it imports matplotlib

    fits, widths = run / "fits" / FITS, run / "spreads" / SPREADS
    if not fits.is_file():
        return ()
    effort = Effort(
        read_json(fits),
        read_json(widths) if widths.is_file() else None,
        [read_json(path) for path in sorted((run / "robots").glob(f"*/{ROBOT_PD}"))],
        _seconds(run),
    )
    try:
        return (effort_section(effort),)
    except (AttributeError, KeyError, TypeError) as error:
        raise ArtifactError(f"no fits of a study ({error!r})", where=fits.parent, remedy=AGAIN) from error


def _seconds(run: Path) -> Mapping[str, float]:
    """[s] of what was fitted: the PDs of the bench, every prior, and everything that is of one robot together."""
    fits = [run / "fits", *sorted((run / "priors").glob("*"))]
    found = {folder.name: seconds_of(folder) for folder in fits if (folder / MARKER).is_file()}
    of_robots = [path.parent for path in sorted((run / "robots").glob(f"*/{MARKER}"))]
    adapted = [seconds_of(folder) for folder in of_robots if not (folder / ROBOT_PD).is_file()]
    robot_pds = [seconds_of(folder) for folder in of_robots if (folder / ROBOT_PD).is_file()]
    return found | _total("posteriors", adapted) | _total("PDs", robot_pds)


def _total(what: str, seconds: list[float]) -> dict[str, float]:
    return {f"{len(seconds)} {what} of one robot each": sum(seconds)} if seconds else {}
