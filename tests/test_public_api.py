"""`import motorprior as mp`: the names, their documentation, that nothing heavy comes early, and the whole chain."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.

import ast
import json
import subprocess
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path

import mujoco
import numpy as np
import pytest

import motorprior as mp

HEAVY = ("jax", "optax", "numba", "mujoco", "gymnasium", "scipy", "pyarrow", "matplotlib", "ray")
LIGHT = (
    *("Lines", "MotorLog", "Robot", "load_robot", "load_log", "read_log", "write_log", "check_log"),
    *("MotorPriorError", "LogError", "ArtifactError", "ConfigError", "SimulationFault"),
)
ROBOT = mp.load_robot("pupper_v2")


def test_importing_brings_nothing_heavy_and_light_names_stay_light():
    code = f"""if True:
        import json, sys
        import motorprior
        heavy = lambda: [name for name in {HEAVY} if name in sys.modules]
        found = {{"motorprior": heavy(), "modules": [n for n in sys.modules if n.startswith("motorprior.")]}}
        for name in {LIGHT}:
            getattr(motorprior, name)
            found[name] = heavy()
        print(json.dumps(found))
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found == {name: [] for name in ("motorprior", "modules", *LIGHT)}


@pytest.mark.parametrize(("name", "max_modules"), [("read_log", 40), ("fit_prior", 70)])
def test_a_name_loads_few_modules_of_the_package(name: str, max_modules: int):
    count = "print(sum('motorprior' in module for module in sys.modules))"
    code = f"import sys, motorprior as mp; mp.{name}; {count}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 10 < int(done.stdout) <= max_modules


def test_public_names_are_those_that_a_type_checker_sees():
    imported = {
        alias.name: statement.module
        for statement in ast.walk(ast.parse(Path(mp.__file__).read_text("utf-8")))
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
        if alias.name == alias.asname
    }
    assert imported == mp._MODULES


def test_every_public_name_is_there():
    assert dir(mp) == sorted(set(mp.__all__))
    assert all(getattr(mp, name) is not None for name in dir(mp))


@pytest.fixture(scope="module")
def log() -> mp.MotorLog:
    return mp.record_bench(ROBOT, motors=3, steps=300, preset="paper")


@pytest.fixture(scope="module")
def prior(log: mp.MotorLog) -> mp.MotorPrior:
    return mp.fit_prior(log, "paper", steps=2)


def test_logs_of_the_same_motors_and_of_others_are_joined(log: mp.MotorLog):
    assert (
        len(mp.fit_prior([log, replace(log, joint_names=("a", "b", "c"))], "paper", steps=1).mean)
        == 6
    )
    again = mp.fit_prior([log, log], "paper", steps=1)
    assert len(again.mean) == 3 and again.metrics.minutes_of_log == pytest.approx(2 * 3 * 2.99 / 60)
    for logs in (
        [],
        [log, replace(log, joint_names=("motor_000", "b", "c"))],
        [log, replace(log, robot="other")],
    ):
        with pytest.raises(mp.LogError):
            mp.fit_prior(logs, "paper", steps=1)


HINGE = '<mujoco><worldbody><body><joint name="hinge"/><geom size="0.02" pos="0.05 0 0"/></body></worldbody></mujoco>'


def driven_to(
    target: float, steps: int, model: mujoco.MjModel, data: mujoco.MjData, driven: mp.DrivenJoints
) -> list:
    found = []
    for _ in range(steps):
        found.append(float(driven.drive(np.full(1, target))[0]))
        mujoco.mj_step(model, data)
    return found


def test_motors_reset_with_the_simulation_that_they_drive(prior: mp.MotorPrior):
    motors = prior.sample(1, seed=3)
    model = mujoco.MjModel.from_xml_string(HINGE)
    data = mujoco.MjData(model)
    driven = mp.DrivenJoints(model, data, motors, ["hinge"])
    first = driven_to(0.3, 20, model, data, driven)
    assert data.qpos[0] != 0.0
    mujoco.mj_resetData(model, data)
    assert driven_to(0.3, 20, model, data, driven) == first
    mujoco.mj_resetData(model, data)
    assert driven_to(0.3, 1, model, data, driven) == first[:1], "after an episode of one step"
    data.qpos[0] = data.qvel[0] = data.qacc_warmstart[0] = 0.0
    driven.reset()
    assert driven_to(0.3, 20, model, data, driven) == pytest.approx(first)


def test_adapt_warns_of_motors_that_did_not_move():
    log = mp.record_bench(ROBOT, motors=3, steps=600, preset="rollout")
    still = replace(log, joint_pos=log.joint_pos * [1.0, 0.0, 1.0])
    notes = StringIO()
    prior = mp.fit_prior(log, "pace")
    with pytest.warns(UserWarning, match="motor_001"):
        mp.adapt(prior, still, allow_outliers=True)
    assert mp.adapt(prior, still, allow_outliers=True, progress=mp.Lines(notes)).mean.shape[0] == 3
    assert "warning" in notes.getvalue() and "motor_001" in notes.getvalue()


def test_motors_walk_in_environments_and_train_policies(prior: mp.MotorPrior):
    env = mp.make_env(ROBOT, motors=prior, episode_steps=3)
    observation, _ = env.reset(seed=0)
    assert observation.shape == env.observation_space.shape
    fleet = mp.load_fleet("pupper_v2")
    policies = [
        mp.train_policy(ROBOT, motors, iterations=1, seed=0, workers=1, episode_steps=5)
        for motors in (prior, fleet)
    ]
    again = mp.train_policy("pupper_v2", prior, iterations=1, seed=0, workers=2, episode_steps=5)
    np.testing.assert_array_equal(again.arrays.weights, policies[0].arrays.weights)
    further = mp.train_policy(ROBOT, prior, iterations=1, workers=1, episode_steps=5, start=again)
    assert further.provenance["best_return"] >= again.provenance["best_return"]
    rows = mp.compare(ROBOT, {"prior": policies[0], "oracle": policies}, {"twin": fleet})
    table = {(row.quantity, row.model, row.seed): (row.unit, row.value) for row in rows}
    assert len(table) == len(rows) == 9 and {row.motors for row in rows} == {"twin"}
    assert (
        table["speed", "prior", 0] == table["speed", "oracle", 0]
        and table["drift", "oracle", 1][0] == "m"
    )
