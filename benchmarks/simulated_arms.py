"""Coverage: do the 90 % intervals of constants hold the truth, on simulated arms?

    python benchmarks/simulated_arms.py --out runs/arms

Arms have one to twelve motors (`arm_simulation`). Their properties are mixed: rate of the commands,
gains in the log or not, a torque column or not, soft and stiff servos, rigid and elastic gears,
the encoder on either side of an elastic gear, rich and poor motion, a torque limit that is reached
or not. The description of an arm has no constant of its motors. An interrupted run continues.
figures.json has, with GROUP for one of these properties, `constant_NAME`, or `all`:

    arms/GROUP/coverage90   share of the constants that are called identified whose 90 % interval
                            (`MotorPrior.intervals`) holds the truth [-]
    arms/GROUP/identified   share of the constants that are called identified [-]
    arms/GROUP/count        number of constants that are called identified
    arms/unidentified_coverage90
                            coverage of the intervals of the other constants [-]
    arms/flat_profile       share of the constants called not identified, of the first joint of each
                            arm, for which the loss rises by less than FLAT if the constant is
                            divided or multiplied by √MAX_RATIO and the others are fitted again [-]
    arms/delay_bias         mean of fitted minus true delay where it is identified [s]
    arms/spurious           number of arms with an optional term

Groups without an identified constant are left out.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import motorprior as mp
from arm_simulation import JOINTS, ArmDesign, Constants, designs, drawn_constants, recorded
from figures import PROGRESS, run_benchmark
from motorprior.actuator.estimates import MAX_RATIO
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.artifacts import read_json, write_json
from motorprior.identification.physics import estimate_profiles, refinement
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import identification_preset, recipe_of
from motorprior.identification.windows import training_data
from motorprior.priors.fit_prior import fit_recipe

# relative rise of the loss below which a profile is flat: less than the model's error allows within
# a 90 % interval
FLAT = estimate_profiles.MODEL_ERROR
RESULT = "result.json"


@dataclass(frozen=True)
class Settings:
    """Fit the motors of simulated arms."""

    out: Path  # run folder
    motors: int = 200  # about this number of motors
    seconds: float = 20.0  # duration of the log of each arm [s]
    preset: str = "quick"  # recipe of the fits
    seed: int = 0
    workers: int = 1  # processes


def figures(settings: Settings) -> dict[str, float]:
    """The figures of all arms, by their keys."""
    arms = arms_of(settings)
    result_of = partial(arm_result, settings)
    if settings.workers == 1:
        results = [result_of(number, arm) for number, arm in enumerate(arms)]
    else:
        with ProcessPoolExecutor(settings.workers, get_context("spawn")) as pool:
            results = list(pool.map(result_of, range(len(arms)), arms))

    rows = []
    for arm, result in zip(arms, results, strict=True):
        for row in result["constants"]:
            groups = ("all", *arm.groups, f"constant_{row['constant']}")
            rows.append(row | {"groups": groups})
    return coverage_figures(rows) | {
        "arms/spurious": float(sum(result["has_terms"] for result in results)),
        "arms/motors": float(sum(arm.joints for arm in arms)),
    }


def coverage_figures(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Coverage and shares of all groups."""
    shares = {}
    for group in sorted({group for row in rows for group in row["groups"]}):
        in_group = [row for row in rows if group in row["groups"]]
        identified = [row for row in in_group if row["identified"]]
        if identified:
            covered = [row["low"] <= row["truth"] <= row["high"] for row in identified]
            shares[f"arms/{group}/coverage90"] = float(np.mean(covered))
            shares[f"arms/{group}/identified"] = len(identified) / len(in_group)
            shares[f"arms/{group}/count"] = float(len(identified))

    others = [row for row in rows if not row["identified"]]
    covered = [row["low"] <= row["truth"] <= row["high"] for row in others]
    shares["arms/unidentified_coverage90"] = float(np.mean(covered))
    profiles = [row["is_flat"] for row in others if "is_flat" in row]
    if profiles:
        shares["arms/flat_profile"] = float(np.mean(profiles))
    delays = [row for row in rows if row["constant"] == "delay" and row["identified"]]
    if delays:
        bias = [row["estimate"] - row["truth"] for row in delays]
        shares["arms/delay_bias"] = float(np.mean(bias))
    return shares


def arms_of(settings: Settings) -> list[ArmDesign]:
    """Designs of arms that together have about the number of motors."""
    return designs(max(1, round(settings.motors / np.mean(JOINTS))), settings.seed)


def arm_result(settings: Settings, number: int, arm: ArmDesign) -> dict[str, Any]:
    """Truth, estimate and interval of every fitted constant of an arm; written to a file once."""
    folder = settings.out / f"arm_{number}"
    if (folder / RESULT).exists():
        return read_json(folder / RESULT)

    constants = drawn_constants(np.random.default_rng([settings.seed, number]), arm)
    seed = 1000 * settings.seed + number
    log, constants = recorded(folder, arm, constants, settings.seconds, seed)
    prior = fitted(settings, folder, log, constants)
    result = {
        "groups": arm.groups,
        "has_terms": bool(recipe_of(prior).terms),
        "constants": rows_of(prior, log, constants),
    }
    write_json(folder / RESULT, result)
    return result


def fitted(
    settings: Settings, folder: Path, log: mp.MotorLog, constants: Constants
) -> mp.MotorPrior:
    """The prior of an arm. Its errors are compared with the true PD: none needs to be tuned."""
    zeros = np.zeros(log.num_joints)
    kd = constants["kp"] * constants["kd_over_kp"]
    limit = constants["torque_limit"]
    pd = IdealPd.without_friction(constants["kp"], kd, limit, zeros, zeros)
    recipe = identification_preset(settings.preset)
    out = folder / "prior"
    return fit_recipe(log, settings.preset, recipe, settings.seed, out, PROGRESS, tuned=pd)


def rows_of(prior: mp.MotorPrior, log: mp.MotorLog, truth: Constants) -> list[dict[str, Any]]:
    """A row per fitted constant and joint, of the constants that the simulated motors have."""
    rows = []
    is_flat = flat_profiles(prior, log)
    for name, ends in prior.intervals().items():
        if name not in truth:
            continue
        for joint in range(log.num_joints):
            estimate = prior.constants(log.joint_names[joint])[name].estimate
            assert estimate is not None
            row = {
                "joint": joint,
                "constant": name,
                "truth": float(min(truth[name][joint], 1e12)),
                "estimate": float(estimate.value),
                "low": float(ends[0, joint]),
                "high": float(min(ends[1, joint], 1e15)),
                "identified": estimate.is_identified,
            }
            if joint == 0 and name in is_flat and not estimate.is_identified:
                row["is_flat"] = is_flat[name]
            rows.append(row)
    return rows


def flat_profiles(prior: mp.MotorPrior, log: mp.MotorLog) -> dict[str, bool]:
    """Whether the profile of each positive constant of the first joint is flat; see FLAT."""
    recipe = recipe_of(prior)
    data = training_data(log, recipe, log.source)
    longer = refinement.longer_runs(data, recipe, WindowRuns(data, recipe))
    assert isinstance(prior.model, GreyBox)
    is_flat = {}
    first = np.array([0])
    for name, rises in estimate_profiles.profile_rises(
        prior.model, prior.mean, longer, MAX_RATIO**0.5, first
    ).items():
        is_flat[name] = bool(rises.min() < FLAT)
    return is_flat


if __name__ == "__main__":
    run_benchmark(Settings, figures, __doc__)
