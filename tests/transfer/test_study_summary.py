"""What a study decides, on tables made by hand: what holds, what does not, and what cannot be told."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from study_walks import CONDITIONS, PLACES, invented, table_of

from motorprior.exceptions import ArtifactError
from motorprior.transfer import study_summary
from motorprior.transfer.places import TWINS
from motorprior.transfer.study_results import study_results
from motorprior.transfer.study_verdicts import STEPS, Pairing, Verdict
from motorprior.transfer.walk_table import OWN_ABROAD, WalkRow, WalkTable

SEEDS, DRAWS = 8, 8
summarise = partial(study_summary.summarise, enough_draws=1)
SPEEDS = {"prior": 0.40, "prior_adapted": 0.30, "prior_robust": 0.4, "oracle": 0.41, "pd_friction": 0.2,
          "pd_randomised": 0.1, "paper": 0.3, "ideal_pd": 0.2}  # fmt: skip


def study(
    places: tuple[str, ...] = ("own", *TWINS),
    speeds: dict[str, float] = SPEEDS,
    at: dict[tuple[str, str], float] | None = None,
    measures: dict[tuple[str, str], dict[str, float]] | None = None,
) -> WalkTable:
    """Policies that differ by a hundredth: ``at`` and ``measures`` change the walks of a (place, condition)."""
    found = []
    for place in places:
        for condition, speed in speeds.items():
            pair = (place, condition)
            level = (at or {}).get(pair, speed)
            told = {"upright": 1.0, "drift": 0.1, **(measures or {}).get(pair, {})}
            scores = [[level + 0.001 * seed + 0.002 * draw for draw in range(DRAWS)] for seed in range(SEEDS)]
            found += table_of({pair: scores}, **told).walks
    return WalkTable.of(found)


def verdict(verdicts: tuple[Verdict, ...], words: str) -> Verdict:
    (found,) = [each for each in verdicts if words in each.said]
    return found


def against(other: str) -> Pairing:
    """The sampled prior's speed against another's, on the first twin."""
    return Pairing("fleet", "prior", other, "speed")


def test_everything_that_is_aimed_at_can_hold():
    worse = {
        (place, rival): {"upright": 0.8, "drift": 0.4}
        for place in ("fleet", "foreign")
        for rival in ("pd_friction", "pd_randomised")
    }
    summary = summarise(study(measures=worse))
    assert [each.holds for each in summary.targets] == [True] * 8
    assert "sampled 100.0 % upright, 97.6 % of the speed" in verdict(summary.targets, "fleet").found


def test_a_missing_twin_leaves_open_what_it_could_have_spoiled():
    """The adapted prior loses where both met, and the sampled one wins; on the twin that is missing it may lose."""
    there = ("own", "fleet", "foreign", "hard")
    found = {each.said: each for each in summarise(study(there, at={("hard", "prior_adapted"): 0.0})).targets}
    (pybullet,) = [each for said, each in found.items() if "pybullet" in said]
    assert (pybullet.holds, pybullet.found) == (None, "not measured")
    assert {each.holds for said, each in found.items() if "faster than" in said} == {None}
    lost = summarise(study(there, at={("hard", name): 0.0 for name in ("prior", "prior_adapted")})).targets
    assert {each.holds for each in lost if "faster than" in each.said} == {False}


def test_slow_or_fallen_is_not_enough():
    slow = {("fleet", "prior"): 0.37, ("fleet", "prior_adapted"): 0.38, ("foreign", "prior_adapted"): 0.38}
    fallen = {("foreign", "prior"): {"upright": 0.97}, ("hard", "prior_robust"): {"upright": 0.89}}
    summary = summarise(study(at=slow, measures=fallen))
    assert verdict(summary.targets, "fleet").holds is False
    foreign = verdict(summary.targets, "foreign")
    assert foreign.holds is False
    lost = "67 % of what is lost is on 6 of 8 robots, where it is 97.0 % upright, the oracle 100.0 %"
    ways = f"sampled falls: 97.0 % upright, where it was trained 100.0 %; {lost}; adapted is slow: 100.0 % upright"
    assert foreign.why == f"{ways}, where it was trained 100.0 %; the oracle here 100.0 %"
    assert verdict(summary.targets, "hard").holds is False
    hard = verdict(summary.targets, "hard")
    assert hard.found == "89.0 % upright (0.0 % of its policies stand)"
    lost = "67 % of what is lost is on 6 of 8 robots, where it is 89.0 % upright, the oracle 100.0 %"
    assert hard.why == f"{hard.found}; where it was trained 100.0 %; {lost}; the oracle here 100.0 %"


def test_the_reason_names_the_home_of_the_policies_that_fell():
    """The adapted prior's policies for foreign motors were trained on these, and fell there, too."""
    places = ("own", "own_foreign", *TWINS)
    fallen = {("foreign", name): {"upright": 0.9} for name in ("prior", "prior_adapted")}
    fallen |= {("own_foreign", "prior_adapted"): {"upright": 0.8}, ("foreign", "oracle"): {"upright": 0.95}}
    why = verdict(summarise(study(places, measures=fallen)).targets, "foreign").why
    assert "adapted falls: 90.0 % upright, where it was trained 80.0 %" in why
    assert why.endswith("the oracle here 95.0 %")


