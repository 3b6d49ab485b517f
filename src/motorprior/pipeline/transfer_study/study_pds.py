"""The three PDs of a study, fitted to the log of its bench."""

from __future__ import annotations

from dataclasses import asdict

from motorprior.artifacts import write_json
from motorprior.bench.facts import read_bench
from motorprior.pipeline.motor_choice import load_robot_fleet, nominal_pd
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.stage import description, is_finished, working
from motorprior.pipeline.transfer_study.study_settings import FITS, Study
from motorprior.robots.load import load_robot
from motorprior.transfer.study_verdicts import BASELINE, PD_FRICTION, TUNED_PD

FITTED = (BASELINE, TUNED_PD, PD_FRICTION)


def fit_pds(config: Study, progress: Progress) -> None:
    """Fit the three PDs to the bench's log, each until it has converged; fits.json has constants, error and effort."""
    from motorprior.identification.baselines.pd_fit import MOST_EVALUATIONS, fit_to_the_end
    from motorprior.identification.baselines.tuned_pds import EVERYTHING, FRICTION, GAINS  # here: they import scipy

    robot = load_robot(config.robot)
    fleet, folder = load_robot_fleet(robot, config.fleet), config.out / "fits"
    log = config.out / "bench" / "rollout" / "log.parquet"
    nominal = nominal_pd(fleet, 1)
    start = {name: float(getattr(nominal, name)[0]) for name in GAINS}
    kinds = dict(zip(FITTED, (GAINS, EVERYTHING, FRICTION), strict=True))
    wanted = description("study", __file__, {"start": start, "kinds": kinds}, [log, *robot.files])
    if is_finished(folder, wanted):
        return
    with (
        working(folder, wanted),
        progress.start("fit the PDs", len(kinds) * MOST_EVALUATIONS) as task,
    ):
        recorded = read_bench(log.parent)[0]
        fits = {name: asdict(fit_to_the_end(recorded, start, free, task.advance)) for name, free in kinds.items()}
        for name, fit in fits.items():
            if not fit["converged"]:
                progress.note(f"note: the fit of {name} had not converged when its evaluations were used up")
        write_json(folder / FITS, fits)
