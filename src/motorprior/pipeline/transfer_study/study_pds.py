"""The PDs of a study: three fitted to the log of its bench, and one to the log of each robot."""

from __future__ import annotations

from dataclasses import asdict
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

from motorprior.artifacts import write_json
from motorprior.bench.facts import read_bench
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.pipeline.motor_choice import load_robot_fleet, nominal_pd
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.stage import description, is_finished, working
from motorprior.pipeline.transfer_study.study_settings import FITS, Study
from motorprior.robots.load import load_robot
from motorprior.transfer.study_verdicts import BASELINE, PD_FRICTION, TUNED_PD

if TYPE_CHECKING:
    from motorprior.identification.baselines.pd_fit import PdFit

FITTED = (BASELINE, TUNED_PD, PD_FRICTION)
LAGS = {"armature": (0.001, 0.005), "delay": (0.002, 0.008)}
"""[kg·m²], [s]; a fit begins with each of these: of a slow rotor and of a late one the error is alike."""
_MOST_STARTS = prod(map(len, LAGS.values()))
ROBOT_PD = "pd.json"
"""Name of the file of the PD of one robot."""


def fit_robot_pd(config: Study, log: Path, folder: Path, progress: Progress) -> None:
    """Fit a PD with friction to the log of one robot, as `fit_pds` does to that of the bench; pd.json is alike."""
    from motorprior.identification.baselines.pd_fit import beginnings, fit_to_the_end
    from motorprior.identification.baselines.tuned_pds import FRICTION  # here: they import scipy

    robot, start = load_robot(config.robot), _start(config)
    wanted = description("study", {"start": start, "kinds": FRICTION}, [log, *robot.files])
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            fit = fit_to_the_end(read_parquet(log), beginnings(start, FRICTION, LAGS), FRICTION)
            _note_no_end(folder.name, fit, progress)
            write_json(folder / ROBOT_PD, asdict(fit))


def _start(config: Study) -> dict[str, float]:
    """Gains and limit that every fit begins with."""
    from motorprior.identification.baselines.tuned_pds import GAINS  # here: it imports scipy

    nominal = nominal_pd(load_robot_fleet(load_robot(config.robot), config.fleet), 1)
    return {name: float(getattr(nominal, name)[0]) for name in GAINS}


def _note_no_end(name: str, fit: PdFit, progress: Progress) -> None:
    """Tell of a search that was cut short."""
    if not fit.converged:
        progress.note(f"note: the fit of {name} had not converged when its evaluations were used up")


def fit_pds(config: Study, progress: Progress) -> None:
    """Fit the three PDs to the bench's log, each until it has converged; fits.json has constants, error and effort."""
    from motorprior.identification.baselines.pd_fit import THOROUGH, beginnings, fit_to_the_end
    from motorprior.identification.baselines.tuned_pds import EVERYTHING, FRICTION, GAINS  # here: they import scipy

    robot = load_robot(config.robot)
    folder, start = config.out / "fits", _start(config)
    log = config.out / "bench" / "rollout" / "log.parquet"
    kinds = dict(zip(FITTED, (GAINS, EVERYTHING, FRICTION), strict=True))
    wanted = description("study", {"start": start, "kinds": kinds}, [log, *robot.files])
    if is_finished(folder, wanted):
        return
    with (
        working(folder, wanted),
        progress.start("fit the PDs", len(kinds) * THOROUGH.most(_MOST_STARTS)) as task,
    ):
        recorded = read_bench(log.parent)[0]
        fits = {
            name: fit_to_the_end(recorded, beginnings(start, free, LAGS), free, task.advance)
            for name, free in kinds.items()
        }
        for name, fit in fits.items():
            _note_no_end(name, fit, progress)
        write_json(folder / FITS, {name: asdict(fit) for name, fit in fits.items()})