def test_the_slower_of_two_priors_may_be_the_one_that_holds():
    fast_but_fallen = study(
        at={("fleet", "prior_adapted"): 0.5}, measures={("fleet", "prior_adapted"): {"upright": 0.9}}
    )
    assert verdict(summarise(fast_but_fallen).targets, "fleet").holds is True


def test_a_rival_that_wins_anywhere_spoils_the_target():
    summary = summarise(study(at={("hard", "pd_friction"): 0.45}))
    faster = verdict(summary.targets, "faster than a PD with friction")
    assert faster.holds is False and "fleet +0.200 m/s (p 0.0" in faster.found
    assert "hard −0.050 m/s (p 0.0" in faster.found
    has = "2 of fleet, foreign, pybullet are asked, where the rival has 0.21 m/s, 0.21 m/s, 0.21 m/s"
    won = "fleet and foreign and pybullet (less on hard, however unsure)"
    assert faster.why == f"beyond doubt sampled on {won}; adapted on {won}; {has}"
    assert verdict(summary.targets, "faster than a randomised PD").holds is True


def test_a_tie_on_all_but_one_twin_does_not_hold():
    summary = summarise(study(at={(place, "pd_randomised"): 0.40 for place in TWINS if place != "fleet"}))
    assert verdict(summary.targets, "faster than a randomised PD").holds is False


def test_the_hard_twin_spoils_and_does_not_decide():
    tie = {(place, "pd_randomised"): 0.40 for place in ("foreign", "pybullet")}
    faster = verdict(summarise(study(at=tie)).targets, "faster than a randomised PD")
    assert faster.holds is False and "fleet +0.2" in faster.found and "hard +0.2" in faster.found


def test_one_of_the_two_priors_may_win():
    """The sampled one is as fast as a rival, the adapted one faster."""
    summary = summarise(study(speeds=SPEEDS | {"pd_friction": 0.4, "prior_adapted": 0.5}))
    found = verdict(summary.targets, "faster than a PD with friction")
    assert found.holds is True
    assert found.found.startswith("sampled: +0.000 m/s, not sure; adapted: fleet +0.100 m/s (p 0.0")


def test_to_fall_less_is_another_target_than_to_be_faster():
    fallen = {(place, "pd_friction"): {"upright": 0.7} for place in ("fleet", "foreign")}
    summary = summarise(study(measures=fallen, speeds=SPEEDS | {"pd_friction": 0.4, "prior_adapted": 0.4}))
    assert verdict(summary.targets, "faster than a PD with friction").holds is False
    upright = verdict(summary.targets, "upright for longer than a PD with friction")
    assert upright.holds is True and "fleet +30.0 points" in upright.found
    assert verdict(summary.targets, "upright for longer than a randomised PD").holds is False


