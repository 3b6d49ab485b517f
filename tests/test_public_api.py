"""`import motorprior as mp`: a light import, the public names, and the chain from log to policy."""

import ast
import inspect
import json
import re
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


def test_public_docstrings_name_no_constants_of_the_code():
    for name in mp.__all__:
        value = getattr(mp, name)
        members = vars(value).values() if inspect.isclass(value) else ()
        for documented in (value, *members):
            text = "" if isinstance(documented, str) else inspect.getdoc(documented) or ""
            # such as MAX_RATIO; a reader of the reference cannot look it up
            assert not re.search(r"\b[A-Z]{2,}_[A-Z_]+\b", text), (name, text)
            assert not text.startswith("See "), (name, text)


def test_the_import_of_the_package_and_of_light_names_loads_no_heavy_library():
    code = f"""if True:
        import json, sys
        import motorprior

        def heavy():
            return [name for name in {HEAVY} if name in sys.modules]

        loaded = {{"motorprior": heavy()}}
        loaded["modules"] = [name for name in sys.modules if name.startswith("motorprior.")]
        for name in {LIGHT}:
            getattr(motorprior, name)
            loaded[name] = heavy()
        print(json.dumps(loaded))
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = json.loads(done.stdout)

    assert loaded == {name: [] for name in ("motorprior", "modules", *LIGHT)}


@pytest.mark.parametrize(("name", "max_modules"), [("read_log", 40), ("fit_prior", 90)])
def test_a_name_loads_few_modules_of_the_package(name: str, max_modules: int):
    count = "print(sum('motorprior' in module for module in sys.modules))"
    code = f"import sys, motorprior as mp; mp.{name}; {count}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert 10 < int(done.stdout) <= max_modules


def test_the_names_that_a_type_checker_sees_are_the_public_names():
    tree = ast.parse(Path(mp.__file__).read_text("utf-8"))
    module_of_name = {}
    for statement in ast.walk(tree):
        if isinstance(statement, ast.ImportFrom):
            for alias in statement.names:
                if alias.name == alias.asname:
                    module_of_name[alias.name] = statement.module

    assert module_of_name == mp._MODULES


def test_every_public_name_can_be_loaded():
    assert dir(mp) == sorted(set(mp.__all__))
    assert all(getattr(mp, name) is not None for name in dir(mp))


@pytest.fixture(scope="module")
def log() -> mp.MotorLog:
    return mp.record_bench(ROBOT, motors=3, steps=300, preset="paper")


@pytest.fixture(scope="module")
def prior(log: mp.MotorLog) -> mp.MotorPrior:
    return mp.fit_prior(log, "paper", steps=2)


def test_logs_of_the_same_motors_and_of_others_are_joined(log: mp.MotorLog):
    of_other_motors = replace(log, joint_names=("a", "b", "c"))
    prior = mp.fit_prior([log, of_other_motors], "paper", steps=1)

    assert len(prior.mean) == 6

    prior = mp.fit_prior([log, log], "paper", steps=1)

    assert len(prior.mean) == 3
    # two logs of three motors, 2.99 s each
    assert prior.metrics.minutes_of_log == pytest.approx(2 * 3 * 2.99 / 60)


def test_logs_that_share_some_motors_or_no_robot_and_an_empty_list_are_refused(log: mp.MotorLog):
    sharing_one_motor = replace(log, joint_names=("motor_000", "b", "c"))
    of_another_robot = replace(log, robot="other")

    for logs in ([], [log, sharing_one_motor], [log, of_another_robot]):
        with pytest.raises(mp.LogError):
            mp.fit_prior(logs, "paper", steps=1)


HINGE = (
    '<mujoco><worldbody><body><joint name="hinge"/><geom size="0.02" pos="0.05 0 0"/></body>'
    "</worldbody></mujoco>"
)


def driven_to(
    target: float, steps: int, model: mujoco.MjModel, data: mujoco.MjData, driven: mp.DrivenJoints
) -> list:
    """Torques [N·m] of the motor while it moves the hinge to the target [rad]."""
    torques = []
    for _ in range(steps):
        torque = driven.drive(np.full(1, target))
        torques.append(float(torque[0]))
        mujoco.mj_step(model, data)

    return torques


def test_motors_reset_with_the_simulation_that_they_drive(prior: mp.MotorPrior):
    motors = prior.sample(1, seed=3)
    model = mujoco.MjModel.from_xml_string(HINGE)
    data = mujoco.MjData(model)
    driven = mp.DrivenJoints(model, data, motors, ["hinge"])
    torques = driven_to(0.3, 20, model, data, driven)

    assert data.qpos[0] != 0.0

    mujoco.mj_resetData(model, data)

    assert driven_to(0.3, 20, model, data, driven) == torques

    mujoco.mj_resetData(model, data)

    assert driven_to(0.3, 1, model, data, driven) == torques[:1], "after an episode of one step"

    data.qpos[0] = data.qvel[0] = data.qacc_warmstart[0] = 0.0
    driven.reset()

    assert driven_to(0.3, 20, model, data, driven) == pytest.approx(torques)


def test_adapt_warns_of_a_motor_that_did_not_move():
    log = mp.record_bench(ROBOT, motors=3, steps=600, preset="rollout")
    still = replace(log, joint_pos=log.joint_pos * [1.0, 0.0, 1.0])
    notes = StringIO()
    prior = mp.fit_prior(log, "pace")

    with pytest.warns(UserWarning, match="motor_001"):
        mp.adapt(prior, still, allow_outliers=True)
    assert mp.adapt(prior, still, allow_outliers=True, progress=mp.Lines(notes)).mean.shape[0] == 3
    assert "warning" in notes.getvalue()
    assert "motor_001" in notes.getvalue()


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
    values = {(row.quantity, row.model, row.seed): (row.unit, row.value) for row in rows}

    assert len(values) == len(rows) == 9
    assert {row.motors for row in rows} == {"twin"}
    assert values["speed", "prior", 0] == values["speed", "oracle", 0]
    assert values["drift", "oracle", 1][0] == "m"
