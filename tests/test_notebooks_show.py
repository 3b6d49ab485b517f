"""What a notebook shows of results: tables and texts, escaped."""

import re
from pathlib import Path

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.exports.registry import Exported
from motorprior.results import Result, Results

PRIOR = mp.from_pretrained("so101")


def html_of(value: object) -> str:
    text = value._repr_html_()  # pyright: ignore[reportAttributeAccessIssue]
    assert isinstance(text, str)
    return text


def test_results_are_a_table_of_the_columns_that_hold_values():
    rows = Results((Result("speed", "m/s", 0.5, model="<prior>"), Result("drift", "m", 0.25)))
    text = html_of(rows)

    assert re.findall("<th>(.*?)</th>", text) == ["quantity", "unit", "value", "model"]
    assert text.count("<tr>") == 3
    assert "&lt;prior&gt;" in text


def test_constants_of_a_prior_are_a_table():
    assert html_of(PRIOR.constants("gripper")).count("<tr>") == 1 + len(PRIOR.constants("gripper"))


@pytest.mark.parametrize(("count", "columns"), [(6, 6), (30, 3)])
def test_samples_are_a_table_of_few_motors_or_of_the_quantiles_of_many(count: int, columns: int):
    motors = PRIOR.sample(["gripper"] * count, seed=0)
    text = html_of(motors)
    row = re.search(r"<td>kp</td><td>N·m/rad</td>(.*?)</tr>", text)

    assert row is not None
    assert row[1].count("<td>") == columns
    assert isinstance(motors, GreyBoxActuator)

    kp = motors.constants()["kp"]

    assert f"<td>{kp[0] if columns == count else np.median(kp):.3g}</td>" in row[1]


def test_reports_of_logs_and_exports_are_texts():
    log = mp.record_bench(motors=2, steps=300, preset="paper")
    exported = Exported((Path("out/motors.json"),), {"leg": 0.002}, {}, None)

    assert "findings" in html_of(mp.check_log(log))
    assert "leg 2.0 mrad" in html_of(exported)