def test_every_step_from_a_pd_to_the_truth_is_compared_with_the_one_before():
    speeds = SPEEDS | {"tuned_pd": 0.1, "prior_mean": 0.25}
    pairs = {(after, before) for before, after, _ in STEPS}
    found = summarise(study(speeds=speeds)).comparisons
    steps = {each: compared for each, compared in found.items() if (each.one, each.other) in pairs}
    on_the_fleet = {(each.other, each.one): found for each, found in steps.items() if each[0::3] == ("fleet", "speed")}
    gains = {pair: found.difference.value for pair, found in on_the_fleet.items()}
    assert gains == pytest.approx({
        ("tuned_pd", "pd_friction"): 0.1, ("pd_friction", "prior_mean"): 0.05, ("prior_mean", "prior"): 0.15,
        ("prior", "prior_adapted"): -0.1, ("prior_adapted", "oracle"): 0.11,
    })  # fmt: skip
    assert sum(gains.values()) == pytest.approx(speeds["oracle"] - speeds["tuned_pd"])
    assert {each.measure for each in steps} == {"speed", "upright"}
    assert {each.place for each in steps} == set(TWINS)


def test_a_log_of_a_robot_is_compared_on_that_robot():
    """Robots 0 and 1, which the adapted policies walk, are slow for everybody."""
    speeds = [[0.3, 0.3, 0.5, 0.5, 0.5, 0.5]] * 2
    walks = {("fleet", name): speeds for name in ("prior", "oracle", "pd_friction")}
    walks |= {("fleet", "prior_adapted"): [[0.3, 0.3, 0.3]] * 2}
    found = summarise(table_of(walks, upright=1.0, drift=0.1))
    for pairing, compared in found.comparisons.items():
        assert compared.difference.value == pytest.approx(0.0), pairing
    assert ("fleet", "prior_adapted", "prior", "speed") in found.comparisons


def test_the_luck_of_a_robot_is_not_its_policys():
    """Policy k of the adapted prior is 0.1 m/s faster on robot k than anybody else: sure, however robots differ."""
    rng = np.random.default_rng(0)
    luck, policies = rng.uniform(0.0, 1.0, SEEDS), 0.01 * rng.standard_normal((SEEDS, 1))
    adapted = 0.1 + luck[:, None] + 0.01 * rng.standard_normal((SEEDS, 5))
    walks = {("fleet", "pd_friction"): policies + luck, ("fleet", "prior_adapted"): adapted}
    found = summarise(table_of(walks, upright=1.0))
    pairing = Pairing("fleet", "prior_adapted", "pd_friction", "speed")
    compared = found.comparisons[pairing]
    assert compared.p == pytest.approx(2 / 12_870)
    assert 0.05 < compared.difference.low <= compared.difference.high < 0.15, "both on the same robots"


def test_figures_say_what_a_step_adds_and_how_sure_it_is():
    fallen = {("fleet", "pd_friction"): {"upright": 0.5}}
    speeds = SPEEDS | {"tuned_pd": 0.1}
    figures = study_results(summarise(study(("own", "fleet"), speeds, measures=fallen))).to_figures()
    assert figures["fleet/pd_friction/upright_improved_by_prior"] == 1.0
    assert figures["fleet/pd_friction/speed_improved_by_prior"] == 1.0
    assert figures["fleet/pd_friction/upright_gain_over_tuned_pd"] == pytest.approx(-0.5)
    low, high = (figures[f"fleet/pd_friction/upright_gain_over_tuned_pd/{end}"] for end in ("low", "high"))
    assert low - 1e-9 <= -0.5 <= high + 1e-9 and figures["fleet/pd_friction/upright_p_over_tuned_pd"] < 0.05
    assert figures["fleet/pd_friction/speed_gain_over_tuned_pd"] == pytest.approx(0.1)
    assert not [name for name in figures if "drift_" in name], "of walks without a fall: reported, not compared"


