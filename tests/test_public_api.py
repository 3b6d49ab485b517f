"""`import motorprior as mp`: the names, their documentation, that nothing heavy comes early, and the whole chain."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.

import ast
import inspect
import json
import subprocess
import sys
from contextlib import nullcontext
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
NAMES = [name for name in mp.__all__ if name != "__version__"]
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


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_is_documented(name: str):
    thing = getattr(mp, name)
    text = inspect.getdoc(thing)
    assert text and not text.startswith(f"{name}("), "a docstring of its own, not the one that dataclass makes"
    if inspect.isfunction(thing):
        assert_described(thing, text)
        return
    for method, function in vars(thing).items():
        function = getattr(function, "__func__", function)
        if inspect.isfunction(function) and not method.startswith("_"):
            assert inspect.getdoc(function), f"{name}.{method}"


def assert_described(function, text: str) -> None:
    parameters = list(inspect.signature(function).parameters)
    arguments = text.partition("Args:")[2].partition("\n\n")[0]
    assert [each for each in parameters if f"    {each}: " not in arguments] == []
    assert "Raises:" in text
    assert inspect.signature(function).return_annotation in (None, "None") or "Returns:" in text


@pytest.fixture(scope="module")
def log() -> mp.MotorLog:
    return mp.record_bench(ROBOT, motors=3, steps=300, preset="paper")


@pytest.fixture(scope="module")
def prior(log: mp.MotorLog) -> mp.MotorPrior:
    return mp.fit_prior(log, "paper", steps=2)


def test_a_log_is_written_read_and_checked(log: mp.MotorLog, tmp_path: Path):
    mp.write_log(tmp_path / "log.parquet", log)
    read = mp.read_log(tmp_path / "log.parquet")
    np.testing.assert_array_equal(read.joint_pos, log.joint_pos)
    assert mp.check_log(read).usable and read.robot == ROBOT.name


def test_a_bench_is_that_of_the_stage(log: mp.MotorLog, tmp_path: Path):
    from motorprior.pipeline.bench import Bench, run_bench

    run_bench(Bench(tmp_path, preset="paper", motors=3, steps=300))
    stage = mp.read_log(tmp_path / "log.parquet")
    np.testing.assert_array_equal(stage.joint_pos, log.joint_pos)
    fleet = mp.load_fleet("pupper_v2")
    np.testing.assert_array_equal(mp.record_bench(ROBOT, fleet, motors=3, steps=300, preset="paper").time, log.time)
    with pytest.raises(mp.ConfigError, match="of robot 'other'"):
        mp.record_bench(ROBOT, replace(fleet, robot="other"))


def test_a_prior_is_that_of_the_stage_and_the_folder_keeps_it(log, tmp_path: Path):
    from motorprior.pipeline.identify import Identify, run_identify

    log = replace(log, robot="own")
    prior = mp.fit_prior(log, "paper", steps=2)
    mp.write_log(tmp_path / "log.parquet", log)
    run_identify(Identify(tmp_path / "log.parquet", tmp_path / "stage", "paper", steps=2))
    assert (tmp_path / "stage" / "prior.safetensors").read_bytes()
    assert mp.MotorPrior.load(tmp_path / "stage" / "prior.safetensors").sha256() == prior.sha256()
    lines = Notes()
    kept = [mp.fit_prior(log, "paper", steps=2, out=tmp_path / "kept", progress=lines).sha256() for _ in range(2)]
    assert kept == 2 * [prior.sha256()] and lines.started == ["identify paper"], "once"
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == ["prior.safetensors", "stage.json"]
    changed = replace(log, joint_pos=log.joint_pos + 1e-3)
    assert mp.fit_prior(changed, "paper", steps=2, out=tmp_path / "kept").sha256() != prior.sha256(), "another log"


def test_several_files_are_one_log(log: mp.MotorLog, tmp_path: Path):
    from motorprior.pipeline.identify import Identify, run_identify

    files = tuple(tmp_path / f"{name}.parquet" for name in ("first", "second"))
    for file, rows in zip(files, (slice(0, 150), slice(150, 300)), strict=True):
        mp.write_log(file, replace(log.rows(rows), robot="own"))
    run_identify(Identify(files, tmp_path / "stage", "paper", steps=2))
    both = mp.fit_prior([mp.read_log(file) for file in files], "paper", steps=2)
    assert mp.MotorPrior.load(tmp_path / "stage" / "prior.safetensors").sha256() == both.sha256()
    with pytest.raises(mp.ConfigError, match="not a motor log"):
        run_identify(Identify((files[0], tmp_path), tmp_path / "other", "paper", steps=2))
    with pytest.raises(mp.ConfigError, match="no log given"):
        run_identify(Identify((), tmp_path / "other", "paper", steps=2))


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


def test_what_cannot_be_fitted_is_refused(log: mp.MotorLog):
    with pytest.raises(mp.ConfigError, match="read them with read_log"):
        mp.fit_prior("log.parquet")  # pyright: ignore[reportArgumentType]
    with pytest.raises(mp.ConfigError, match="no identification preset 'rolout'"):
        mp.fit_prior(log, "rolout")
    with pytest.raises(mp.LogError, match=r"period 0\.01 s"):
        mp.fit_prior(log, "rollout")
    with pytest.raises(mp.ConfigError, match="steps 0"):
        mp.fit_prior(log, "paper", steps=0)


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


@pytest.mark.parametrize(("integrator", "taken"), [("implicit", True), ("implicitfast", True), ("RK4", False)])
def test_driven_joints_need_an_integrator_that_damps_implicitly(prior: mp.MotorPrior, integrator: str, taken: bool):
    model = hinge_model()
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    with nullcontext() if taken else pytest.raises(mp.ConfigError, match="does not damp its joints implicitly"):
        mp.DrivenJoints(model, mujoco.MjData(model), prior.sample(1, seed=3), ["hinge"])


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


def test_driven_joints_refuse_what_would_be_wrong_silently(prior: mp.MotorPrior):
    motors, model = prior.sample(2, seed=3), hinge_model()
    data = mujoco.MjData(model)
    with pytest.raises(mp.ConfigError, match="'hinge' is named twice"):
        mp.DrivenJoints(model, data, motors, ["hinge", "hinge"])
    driven = mp.DrivenJoints(model, data, prior.sample(1, seed=3), ["hinge"])
    model.opt.timestep = 0.001
    with pytest.raises(mp.ConfigError, match=r"timestep is 0\.001 s, the motors' 0\.002 s"):
        driven.drive(np.zeros(1))
    with pytest.raises(mp.ConfigError, match="MotorPrior is no set of motors -> draw some"):
        mp.Motors(prior, 0.002, np.zeros(1))  # pyright: ignore[reportArgumentType]
    for spread in (np.nan, -1.0):
        with pytest.raises(mp.ConfigError, match="spread"):
            prior.sample(1, seed=3, spread=spread)


def test_a_log_of_another_robot_is_not_adapted_to(prior: mp.MotorPrior):
    log = replace(mp.record_bench(ROBOT, motors=2, steps=200, preset="paper", seed=5), robot="spot")
    with pytest.raises(mp.ConfigError, match="the prior is of robot 'pupper_v2', the log of 'spot'"):
        mp.adapt(prior, log, anyway=True)


def test_motors_with_names_of_no_joint_are_not_put_on_a_robot_by_their_places(prior: mp.MotorPrior):
    log = mp.record_bench(ROBOT, motors=ROBOT.num_joints, steps=200, preset="paper", seed=5)
    posterior = mp.adapt(prior, log, anyway=True)
    others = replace(posterior, joint_names=tuple(f"leg_{index}" for index in range(ROBOT.num_joints)))
    with pytest.raises(mp.ConfigError, match="are not pupper_v2's"):
        mp.simulate(ROBOT, others, np.tile(ROBOT.nominal_pose, (3, 1)), hung=True)


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


def test_adapted_motors_need_nothing_else(prior: mp.MotorPrior, tmp_path: Path):
    new = mp.record_bench(ROBOT, motors=ROBOT.num_joints, steps=200, preset="paper", seed=5)
    posterior = mp.adapt(prior, new, anyway=True)
    motors = posterior.sample(ROBOT.num_joints, seed=1)
    assert motors.z.shape == posterior.mean.shape == (ROBOT.num_joints, prior.network.num_latents)
    posterior.save(tmp_path / "posterior.safetensors")
    again = mp.MotorPosterior.load(tmp_path / "posterior.safetensors", prior).sample(ROBOT.num_joints, seed=1)
    np.testing.assert_array_equal(again.z, motors.z)
    joints = mp.simulate(ROBOT, posterior, np.tile(ROBOT.nominal_pose, (3, 1)), hung=True).joint_pos
    assert joints.shape[1] == ROBOT.num_joints and np.isfinite(joints).all()
    with pytest.raises(mp.LogError, match="period"):
        mp.adapt(prior, mp.record_bench(ROBOT, motors=1, steps=400), anyway=True)


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


def test_what_does_not_fit_a_robot_is_refused(prior: mp.MotorPrior):
    with pytest.raises(mp.ConfigError, match="robot 'other'"):
        mp.train_policy(ROBOT, replace(prior, robot="other"), iterations=1)
    with pytest.raises(mp.ConfigError, match="3 for the 12 joints"):
        mp.simulate(ROBOT, prior.sample(3, seed=0), np.zeros((1, ROBOT.num_joints)))
    with pytest.raises(mp.ConfigError, match="targets"):
        mp.simulate(ROBOT, prior, np.zeros((1, 3)))
    with pytest.raises(mp.ConfigError, match="no policies given"):
        mp.compare(ROBOT, {}, {"twin": prior})
    fleet = mp.load_fleet("pupper_v2")
    for wrong, words in (
        (lambda rng: mp.IdealPd.uniform(1, 7.0, 0.8, 1.3), "1 for the 12 joints"),
        (lambda rng: fleet.sample(12, rng), "set of motors or function that draws one"),
    ):
        with pytest.raises(mp.ConfigError, match=words):
            mp.train_policy(ROBOT, wrong, iterations=1)  # pyright: ignore[reportArgumentType]


def test_a_function_may_draw_physical_motors():
    fleet = mp.load_fleet("pupper_v2")
    found = mp.simulate(ROBOT, lambda rng: fleet.sample(12, rng).actuator(), np.tile(ROBOT.nominal_pose, (5, 1)))
    assert np.all(np.isfinite(found.joint_pos))
    with pytest.raises(mp.ConfigError, match="workers 0"):
        mp.train_policy(ROBOT, prior, workers=0)
