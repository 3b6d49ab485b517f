"""Names of motors in a study, PDs with friction and spread, and settings that are refused."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.friction_pd import FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ConfigError
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.transfer_study import study_settings, study_spreads
from motorprior.pipeline.transfer_study.condition import Condition
from motorprior.pipeline.transfer_study.study_conditions import conditions
from motorprior.pipeline.transfer_study.study_settings import FITS, OWN_MOTORS, Study
from motorprior.pipeline.transfer_study.study_spreads import with_spread
from motorprior.pipeline.transfer_study.transfer import walker_of
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.randomization import ROBUST
from motorprior.transfer.places import ABROAD
from motorprior.transfer.study_verdicts import ADAPTED, PD_FRICTION, PD_RANDOMISED, PRIOR_MEAN, ROBUST_PRIOR
from motorprior.transfer.study_verdicts import PRIOR as SAMPLED

PD = MotorChoice("pd", armature=0.003, coulomb=0.1)


def drawn(choice: MotorChoice, seed: int = 0) -> Any:
    return choice.drawer(PUPPER_V2)(np.random.default_rng(seed))


def test_a_pd_with_friction_has_it_and_one_without_is_ideal():
    assert isinstance(drawn(PD), FrictionPd) and isinstance(drawn(replace(PD, coulomb=0.0)), IdealPd)
    with pytest.raises(ConfigError, match="without armature"):
        drawn(replace(PD, armature=0.0))


def test_a_spread_changes_every_constant_of_every_motor_within_its_share_and_no_spread_none():
    fixed = drawn(PD)
    for name in ("kp", "kd", "torque_limit", "armature"):
        ratio = np.array([getattr(drawn(replace(PD, spread=0.3), seed).pd, name) for seed in range(50)])
        ratio /= getattr(fixed.pd, name)
        assert 0.7 <= ratio.min() < 0.75 and 1.25 < ratio.max() <= 1.3 and len(np.unique(ratio)) == ratio.size
        np.testing.assert_array_equal(getattr(drawn(PD, 1).pd, name), getattr(fixed.pd, name))


def test_a_delay_that_was_fitted_to_nothing_is_varied_too():
    for fitted, least, most in ((0.0, 0.0, 0.006), (0.01, 0.004, 0.016)):
        delays = np.array([drawn(replace(PD, spread=0.3, delay=fitted), seed).pd.delay for seed in range(50)])
        assert least <= delays.min() < least + 1e-3 and most - 1e-3 < delays.max() <= most


@pytest.mark.parametrize(
    ("change", "words"),
    [({"spread": 1.0}, "spread"), ({"spread": -0.1}, "spread"), ({"coulomb": np.nan}, "coulomb")],
)
def test_impossible_pds_are_refused(change: dict, words: str):
    with pytest.raises(ConfigError, match=words):
        drawn(replace(PD, **change))


def test_names_are_those_given_and_are_kept_with_what_training_varied(tmp_path: Path):
    assert PD.condition() == "pd_friction" and replace(PD, name="mine").condition() == "mine"
    motors = replace(PD, spread=0.2, name="mine")
    run_walk(Walk(tmp_path, motors, iterations=1, episode_steps=5, workers=1, randomization=ROBUST))
    walker = walker_of(tmp_path / POLICY, PUPPER_V2)
    assert walker.condition == "mine"
    assert Policy.load(tmp_path / POLICY).provenance["motors"]["spread"] == 0.2
    one, other = (walker.own.run(walker.policy.arrays(), 5, trace=True).trace for _ in range(2))
    np.testing.assert_array_equal(one, other)
    varied = walker.own._walk.randomization  # pyright: ignore[reportAttributeAccessIssue]
    assert varied == ROBUST, "its own simulation is that of its training"


def test_only_a_simulation_without_chance_is_walked_once():
    assert Condition("pd", PD).one_draw_is_all
    assert not Condition("pd", replace(PD, spread=0.1)).one_draw_is_all
    assert not Condition("pd", PD, ROBUST).one_draw_is_all
    assert Condition("mean", MotorChoice("prior", latent_spread=0.0)).one_draw_is_all
    assert not Condition("prior", MotorChoice("prior")).one_draw_is_all
    assert not Condition("oracle", MotorChoice("fleet")).one_draw_is_all


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seeds": 0}, "seeds"),
        ({"seeds": 901}, "seeds"),
        ({"draws": 0}, "draws"),
        ({"seconds": 1.0}, "seconds"),
        ({"motors": 3}, "motors"),
        ({"speed": 0.1}, "speed"),
        ({"speed": np.nan}, "speed"),
        ({"spread": 0.95}, "spread"),
        ({"latent_spread": -0.1}, "latent_spread"),
        ({"latent_spread": np.nan}, "latent_spread"),
        ({"latent_spread": 1e3}, "latent_spread"),
        ({"ray_address": "127.0.0.1:1"}, "ray_address is for the executor ray"),
        ({"executor": "fog"}, "executor 'fog' is unknown"),
        ({"validation": "foreign_direct"}, "validation 'foreign_direct' is the fleet of a twin"),
        ({"foreign": "pupper_v2"}, "foreign 'pupper_v2' has the motors of the bench's fleet"),
    ],
)
def test_impossible_studies_are_refused(tmp_path: Path, change: dict, words: str):
    with pytest.raises(ConfigError, match=words):
        replace(Study(tmp_path), **change).sized()
    assert not any(tmp_path.iterdir())


def test_a_study_trains_for_what_it_tells():
    for study, speed in ((Study(Path("x")), 0.75), (Study(Path("x"), speed=0.6), 0.6)):
        assert study.told(PUPPER_V2) == speed
        commands = study.commands(PUPPER_V2)
        np.testing.assert_array_equal(commands.schedule(PUPPER_V2, 3, 50), np.tile([speed, 0.0], (50, 1)))
        assert commands.on(PUPPER_V2).require_legs().forward[1] == speed


def test_a_study_varies_its_rival_by_what_it_is_told(tmp_path: Path):
    fitted = {"kp": 8.0, "kd": 0.8, "torque_limit": 1.5, "armature": 0.003, "delay": 0.004, "coulomb": 0.2}
    write_json(tmp_path / "fits" / FITS, {PD_FRICTION: {"constants": fitted}})
    told = Study(tmp_path, conditions=(PD_RANDOMISED,), spread=0.15)
    (condition,) = conditions(told, 0)
    assert condition.motors.spread == 0.15 and condition.motors.coulomb == 0.2


def test_a_rival_without_a_width_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match="width of the randomised PD is not known"):
        conditions(Study(tmp_path, conditions=(PD_RANDOMISED,)), 0)


def test_a_study_spreads_z_by_what_it_is_told_and_keeps_the_mean_motor(tmp_path: Path):
    told = Study(tmp_path, conditions=(SAMPLED, ROBUST_PRIOR, PRIOR_MEAN), latent_spread=0.75)
    spreads = {condition.name: condition.motors.latent_spread for condition in conditions(told, 0)}
    assert spreads == {SAMPLED: 0.75, ROBUST_PRIOR: 0.75, PRIOR_MEAN: 0.0}


def test_a_spread_is_chosen_only_where_there_is_none_and_a_condition_to_have_it(tmp_path: Path):
    for told in (
        Study(tmp_path, spread=0.2, conditions=(PD_RANDOMISED, ADAPTED)),
        Study(tmp_path, conditions=(SAMPLED, ROBUST_PRIOR, PD_FRICTION)),
        Study(tmp_path, quick=True),
    ):
        assert with_spread(told.sized()) == told.sized()
    quick, full = Study(tmp_path, quick=True).sized(), Study(tmp_path).sized()
    assert quick.spread == 0.2 and full.spread is None


def test_the_width_whose_policies_stand_longest_is_kept_the_faster_of_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    fitted = {"kp": 8.0, "kd": 0.8, "torque_limit": 1.5, "armature": 0.003, "delay": 0.004, "coulomb": 0.2}
    write_json(tmp_path / "fits" / FITS, {PD_FRICTION: {"constants": fitted}})
    walked = {
        "pd_randomised_0.1": (0.9, 0.7), "pd_randomised_0.2": (0.95, 0.5),
        "pd_randomised_0.3": (0.95, 0.6), "pd_randomised_0.4": (0.2, 0.8),
    }  # fmt: skip
    trained: list[tuple[Condition, int]] = []

    def scores(place: str, condition: str, measure: str) -> np.ndarray:
        return np.full((3, 4), walked[condition][measure == "speed"])

    def walk_table(config: Study, cells: list[tuple[Condition, int]], progress: object) -> Any:
        trained.extend(cells)
        return SimpleNamespace(scores=scores)

    monkeypatch.setattr(study_spreads, "walk_table", walk_table)
    told = Study(tmp_path, conditions=(PD_RANDOMISED,), validation="mixed").sized()
    assert with_spread(told) == replace(told, spread=0.3)
    assert [condition.motors.spread for condition, seed in trained if seed == 900] == [0.1, 0.2, 0.3, 0.4]
    assert {condition.twins for condition, _ in trained} == {(ABROAD,)}
    assert read_json(tmp_path / "spreads" / "spreads.json")["chosen"] == 0.3


@pytest.mark.parametrize(
    ("change", "fleet"),
    [
        ({}, "mixed"),
        ({"foreign": "mixed"}, "foreign_servo"),
        ({"fleet": "mixed", "foreign": "foreign_servo"}, "foreign_direct"),
        ({"validation": "foreign_servo"}, "foreign_servo"),
    ],
)
def test_width_and_policies_are_chosen_on_a_fleet_that_no_twin_has(tmp_path: Path, change: dict, fleet: str):
    told = replace(Study(tmp_path), **change).sized()
    assert told.fleet_for_width(PUPPER_V2) == told.fleet_of_contests(PUPPER_V2) == fleet


def test_the_motors_of_training_choose_policies_if_they_are_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    told = Study(tmp_path, validation=OWN_MOTORS).sized()
    assert told.fleet_of_contests(PUPPER_V2) is None and told.fleet_for_width(PUPPER_V2) == "mixed"
    monkeypatch.setattr(study_settings, "_FLEETS", ("foreign_direct",))  # a twin's
    assert Study(tmp_path).fleet_of_contests(PUPPER_V2) is None
    with pytest.raises(ConfigError, match="that no twin has, and none is known"):
        Study(tmp_path).sized()


def test_a_quick_study_is_small():
    full, quick = Study(Path("x")).sized(), Study(Path("x"), quick=True).sized()
    assert quick.seeds < full.seeds and quick.draws < full.draws and quick.iterations < full.iterations


def test_a_quick_study_keeps_what_is_given():
    given = Study(Path("x"), quick=True, seeds=5, draws=16).sized()
    assert (given.seeds, given.draws) == (5, 16) and given.iterations < Study.iterations
    with pytest.raises(ConfigError, match="adam_steps"):
        Study(Path("x"), adam_steps=0).sized()


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        (MotorChoice("prior", spread=0.1), "spread 0.1 has no effect on actuator prior"),
        (MotorChoice("fleet", kp=8.0), "kp 8 has no effect on actuator fleet"),
        (MotorChoice("pd", latent_spread=0.5), "latent_spread 0.5 has no effect on actuator pd"),
        (MotorChoice("prior", posterior=Path("p"), latent_spread=0.5), "with a posterior"),
        (MotorChoice("prior", limit_follows_gain=True), "limit_follows_gain 1 has no effect on actuator prior"),
    ],
)
def test_numbers_without_effect_are_refused(choice: MotorChoice, words: str):
    with pytest.raises(ConfigError, match=words):
        drawn(choice)


def test_motors_that_differ_have_names_that_differ():
    choices = [
        MotorChoice("pd"), MotorChoice("pd", armature=0.003), PD, replace(PD, spread=0.3), MotorChoice("fleet"),
        MotorChoice("prior"), MotorChoice("prior", latent_spread=0.0), MotorChoice("prior", latent_spread=1.5),
    ]  # fmt: skip
    assert len({choice.condition() for choice in choices}) == len(choices)