def test_what_was_not_run_cannot_be_told():
    few = {name: SPEEDS[name] for name in ("prior", "pd_friction")}
    summary = summarise(study(("own", "fleet"), few))
    assert {each.holds for each in (*summary.targets, *summary.claims)} == {None}
    assert {each.found for each in summary.claims} == {"not measured"}
    assert verdict(summary.targets, "fleet").found == "sampled 100.0 % upright; no oracle walks there"
    both = few | {"prior_adapted": SPEEDS["prior_adapted"]}
    for speeds, holds in ((both, False), (few, None)):
        lost = summarise(study(("own", "fleet"), speeds, at={("fleet", "pd_friction"): 0.6}))
        assert verdict(lost.targets, "faster than a PD with friction").holds is holds, "one twin can show a loss"


def test_the_fewest_policies_count():
    table = study(("own", "fleet"))
    assert summarise(table).policies == SEEDS
    fewer = [walk for walk in table.walks if walk.condition != "paper" or walk.seed]
    assert summarise(WalkTable.of(fewer)).policies == SEEDS - 1
    assert summarise(WalkTable()).policies == 0


def test_a_table_of_training_alone_has_no_comparison():
    summary = summarise(study(("own",)))
    assert not summary.ratios and not summary.regrets and not summary.comparisons and summary.estimates
    assert verdict(summary.claims, "faster").holds is None


def test_an_oracle_that_does_not_walk_is_no_measure():
    assert verdict(summarise(study(at={("fleet", "oracle"): -0.1})).targets, "fleet").holds is None
    fallen = verdict(summarise(study(measures={("fleet", "oracle"): {"upright": 0.4}})).targets, "fleet")
    assert fallen.holds is None
    assert fallen.found == "; ".join(
        f"{name} 100.0 % upright; the oracle is no measure of its speed (40.0 % upright)"
        for name in ("sampled", "adapted")
    )


def test_who_falls_has_failed_whatever_the_oracle_does():
    falls = {("fleet", name): {"upright": 0.4} for name in ("oracle", "prior", "prior_adapted")}
    assert verdict(summarise(study(measures=falls)).targets, "fleet").holds is False


def test_policies_that_fall_are_counted():
    """One of eight falls: the middle half of the walks has nothing of it."""
    walks = [
        replace(walk, measures={**walk.measures, "upright": 0.1, "speed": 0.0}) if walk.seed == 3 else walk
        for walk in study(("own", "fleet"), {"prior": 0.4}).walks
    ]
    found = summarise(WalkTable.of(walks))
    assert found.standing["fleet", "prior"] == 7 / 8
    assert found.estimates["fleet", "prior", "speed"].value > 0.4
    assert study_results(found).to_figures()["fleet/prior/policies_upright"] == 7 / 8


def test_few_policies_decide_nothing():
    few = WalkTable.of(walk for walk in study().walks if walk.seed < 7)
    summary = summarise(few)
    assert {each.holds for each in (*summary.targets, *summary.claims)} == {None} and not summary.decides
    assert summary.targets[0].found.startswith("sampled 100.0 % upright, ")


def test_few_walks_decide_nothing_either():
    """A policy whose simulation has no chance walks once at home; that is no lack of walks."""
    once = WalkTable.of(
        walk for walk in study().walks if (walk.place, walk.condition) != ("own", "ideal_pd") or not walk.draw
    )
    for enough, decides in ((DRAWS, True), (DRAWS + 1, False)):
        summary = study_summary.summarise(once, enough_draws=enough)
        assert (summary.draws, summary.decides) == (DRAWS, decides)
        assert summary.targets[0].holds is (True if decides else None)


def test_the_reason_says_whether_a_few_robots_are_hard_for_everybody():
    """The prior is down for half of the time on robot 0 and a tenth on robot 1; the oracle on robot 0 only."""
    down = {("prior", 0): 0.5, ("prior", 1): 0.9, ("oracle", 0): 0.75}
    walks = [
        replace(walk, measures={**walk.measures, "upright": down.get((walk.condition, walk.draw), 1.0)})
        for walk in study(("own", "foreign"), {"prior": 0.4, "prior_adapted": 0.3, "oracle": 0.41}).walks
    ]
    why = verdict(summarise(WalkTable.of(walks)).targets, "foreign").why
    found = "67 % of what is lost is on 1 of 8 robots, where it is 50.0 % upright, the oracle 75.0 %"
    assert found in why and why.endswith("the oracle here 96.8 %")


