"""The comparison of searches: other libraries' behind one interface, and the table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_walks import PLACES, invented

import optimisers
import searches
from motorprior.locomotion.policy import PolicyArrays, act, zero_policy
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.results import Result, Results
from motorprior.search.policy_search import CONTEST, CONTEST_DRAWS, Champion, episode_seed
from searches import Cma, Pgpe, arrays_of


class Climbs:
    """A search that goes up by a fixed step; notes what it is told."""

    pairs = True

    def __init__(self, size: int):
        self.center, self.told = np.zeros(size), []

    def ask(self) -> np.ndarray:
        step = np.full_like(self.center, 1e-2)
        return np.array([self.center + step, self.center - step])

    def tell(self, returns: np.ndarray) -> None:
        self.told.append(returns)
        self.center = self.center + 1e-2


@pytest.fixture
def walker(tmp_path: Path) -> optimisers.Walker:
    """On a PD's motors; nothing reads the prior."""
    settings = optimisers.Settings(tmp_path / "prior.safetensors", tmp_path / "out", iterations=2)
    return replace(optimisers.Walker.of(settings), motors=MotorChoice("pd"))


@pytest.fixture
def no_gait(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is trained wins its contest, however badly it walks."""
    monkeypatch.setattr(optimisers, "the_gait", lambda walker, *_: Champion.none_yet(walker.shape))


def test_a_search_is_told_returns_and_the_best_has_the_score_of_its_contest(walker: optimisers.Walker, no_gait: None):
    found = []
    for _ in range(2):
        search, executor = Climbs(walker.shape.size), walker.executor()
        champion = optimisers.searched(walker, search, 3, executor)
        seeds = [episode_seed(3, CONTEST, draw) for draw in range(CONTEST_DRAWS)]
        alone = executor.map(optimisers.run_policy, None, [(champion.policy, seed) for seed in seeds])
        executor.close()
        shown = champion.policy.weights[:, :-1]
        steps = optimisers.AVERAGING * 1e-2 * np.array([1.0, 2.0 - optimisers.AVERAGING]).sum()  # the average's way
        assert champion.iteration == 2 and np.abs(shown).max() == pytest.approx(steps, rel=1e-6)
        assert champion.score == np.mean([each.total for each in alone])
        assert np.array(search.told).shape == (2, 2) and np.std(search.told) > 0.0
        found.append((champion.score, np.array(search.told)))
    np.testing.assert_array_equal(found[0][1], found[1][1])
    assert found[0][0] == found[1][0]


def test_a_worse_policy_does_not_win(walker: optimisers.Walker):
    executor = walker.executor()
    before = Champion(zero_policy(walker.robot.num_joints), 1e6, 1)
    assert optimisers.challenge(executor, 0, before.policy, 2, before) is before
    executor.close()


@pytest.mark.parametrize(("search", "library"), [(Cma, "cma"), (Pgpe, "evotorch")])
def test_searches_climb_and_repeat_themselves(search, library: str):
    pytest.importorskip(library, reason=f"{library} is not installed: pip install 'motorprior[optimisers]'")
    centers = []
    for seed in (0, 0, 1):
        climbing = search(6, 16, seed, 0.1)
        for _ in range(150):
            climbing.tell(-np.square(climbing.ask() - 1.0).sum(axis=1))
        np.testing.assert_allclose(climbing.center, 1.0, atol=0.2)
        centers.append(climbing.center)
    np.testing.assert_array_equal(centers[0], centers[1])
    assert not np.array_equal(centers[0], centers[2])


def test_a_net_of_ppo_acts_like_the_policy_that_is_made_of_it():
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'motorprior[optimisers]'")
    torch.manual_seed(0)
    observations, actions, units = 5, 3, 4

    class Net:
        class mlp_extractor:
            policy_net = torch.nn.Sequential(torch.nn.Linear(observations, units), torch.nn.Tanh())

        action_net = torch.nn.Linear(units, actions)

    class Envs:
        class obs_rms:
            mean, var = np.arange(5.0), np.arange(1.0, 6.0)

        epsilon = 1e-8

    seen = np.random.default_rng(0).standard_normal(observations)
    normalised = torch.as_tensor((seen - Envs.obs_rms.mean) / np.sqrt(Envs.obs_rms.var + 1e-8), dtype=torch.float32)
    wanted = Net.action_net(Net.mlp_extractor.policy_net(normalised)).detach().numpy()
    out = np.empty(actions)
    policy: PolicyArrays = arrays_of(Net, Envs)
    act(policy, seen, out)
    np.testing.assert_allclose(out, np.clip(wanted, -1.0, 1.0), atol=1e-6)


def test_the_table_has_a_row_per_method_with_the_medians_of_its_trainings():
    trainings = Results.of(
        Result(f"{method}/{quantity}", unit, 10.0 * number + seed**2, seed=seed)
        for number, method in enumerate(optimisers.METHODS)
        for quantity, unit in (("seconds", "s"), ("return", "m"))
        for seed in range(3)
    )
    results = optimisers.figures_of(invented(optimisers.METHODS), trainings)
    figures = results.to_figures()
    for number, method in enumerate(optimisers.METHODS):
        assert figures[f"{method}/seconds"] == 10.0 * number + 1.0
        assert figures[f"{method}/fleet/speed/low"] <= figures[f"{method}/fleet/speed"]
    lines = optimisers.markdown(figures, optimisers.METHODS, list(PLACES)).splitlines()
    assert len(lines) == 2 + len(optimisers.METHODS) and {line.count("|") for line in lines} == {4 + len(PLACES)}


def test_ppo_trains_a_policy_that_walks_in_contests(
    walker: optimisers.Walker, monkeypatch: pytest.MonkeyPatch, no_gait: None
):
    for library in ("torch", "stable_baselines3"):
        pytest.importorskip(library, reason=f"{library} is not installed: pip install 'motorprior[optimisers]'")
    monkeypatch.setattr(optimisers, "EPISODE_STEPS", 8)
    monkeypatch.setattr(searches, "PPO_ROUND", 64)
    learned: list[PolicyArrays] = []

    class Watched(searches.Ppo):
        def learn_until(self, steps: int) -> None:
            learned.append(self.policy())
            super().learn_until(steps)
            learned.append(self.policy())

    monkeypatch.setattr(optimisers, "Ppo", Watched)
    executor = walker.executor()
    champion = optimisers.learned_by_ppo(walker, 0, executor)
    executor.close()
    before, after = learned
    assert after.hidden.shape[0] == searches.PPO_UNITS and not np.array_equal(before.readout, after.readout)
    for one, other in zip(champion.policy, after, strict=True):
        np.testing.assert_array_equal(one, other)
    assert champion.iteration == 2 and np.isfinite(champion.score)


def test_an_unknown_method_is_refused(tmp_path: Path, monkeypatch):
    words = ["--prior", str(tmp_path), "--out", str(tmp_path / "out"), "--methods", "magic"]
    monkeypatch.setattr("sys.argv", ["optimisers.py", *words])
    with pytest.raises(SystemExit, match="no method 'magic'"):
        optimisers.main()
    assert not (tmp_path / "out").exists()
