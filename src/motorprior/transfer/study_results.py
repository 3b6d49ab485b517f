"""A study's summary as rows, and so as figures by name."""

from __future__ import annotations

import numpy as np

from motorprior.results import Result, Results
from motorprior.transfer.statistics import Estimate
from motorprior.transfer.study_summary import Summary
from motorprior.transfer.study_verdicts import ADAPTED, MEASURES, PRIOR, RIVALS, STEPS

_STEPPED = {(before, after) for before, after, _ in STEPS}


def study_results(summary: Summary) -> Results:
    """Rows whose names as figures are PLACE/CONDITION/MEASURE, with /low and /high ends of the 95 % interval.

    Besides MEASURES there are ratio, to the speed where a policy was trained, and regret, to the oracle's speed [m/s];
    policies_upright, the share of policies that are upright for 90 % of the time; MEASURE_p_against_ONE, corrected
    within its family, and MEASURE_improved_by_ONE, the probability that ONE has more; ONE is the prior or, beside its
    rivals, the adapted prior. MEASURE_gain_over_BEFORE, of each of STEPS, is how much more a condition has than the one
    before it, with its interval, and MEASURE_p_over_BEFORE, corrected for all steps. See `study_summary.families`.
    """
    ratios = {(*pair, "ratio"): each for pair, each in summary.ratios.items()}
    regrets = {(*pair, "regret"): each for pair, each in summary.regrets.items()}
    units, rows = MEASURES | {"ratio": "1", "regret": "m/s"}, []
    for (place, condition, measure), found in {**summary.estimates, **ratios, **regrets}.items():
        name, unit = f"{place}/{condition}/{measure}", units.get(measure, units["foot_lift_mm"])  # of one leg
        rows += with_interval(name, unit, found)
    for (place, condition), share in summary.standing.items():
        rows.append(Result(f"{place}/{condition}/policies_upright", "1", share))
    for pairing, compared in summary.comparisons.items():
        place, one, other, measure = pairing
        p = summary.corrected[pairing]
        if (other, one) in _STEPPED:
            name = f"{place}/{one}/{measure}"
            rows += with_interval(f"{name}_gain_over_{other}", MEASURES[measure], compared.difference)
            rows.append(Result(f"{name}_p_over_{other}", "1", p))
        if one == PRIOR or (one == ADAPTED and other in RIVALS):
            rows.append(Result(f"{place}/{other}/{measure}_p_against_{one}", "1", p))
            rows.append(Result(f"{place}/{other}/{measure}_improved_by_{one}", "1", compared.improvement))
    return Results.of(rows)


def with_interval(quantity: str, unit: str, found: Estimate) -> list[Result]:
    """Rows of an estimate: its value, and the low and high ends of its 95 % interval, where they are known."""
    ends = {None: found.value, "low": found.low, "high": found.high}
    return [Result(quantity, unit, value, statistic=end) for end, value in ends.items() if np.isfinite(value)]