def test_a_loss_is_not_hidden_by_the_correction():
    """Five of eight policies of the prior are slower on `hard` than all of a rival; elsewhere all are faster."""
    few = {name: SPEEDS[name] for name in ("prior", "prior_adapted", "oracle", "pd_friction", "ideal_pd")}
    few["prior_adapted"] = 0.1
    slow = {("hard", "prior"): 0.2, ("hard", "pd_friction"): 0.25}
    walks = [
        replace(walk, measures={**walk.measures, "speed": 0.267})
        if (walk.place, walk.condition) == ("hard", "prior") and walk.seed < 3 else walk
        for walk in study(speeds=few, at=slow).walks
    ]  # fmt: skip
    summary = summarise(WalkTable.of(walks))
    pairing = Pairing("hard", "prior", "pd_friction", "speed")
    assert summary.comparisons[pairing].p < 0.05 < summary.corrected[pairing]
    found = verdict(summary.targets, "faster than a PD with friction")
    assert found.holds is False and "before the correction" in found.found
    assert verdict(summarise(study(speeds=few)).targets, "faster than a PD with friction").holds is True


def test_a_great_loss_counts_however_unsure_it_is():
    """One of eight policies of each prior falls on `hard`, which no test takes for a difference."""
    few = {name: SPEEDS[name] for name in ("prior", "prior_adapted", "oracle", "pd_friction", "ideal_pd")}
    worse = {(place, "pd_friction"): {"upright": 0.5} for place in ("fleet", "foreign")}
    walks = [
        replace(walk, measures={**walk.measures, "upright": 0.0 if walk.place == "hard" else 1.0})
        if walk.condition in ("prior", "prior_adapted") and walk.seed == 0 else walk
        for walk in study(speeds=few, measures=worse).walks
    ]  # fmt: skip
    summary = summarise(WalkTable.of(walks))
    pairing = Pairing("hard", "prior", "pd_friction", "upright")
    assert summary.comparisons[pairing].p > 0.05 and summary.comparisons[pairing].difference.value == -0.125
    found = verdict(summary.targets, "upright for longer than a PD with friction")
    assert found.holds is False and "(less on hard, however unsure)" in found.why


def test_two_that_were_made_for_the_same_robots_are_compared_robot_by_robot():
    """Each robot has its own speed; on each the adapted prior is a little faster than the adapted PD."""
    few = {name: SPEEDS[name] for name in ("prior", "prior_adapted", "oracle")}
    walks = study(speeds=few | {"pd_adapted": 0.3}).walks
    gains = {"prior_adapted": 0.01, "pd_adapted": 0.0}
    walks = [
        replace(walk, measures={**walk.measures, "speed": 0.1 * walk.seed + gains[walk.condition]})
        if walk.condition in gains else walk for walk in walks
    ]  # fmt: skip
    summary = summarise(WalkTable.of(walks))
    pairing = Pairing("fleet", "prior_adapted", "pd_adapted", "speed")
    compared = summary.comparisons[pairing]
    assert compared.p == 2 / 2**SEEDS and compared.difference.value == pytest.approx(0.01)
    assert compared.is_sure(summary.corrected[pairing]), "its p is not corrected for the steps"
    turned = summary.comparisons[Pairing("fleet", "prior", "pd_adapted", "speed")]
    assert turned.difference.value > 0.05 and turned.improvement > 0.6, "the sampled prior is faster on most robots"


def test_what_only_these_robots_show_is_not_sure():
    """All policies of two conditions are alike, and differ on every robot: by chance in the mean of these."""
    rng = np.random.default_rng(1)
    robots = 0.2 * rng.standard_normal(SEEDS)
    policies = 0.001 * rng.standard_normal((2, SEEDS, 1))
    walks = {("fleet", "prior"): 0.5 + policies[0] + robots, ("fleet", "pd_friction"): 0.5 + policies[1]}
    summary = summarise(table_of({pair: np.asarray(scores + np.zeros(SEEDS)) for pair, scores in walks.items()}))
    compared = summary.comparisons[against("pd_friction")]
    assert compared.p < 0.001 and not compared.is_sure(compared.p)


