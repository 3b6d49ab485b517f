"""`import motorprior as mp`: the names, their documentation, that nothing heavy comes early, and the whole chain."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import motorprior as mp
from motorprior.locomotion.command import Commands

HEAVY = ("jax", "optax", "numba", "mujoco", "gymnasium", "scipy", "pyarrow", "matplotlib", "ray")
LIGHT = (
    *("Lines", "MotorLog", "Robot", "load_robot", "read_log", "write_log", "check_log"),
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


def test_all_type_checkers_see_every_name_where_it_is():
    tree = ast.parse(Path(mp.__file__).read_text("utf-8"))
    block = next(n for n in tree.body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    seen = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname == alias.name  # the form that exports
    }
    assert seen == {name: f"motorprior.{module}" for name, module in mp._MODULES.items()}
    assert len(set(mp.__all__)) == len(mp.__all__) == len(seen) + 1
    assert dir(mp) == sorted(mp.__all__) and len(mp.__all__) <= 30


def test_an_unknown_name_is_refused_with_those_that_are_close():
    with pytest.raises(AttributeError, match="no attribute 'fit_priors'; did you mean fit_prior"):
        getattr(mp, "fit_priors")  # noqa: B009
    with pytest.raises(AttributeError, match=r"no attribute 'zzz'$"):
        getattr(mp, "zzz")  # noqa: B009
    with pytest.raises(ImportError, match="load_robots"):
        exec("from motorprior import load_robots")


@pytest.fixture(scope="module")
def log() -> mp.MotorLog:
    return mp.record_bench(ROBOT, motors=3, steps=300, preset="paper")


@pytest.fixture(scope="module")
def prior(log: mp.MotorLog) -> mp.MotorPrior:
    return mp.fit_prior(log, "paper", steps=2)


def test_a_bench_is_that_of_the_stage(log: mp.MotorLog, tmp_path: Path):
    from motorprior.pipeline.bench import Bench, run_bench

    run_bench(Bench(tmp_path, preset="paper", motors=3, steps=300))
    stage = mp.read_log(tmp_path / "log.parquet")
    np.testing.assert_array_equal(stage.joint_pos, log.joint_pos)
    fleet = mp.load_fleet("pupper_v2")
    np.testing.assert_array_equal(mp.record_bench(ROBOT, fleet, motors=3, steps=300, preset="paper").time, log.time)
    with pytest.raises(mp.ConfigError, match="of robot 'other'"):
        mp.record_bench(ROBOT, replace(fleet, robot="other"))


class Notes(mp.Lines):
    """What is reported: begun, and noted."""

    def __init__(self):
        super().__init__(sys.stderr)
        self.started: list[str] = []
        self.noted: list[str] = []

    def start(self, name: str, total: int):
        self.started.append(name)
        return super().start(name, total)

    def note(self, text: str) -> None:
        self.noted.append(text)


def test_logs_of_the_same_motors_and_of_others_are_joined(log: mp.MotorLog):
    both = mp.fit_prior([log, replace(log, joint_names=("a", "b", "c"))], "paper", steps=1)
    assert len(both.mean) == 6
    again = mp.fit_prior([log, log], "paper", steps=1)
    assert len(again.mean) == 3 and again.metrics["minutes_of_log"] == pytest.approx(2 * 3 * 2.99 / 60)
    overlapping = replace(log, joint_names=("motor_000", "b", "c"))
    for logs, word in (
        ([], "no log"),
        ([log, overlapping], "share some joints"),
        ([log, replace(log, robot="other")], "robot"),
        ([log, replace(log, joint_torque=None)], "joint_torque"),
        (
            [log, replace(log.rows(slice(0, 250)), joint_names=("a", "b", "c"), segment=np.arange(250) // 125)],
            "segments",
        ),
    ):
        with pytest.raises(mp.LogError, match=word):
            mp.fit_prior(logs, "paper", steps=1)


def test_a_prior_becomes_motors_of_a_model_of_ones_own(prior: mp.MotorPrior, tmp_path: Path):
    prior.save(tmp_path / "prior.safetensors")
    motors = mp.MotorPrior.load(tmp_path / "prior.safetensors").sample(1, seed=3)
    free = mp.Motors(motors, dt=0.002, joint_pos=np.zeros(1))
    torque, damping = free.step(np.full(1, 0.1), np.zeros(1), np.zeros(1))
    assert torque.shape == damping.shape == free.armature.shape == (1,)
    text = '<body><joint name="hinge"/><geom size="0.02" pos="0.05 0 0"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    driven = mp.DrivenJoints(model, data, motors, ["hinge"])
    for _ in range(10):
        driven.drive(np.full(1, 0.3))
        mujoco.mj_step(model, data)
    assert data.qpos[0] != 0.0


def hinge_model(timestep: float = 0.002) -> mujoco.MjModel:
    body = '<body><joint name="hinge"/><geom size="0.02" pos="0.05 0 0"/></body>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{timestep}"/><worldbody>{body}</worldbody></mujoco>'
    )


def driven_to(target: float, steps: int, model: mujoco.MjModel, data: mujoco.MjData, driven: mp.DrivenJoints) -> list:
    found = []
    for _ in range(steps):
        found.append(float(driven.drive(np.full(1, target))[0]))
        mujoco.mj_step(model, data)
    return found


def test_motors_begin_again_where_the_simulation_does(prior: mp.MotorPrior):
    """Nothing of what a motor remembers is left after mj_resetData."""
    motors, model = prior.sample(1, seed=3), hinge_model()
    data = mujoco.MjData(model)
    driven = mp.DrivenJoints(model, data, motors, ["hinge"])
    first = driven_to(0.3, 20, model, data, driven)
    mujoco.mj_resetData(model, data)
    assert driven_to(0.3, 20, model, data, driven) == first
    for _ in range(3):  # episodes of one step
        mujoco.mj_resetData(model, data)
        assert driven_to(0.3, 1, model, data, driven) == first[:1]
    data.qpos[0] = data.qvel[0] = 0.0
    driven.reset()
    data.qacc_warmstart[:] = 0.0
    assert driven_to(0.3, 20, model, data, driven) == pytest.approx(first)


def test_every_public_name_is_there():
    assert all(getattr(mp, name) is not None for name in dir(mp))


def test_a_grey_box_that_was_never_written_adapts_and_tells_of_weak_motors(monkeypatch: pytest.MonkeyPatch):
    log, notes = mp.record_bench(ROBOT, motors=3, steps=600, preset="rollout"), Notes()
    prior = mp.fit_prior(log, "pace")
    still = replace(log, joint_pos=log.joint_pos * [1.0, 0.0, 1.0])
    mp.adapt(prior, still, anyway=True, progress=notes)
    assert any("did not move: motor_001; what" in note for note in notes.noted)
    with pytest.warns(UserWarning, match="^did not move: motor_001; what"):  # nobody listens to notes
        mp.adapt(prior, still, anyway=True)
    assert any(note.startswith("replayed logs: ") for note in notes.noted)
    monkeypatch.setattr("motorprior.pipeline.weak_motors.weak_below", lambda network: (99.0, 0.85))
    mp.adapt(prior, log, anyway=True, progress=notes)
    assert any("weak motors" in note and "limit_follows_gain" in note for note in notes.noted)


def test_motors_walk_in_environments_and_train_policies(prior: mp.MotorPrior):
    env = mp.make_env(ROBOT, motors=prior, episode_steps=3)
    observation, _ = env.reset(seed=0)
    assert observation.shape == env.observation_space.shape
    many = mp.make_vector_env(ROBOT, prior, num_envs=2)
    assert many.reset(seed=0)[0].shape == (2, *observation.shape)
    many.close()
    fleet = mp.load_fleet("pupper_v2")
    policies = [
        mp.train_policy(ROBOT, motors, iterations=1, seed=0, workers=1, episode_steps=5) for motors in (prior, fleet)
    ]
    again = mp.train_policy("pupper_v2", prior, iterations=1, seed=0, workers=2, episode_steps=5)
    np.testing.assert_array_equal(again.weights, policies[0].weights)
    further = mp.train_policy(ROBOT, prior, iterations=1, workers=1, episode_steps=5, start=again)
    assert further.provenance["own_return"] >= again.provenance["own_return"]
    rows = mp.compare(ROBOT, {"prior": policies[0], "oracle": policies}, {"twin": fleet})
    table = {(row.quantity, row.model, row.seed): (row.unit, row.value) for row in rows}
    assert len(table) == len(rows) == 9 and {row.motors for row in rows} == {"twin"}
    assert table["speed", "prior", 0] == table["speed", "oracle", 0] and table["drift", "oracle", 1][0] == "m"
    short: dict[str, Any] = {"iterations": 1, "workers": 1, "episode_steps": 5}
    fast = mp.train_policy(ROBOT, prior, commands=Commands((0.0, 0.8)), **short)
    assert mp.train_policy(ROBOT, prior, start=fast, **short).forward == fast.forward == (-0.2, 0.8)
    beside = mp.compare(ROBOT, {"prior": policies[0], "fast": fast}, {"twin": fleet}).where(model="prior")
    assert beside.value(quantity="speed") == table["speed", "prior", 0][1], "both are told what the slower one may be"


def test_a_function_may_draw_physical_motors():
    fleet = mp.load_fleet("pupper_v2")
    found = mp.simulate(ROBOT, lambda rng: fleet.sample(12, rng).actuator(), np.tile(ROBOT.nominal_pose, (5, 1)))
    assert np.all(np.isfinite(found.joint_pos))
    with pytest.raises(mp.ConfigError, match="workers 0"):
        mp.train_policy(ROBOT, prior, workers=0)
