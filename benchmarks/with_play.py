"""The prior of motors that are fitted one by one, with backlash: a model that more than one benchmark compares with."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.facts import LOG, read_bench
from motorprior.pipeline.identify import PRIOR
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.stage import description, is_finished, working

WITH_PLAY = "per_motor_play"
"""The recipe per_motor with backlash and stiffness of the gear among its constants."""


def fit_with_play(bench: Path, folder: Path, seed: int, progress: Progress) -> Path:
    """Fit the motors of ``bench`` and write their prior into ``folder``, unless it is there; returns its path."""
    from motorprior.identification.per_motor import fit_motors
    from motorprior.identification.presets import identification_preset
    from motorprior.identification.reference import reference_metrics
    from motorprior.identification.windows import training_data

    log, facts = read_bench(bench)
    preset = identification_preset("per_motor")
    wanted = description("identify", {"preset": WITH_PLAY}, [bench / LOG], recipe=asdict(preset))
    if is_finished(folder, wanted):
        return folder / PRIOR
    with working(folder, wanted):
        data = training_data(log, preset, str(bench))
        with progress.start(f"identify {WITH_PLAY}", 1):
            network, mean, log_var = fit_motors(data, preset)
        provenance = {"bench": facts.as_json(), "recipe": asdict(preset), "seed": seed}
        metrics = reference_metrics(network, data, preset, mean, log)
        MotorPrior(
            network, mean, log_var, WITH_PLAY, facts.fleet.robot, facts.fleet.motor, provenance, metrics
        ).save(folder / PRIOR)  # fmt: skip
    return folder / PRIOR