def test_an_extra_condition_of_few_policies_spoils_nothing():
    extra = table_of({(place, "mine"): [[0.3] * DRAWS] * 2 for place in ("own", "fleet")}, upright=1.0)
    summary = summarise(WalkTable.of([*study().walks, *extra.walks]))
    assert summary.policies == SEEDS and summary.targets[0].holds is True


def test_the_adapted_prior_is_measured_by_the_oracle_on_the_same_robots():
    """The oracle is slow on the eight robots that adapted policies walk, and fast on the ninth."""
    speeds = {
        ("fleet", "prior_adapted"): [[0.2] * 9] * 8,
        **{("fleet", name): [[*[0.2] * 8, 0.6]] * 8 for name in ("oracle", "prior")},
    }
    found = verdict(summarise(table_of(speeds, upright=1.0)).targets, "fleet")
    assert found.holds is True and "adapted 100.0 % upright, 100.0 % of the speed" in found.found


def test_an_oracle_that_falls_on_the_adapted_robots_is_no_measure_of_them():
    """It falls on robots 0 to 7, which the adapted policies walk, and on none of the other 72."""
    walks = [
        WalkRow("fleet", name, seed, draw, {"speed": 0.4, "upright": 0.5 if name == "oracle" and draw < 8 else 1.0})
        for name, draws in (("oracle", 80), ("prior", 80), ("prior_adapted", 2))
        for draw in range(draws)
        for seed in range(8)
    ]
    found = verdict(summarise(WalkTable.of(walks)).targets, "fleet")
    assert found.holds is True and "sampled 100.0 % upright, 100.0 % of the speed" in found.found
    assert "adapted 100.0 % upright; the oracle is no measure of its speed (50.0 % upright)" in found.found
    alone = summarise(WalkTable.of(walk for walk in walks if walk.condition != "prior"))
    assert verdict(alone.targets, "fleet").holds is None


def test_the_papers_claims_hold_or_do_not():
    says = {
        ("own", "paper"): {"step_frequency": 2.0, "foot_lift_mm": 20.0},
        ("own", "ideal_pd"): {"step_frequency": 3.0, "foot_lift_mm": 10.0},
        ("fleet", "paper"): {"body_rate": 0.5, "upright": 1.0},
        ("fleet", "ideal_pd"): {"body_rate": 1.0, "upright": 0.5},
    }
    found = summarise(study(at={("own", "paper"): 0.1}, measures=says)).claims
    assert [each.holds for each in found] == [True] * 6
    swapped = {(place, {"paper": "ideal_pd"}.get(name, "paper")): each for (place, name), each in says.items()}
    found = summarise(study(at={("own", "ideal_pd"): 0.1, ("fleet", "ideal_pd"): 0.5}, measures=swapped)).claims
    assert [each.holds for each in found] == [False] * 6
    assert "after the paper's recipe" in found[0].found


def test_claims_are_judged_on_the_papers_loss_where_its_recipe_does_not_walk():
    both, falls = SPEEDS | {"paper_wide": 0.3}, {("own", "paper"): 0.001, ("own", "paper_wide"): 0.1}
    steps = {(("own"), name): {"step_frequency": 2.0} for name in ("paper", "paper_wide", "ideal_pd")}
    steps["own", "ideal_pd"]["step_frequency"] = 3.0
    judged = summarise(study(speeds=both, at=falls, measures=steps)).claims
    found = verdict(judged, "less frequent")
    assert found.holds is True and "Hz after the paper's loss on our data" in found.found
    found = verdict(judged, "walks worse")
    assert found.holds is True and "m/s after the paper's loss on our data" in found.found
    neither = dict.fromkeys(falls, 0.001)
    steps["own", "prior"] = {"step_frequency": 2.5}
    found = verdict(summarise(study(speeds=both, at=neither, measures=steps)).claims, "less frequent")
    assert found.holds is True and "own: 2.5 Hz after the sampled prior, since no robot" in found.found
    alone = {name: speed for name, speed in both.items() if name != "prior"}
    found = verdict(summarise(study(speeds=alone, at=neither)).claims, "less frequent")
    assert found.holds is None and "does not walk in its own simulation (0.01 m/s" in found.found


def test_a_claim_about_two_that_do_not_differ_cannot_be_told():
    found = verdict(summarise(study(at={("own", "paper"): 0.2})).claims, "walks worse")
    assert found.holds is None and "p 1" in found.found


def test_ratio_and_regret_are_of_the_speeds():
    summary = summarise(study(at={("own", "prior"): 0.8, ("own", "paper"): 0.001}))
    assert summary.ratios["fleet", "prior"].value == pytest.approx(0.4 / 0.8, abs=0.01)
    assert np.isnan(summary.ratios["fleet", "paper"].value), "it does not walk where it was trained"
    assert summary.regrets["fleet", "pd_friction"].value == pytest.approx(0.21)
    assert ("fleet", "oracle") not in summary.regrets
    assert not [each for each in summary.comparisons if each.one == each.other]
    compared = summary.comparisons[against("pd_friction")]
    assert compared.difference.value == pytest.approx(0.2) and compared.improvement == 1.0


def test_p_values_are_corrected_for_all_comparisons():
    """Targets: two ways to use the prior against two rivals. Steps: adapted after sampled, oracle after adapted."""
    summary = summarise(study())
    measures, twins = 2, len(TWINS)
    others = {"prior_robust", "oracle", "paper", "ideal_pd"}
    targeted = [each for each in summary.comparisons if each.other in ("pd_friction", "pd_randomised")]
    stepped = [each for each in summary.comparisons if "prior_adapted" in (each.one, each.other)]
    stepped = [each for each in stepped if each not in targeted and each.one != "prior"]
    told = [each for each in summary.comparisons if each.other in others and each.one == "prior"]
    counts = [len(family) for family in (targeted, stepped, told)]
    assert counts == [twins * measures * 4, twins * measures * 2, twins * measures * len(others)]
    for family in (targeted, stepped, told):
        smallest = min(family, key=lambda pair: summary.comparisons[pair].p)
        assert summary.corrected[smallest] == pytest.approx(len(family) * summary.comparisons[smallest].p)
    there, back = (
        Pairing("fleet", *pair, "speed") for pair in (("prior", "prior_adapted"), ("prior_adapted", "prior"))
    )
    assert summary.corrected[there] == summary.corrected[back]
    assert summary.comparisons[there] == summary.comparisons[back].turned()


def test_the_gait_is_one_policy_and_compared_with_nobody():
    table = study(speeds=SPEEDS | {"untrained": 0.1})
    assert "untrained" not in {each.other for each in summarise(table).comparisons}


def test_a_share_is_reported_by_its_mean_and_the_rest_by_its_middle_half():
    walks = [
        WalkRow("own", "prior", 0, draw, {"speed": speed, "upright": upright})
        for draw, (speed, upright) in enumerate([(0.0, 0.2), (0.4, 1.0), (0.4, 1.0), (9.0, 1.0)])
    ]
    found = summarise(WalkTable.of(walks)).estimates
    assert found["own", "prior", "speed"].value == 0.4
    assert found["own", "prior", "upright"].value == pytest.approx(0.8)


def test_a_measure_that_is_not_known_leaves_the_others_alone():
    torque = {("pybullet", name): {"transport": float("nan")} for name in SPEEDS}
    places = ("own", "fleet", "pybullet")
    with_nan, without = summarise(study(places, measures=torque)), summarise(study(places))
    assert ("pybullet", "prior", "transport") not in with_nan.estimates
    assert with_nan.estimates == without.estimates and with_nan.corrected == without.corrected
    half = summarise(study(("own",), measures={("own", "prior"): {"slip": float("nan")}}))
    assert ("own", "prior", "slip") not in half.estimates


def test_who_always_falls_has_no_drift():
    fallen = {("fleet", name): {"drift": float("nan"), "upright": 0.1} for name in ("paper", "pd_friction")}
    summary = summarise(study(measures=fallen))
    figures = study_results(summary).to_figures()
    assert all(np.isfinite(list(figures.values())))
    assert "fleet/paper/drift" not in figures and "foreign/paper/drift" in figures
    assert "nan" not in "".join(each.found for each in summary.targets)


def test_a_few_walks_that_tell_a_measure_are_enough():
    walks = list(study(("own",), {"prior": 0.4}).walks)
    walks = [replace(w, measures={**w.measures, "slip": 0.2 if i == 5 else np.nan}) for i, w in enumerate(walks)]
    found = summarise(WalkTable.of(walks)).estimates["own", "prior", "slip"]
    assert found.value == pytest.approx(0.2) and np.isnan(found.low), "no interval of a single walk"


def test_the_order_of_the_rows_does_not_matter():
    table = invented(("prior", "oracle", "paper"), ("own", "fleet"))
    shuffled = WalkTable.of(sorted(table.walks, key=lambda walk: (walk.draw * 7919 + walk.seed) % 13))
    one, other = summarise(table), summarise(shuffled)
    assert one.estimates == other.estimates and dict(one.ratios) == dict(other.ratios)
    assert one.comparisons == other.comparisons


def test_tables_have_one_order_whatever_was_measured_first():
    table = study(("hard", "fleet", "own", OWN_ABROAD), {"oracle": 0.4, "mine": 0.3, "paper": 0.3, "ideal_pd": 0.2})
    summary = summarise(table)
    assert summary.places() == ["own", "fleet", "hard"] and summary.twins() == ["fleet", "hard"]
    assert summary.conditions() == ["ideal_pd", "paper", "oracle", "mine"]
    assert verdict(summary.claims, "faster").found.startswith("fleet: ")


def test_other_policies_than_were_trained_are_refused():
    table = study(("own", "fleet"))
    moved = [replace(walk, seed=walk.seed + 50 * (walk.place == "fleet")) for walk in table.walks]
    with pytest.raises(ArtifactError, match=r"seeds \[50, 51, 52, .*\] walked at fleet, \[0, 1, 2, "):
        summarise(WalkTable.of(moved))


def test_the_adapted_prior_walks_on_draws_of_its_own():
    """Every robot is 0.01 m/s better with the one: certain where both had the same robots, and else not."""
    luck = [0.1, 0.2, 0.3, 0.4]
    better = [[speed + 0.01 for speed in luck]] * 4
    speeds = {("fleet", "prior"): better, ("fleet", "prior_adapted"): [luck] * 4, ("fleet", "pd_friction"): [luck] * 4}
    found = summarise(table_of(speeds)).comparisons
    paired, apart = found[against("pd_friction")], found[against("prior_adapted")]
    assert paired.improvement == 1.0 and paired.p == pytest.approx(2 / 70)
    assert apart.improvement < 0.7 and apart.p > 0.3


def test_draws_of_other_numbers_are_not_paired():
    table = study(("own", "fleet"), {"prior": 0.4, "oracle": 0.41})
    more = table_of({("fleet", "pd_friction"): [[0.2] * 5] * 2, ("own", "pd_friction"): [[0.2]] * 2}, upright=1.0)
    summary = summarise(WalkTable.of([*table.walks, *more.walks]))
    assert summary.comparisons[against("pd_friction")].difference.value == pytest.approx(0.2, abs=0.02)


def test_an_invented_study_has_an_estimate_for_every_measure():
    table = invented(draws=3, seeds=2)
    summary = summarise(table)
    unknown = 2 * len(CONDITIONS)  # PyBullet tells no torque
    assert len(summary.estimates) == len(PLACES) * len(CONDITIONS) * len(table.walks[0].measures) - unknown
    assert all(np.isfinite([each.value, each.low, each.high]).all() for each in summary.estimates.values())
    assert summary.places() == list(PLACES) and summary.conditions() == list(CONDITIONS)
