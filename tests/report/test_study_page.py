"""The page of a study, made of invented walks: what it says, and how a browser shows it."""

import re
import shutil
import subprocess
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from study_walks import CONDITIONS, PLACES, invented, steps_in_place, table_of, write_study

from motorprior.artifacts import write_json, write_tensors
from motorprior.exceptions import ArtifactError
from motorprior.pipeline.stage import MARKER
from motorprior.pipeline.transfer_study.study_pds import ROBOT_PD
from motorprior.pipeline.transfer_study.study_report import build_study_report
from motorprior.pipeline.transfer_study.study_settings import FITS, SPREADS
from motorprior.report.plots_forest import forest, profiles
from motorprior.report.plots_style import MODEL_COLORS, UNNAMED_COLOR, condition_color, model_label, png_bytes
from motorprior.report.study_sections import first_paragraph, own_speeds
from motorprior.report.study_tables import (
    headline_markdown,
    headline_rows,
    measure_tables,
    standing_table,
    step_tables,
    twin_table,
)
from motorprior.transfer.statistics import Estimate
from motorprior.transfer.study_summary import Summary, summarise
from motorprior.transfer.walk_table import OWN_ABROAD, WalkRow, WalkTable

OWN_NAME = "my_own_choice_of_motors"
NAMES = (*CONDITIONS, OWN_NAME, "another_name_that_is_far_too_long_for_any_picture_or_table")
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
MEASURE = """<script>
const wide = [...document.querySelectorAll(".scroll")].filter(box => box.scrollWidth > box.clientWidth + 1);
const broken = [...document.images].filter(image => !image.complete || image.naturalWidth < 50);
const found = [document.images.length, broken.length, document.querySelectorAll(".scroll").length, wide.length,
  document.documentElement.scrollWidth - document.documentElement.clientWidth];
document.body.setAttribute("data-found", found.join(" "));
</script>"""


@pytest.fixture(scope="module")
def summary() -> Summary:
    return summarise(invented(NAMES, seeds=8, draws=2), enough_draws=2)


FIT = {"constants": {"kp": 7.0, "kd": 0.8, "torque_limit": 1.5}, "error": 0.04, "evaluations": 173, "converged": True}
WALKED = {"speed": 0.5, "upright": 0.87, "own_speed": 0.4, "own_upright": 0.7}


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory, summary: Summary) -> Path:
    run = tmp_path_factory.mktemp("study")
    shown = [("own", "prior"), ("fleet", "prior"), ("fleet", OWN_NAME)]
    traces = {f"{place}/{name}": steps_in_place(60) for place, name in shown}
    write_study(run, invented(NAMES, seeds=8, draws=2), {**traces, "fleet/paper": steps_in_place(5)})
    write_json(run / "fits" / FITS, {"ideal_pd": FIT, "pd_friction": FIT | {"converged": False}})
    for folder in ("fits", "priors/rollout", "robots/fleet_0", "robots/fleet_0_pd_adapted"):
        write_json(run / folder / MARKER, {"seconds": 12.25})
    write_json(run / "robots" / "fleet_0_pd_adapted" / ROBOT_PD, FIT | {"evaluations": 811, "converged": False})
    write_json(run / "spreads" / SPREADS, {"fleet": "mixed", "tried": {"0.1": WALKED, "0.3": WALKED}, "chosen": 0.3})
    return build_study_report(run, "motorprior transfer", summary)


def test_a_browser_shows_every_picture_and_no_table_is_cut(page: Path, tmp_path: Path):
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no browser: install Chromium")
    measured = tmp_path / "page.html"
    measured.write_text(page.read_text("utf-8").replace("</body>", MEASURE + "</body>"), "utf-8")
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--window-size=1000,2000", "--virtual-time-budget=5000", "--dump-dom", measured.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    found = re.search(r'data-found="([-\d ]+)"', shown)
    assert found, shown[:500]
    images, broken, tables, cut, beyond = map(int, found[1].split())
    assert (images, broken) == (2 + 3 * 2 + 1, 0), "speeds, profiles, frames and footfalls of three walks, a film"
    assert tables == 1 + 2 + (len(PLACES) - 1) + 2 + 2 * len(PLACES) + 1 + 3, "two of what counts, three of the fits"
    assert (cut, beyond) == (0, 0)


def test_the_first_paragraph_says_first_what_does_not_hold(page: Path, summary: Summary):
    text = page.read_text("utf-8")
    subtitle = re.search(r'<p class="subtitle">(.*?)</p>', text, re.DOTALL)
    assert subtitle and subtitle.start() < text.index("<nav")
    assert re.match(r"\d of 8 targets do not hold: ", subtitle[1])
    words = first_paragraph(summary)
    held = [words.index(each.said) for each in summary.targets if each.holds]
    failed = [words.index(each.said) for each in summary.targets if each.holds is False]
    assert held and failed and max(failed) < min(held)


def test_the_page_says_what_every_fit_took_and_which_had_not_converged(page: Path, tmp_path: Path):
    text = page.read_text("utf-8")
    chapter = text[text.rindex("What the fits took") :]
    assert "The fit of pd_friction had not converged" in chapter and "173" in chapter
    assert "±30\u00a0%, chosen" in chapter and "fleet “mixed”" in chapter
    assert "Of the 1 PDs that are fitted to the log of one robot 0 had converged, after 811 runs" in chapter
    assert chapter.count("12.2") == 4 and "1 posteriors of one robot each" in chapter
    write_study(tmp_path, table_of({("own", "prior"): [[0.1, 0.2]]}), {})
    assert "What the fits took" not in build_study_report(tmp_path, "motorprior transfer").read_text("utf-8")
    write_json(tmp_path / "fits" / FITS, {"ideal_pd": {"error": 0.04}})
    with pytest.raises(ArtifactError, match="no fits of a study"):
        build_study_report(tmp_path, "motorprior transfer")


def test_a_study_without_twins_has_a_page_too(tmp_path: Path):
    write_study(tmp_path, table_of({("own", "prior"): [[0.1, 0.2]]}), {})
    text = build_study_report(tmp_path, "motorprior transfer").read_text("utf-8")
    assert (
        "it has 1 policies per condition and 0 walks of each at a twin" in text
        and "cannot be told" in text
        and "What counts" not in text
        and "not measured" in text
    )


def test_a_study_of_few_policies_says_so_first():
    words = first_paragraph(summarise(invented(("prior", "oracle"), ("own", "fleet"), seeds=3)))
    assert words.startswith(
        "This study decides nothing: it has 3 policies per condition and 6 walks of each at a twin; 8 and 32"
    )


def test_the_page_has_the_settings_and_the_command(page: Path):
    text = page.read_text("utf-8")
    assert "seconds" in text and "10.0" in text and "<code>motorprior transfer</code>" in text
    assert "Gaits: own simulation" in text and "Gaits: fleet" in text and "Gaits: hard" not in text
    assert len(text) < 2_000_000


def test_the_same_files_give_the_same_page(page: Path, summary: Summary):
    before = page.read_bytes()
    assert build_study_report(page.parent, "motorprior transfer", summary).read_bytes() == before


def test_every_condition_of_the_study_has_its_own_name_and_colour():
    colors = {name: to_rgb(condition_color(name)) for name in CONDITIONS}
    for one, other in combinations(colors, 2):
        assert max(abs(a - b) for a, b in zip(colors[one], colors[other], strict=True)) > 0.1, (one, other)
    assert len({model_label(name) for name in CONDITIONS}) == len(CONDITIONS)
    assert all("_" not in model_label(name) for name in CONDITIONS)
    assert condition_color(OWN_NAME) == UNNAMED_COLOR not in MODEL_COLORS.values()
    assert condition_color("prior_of_ours") == MODEL_COLORS["prior"]


def letters_outside(figure: Figure) -> list[str]:
    """Texts that reach beyond the picture, or that lie on one another."""
    FigureCanvasAgg(figure).draw()
    axis_and_limits = [
        (axis, sorted(limits))
        for axes in figure.axes
        for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim()))
    ]
    ticks = [(tick, limits) for axis, limits in axis_and_limits for tick in axis.get_major_ticks()]
    unseen = [tick.label1 for tick, (low, high) in ticks if not low <= tick.get_loc() <= high]
    texts = [each for each in figure.findobj(Text) if isinstance(each, Text) and each.get_visible()]
    boxes = {each: each.get_window_extent() for each in texts if each.get_text().strip() and each not in unseen}
    edge = figure.bbox
    out = [
        each.get_text()
        for each, box in boxes.items()
        if box.x0 < edge.x0 or box.y0 < edge.y0 or box.x1 > edge.x1 or box.y1 > edge.y1
    ]
    return out + [
        f"{one.get_text()} on {other.get_text()}"
        for (one, a), (other, b) in combinations(boxes.items(), 2)
        if min(a.x1, b.x1) - max(a.x0, b.x0) > 1.0 and min(a.y1, b.y1) - max(a.y0, b.y0) > 1.0
    ]


def speeds_of(names: tuple[str, ...]) -> dict[str, Estimate]:
    return {name: Estimate(0.1 * number, 0.1 * number - 0.05, 0.1 * number + 0.05) for number, name in enumerate(names)}


@pytest.mark.parametrize("twins", [1, 2, 3, 4, 5])
def test_text_stays_within_the_pictures(twins: int):
    rng = np.random.default_rng(0)
    titles = ["fleet", "foreign motors", "hard", "PyBullet", "one_more"][:twins]
    own = {title: {name: 0.5 for name in NAMES} for title in titles}
    assert letters_outside(forest({title: speeds_of(NAMES) for title in titles}, own, NAMES)) == []
    walks = {title: {name: rng.random((3, 4)) for name in NAMES} for title in titles}
    figure = profiles(walks)
    assert letters_outside(figure) == []
    assert len(figure.axes) == twins and all("[" in axes.get_xlabel() for axes in figure.axes[-2:])


def test_the_forest_has_a_row_per_condition_and_hollow_marks_for_training():
    estimates = {"prior": Estimate(0.4, 0.3, 0.5), "paper": Estimate(float("nan"), float("nan"), float("nan"))}
    (axes,) = forest({"fleet": estimates}, {"fleet": {"prior": 0.45, "paper": 0.2}}, ("paper", "prior", "oracle")).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["paper", "sampled prior", "oracle"]
    hollow = [line for line in axes.lines if line.get_markerfacecolor() == "white"]
    assert [tuple(np.asarray(line.get_xydata())[0]) for line in hollow] == [(0.2, 0), (0.45, 1)]
    full = [line for line in axes.lines if line not in hollow]
    np.testing.assert_array_equal(full[0].get_xydata(), [(0.3, 1), (0.5, 1)])
    np.testing.assert_array_equal(full[1].get_xydata(), [(0.4, 1)])
    assert {to_rgb(line.get_color()) for line in full} == {to_rgb(MODEL_COLORS["prior"])}


def test_what_is_trained_for_foreign_motors_is_compared_with_its_own_training():
    speeds = {
        (OWN_ABROAD, "oracle"): 0.3,
        ("foreign", "oracle"): 0.2,
        ("own", "oracle"): 0.6,
        ("fleet", "oracle"): 0.5,
    }
    table = table_of({pair: [[speed] * 2] * 2 for pair, speed in speeds.items()})
    assert own_speeds(table, "foreign") == {"oracle": pytest.approx(0.3)}
    assert own_speeds(table, "fleet") == {"oracle": pytest.approx(0.6)}
    summary = summarise(table)
    assert summary.places() == ["own", "fleet", "foreign"]
    assert summary.ratios["foreign", "oracle"].value == pytest.approx(0.2 / 0.3)


def test_a_profile_falls_from_all_walks_to_none():
    (axes,) = profiles({"fleet": {"prior": np.array([[0.2, 0.4]]), "paper": np.full((1, 2), np.nan)}}).axes
    x, y = axes.lines[0].get_data()
    assert np.interp([0.1, 0.3], np.asarray(x), np.asarray(y)).tolist() == [1.0, 0.5] and np.asarray(y)[-1] == 0.0
    assert png_bytes(profiles({"fleet": {"paper": np.full((1, 2), np.nan)}}), dpi=40)


def test_the_headline_has_a_row_per_condition_and_a_cell_per_place():
    table = table_of(
        {
            ("own", "prior"): [[0.5]] * 8, ("own", "ideal_pd"): [[0.2]] * 8, ("own", OWN_NAME): [[0.3]] * 8,
            ("fleet", "prior"): [[0.4, 0.4]] * 8, ("fleet", "ideal_pd"): [[0.1, 0.1]] * 8,
        }, upright=0.996, drift=0.123,
    )  # fmt: skip
    rows, beside = headline_rows(summarise(table)), "99\u00a0% [99,\u00a099], 0.12\u00a0m"
    assert rows == [
        ["ideal_pd", f"0.20 [0.20,\u00a00.20], {beside}", f"0.10↓ [0.10,\u00a00.10], {beside}"],
        ["prior", f"0.50 [0.50,\u00a00.50], {beside}", f"0.40 [0.40,\u00a00.40], {beside}"],
        [OWN_NAME, f"0.30 [0.30,\u00a00.30], {beside}", "–"],
    ]
    lines = headline_markdown(summarise(table)).splitlines()
    assert lines[0] == "| trained on | own simulation | fleet |" and lines[1] == "| --- | --- | --- |"
    assert (
        lines[2]
        == "| ideal PD | 0.20 [0.20, 0.20], 99 % [99, 99], 0.12 m | 0.10↓ [0.10, 0.10], 99 % [99, 99], 0.12 m |"
    )
    assert lines[4].startswith("| my own choice of motors | ") and lines[5] == ""


def test_a_twins_table_compares_with_prior_and_oracle():
    table = table_of(
        {
            (place, name): [[speed * part] * 2] * 8
            for place, part in (("own", 1.0), ("fleet", 0.5))
            for name, speed in {"prior": 0.8, "oracle": 0.9, "ideal_pd": 0.2}.items()
        }
    )
    rows = {row[0]: row[1:] for row in twin_table(summarise(table), "fleet").rows}
    assert rows["ideal_pd"][1] == "0.50" and rows["ideal_pd"][-2:] == ("100\u00a0%", "< 0.001")
    assert rows["ideal_pd"][2:4] == ("0.35 [0.35,\u00a00.35]", "0.30 [0.30,\u00a00.30]")
    assert rows["oracle"][2] is None and rows["oracle"][3] == "−0.05 [−0.05,\u00a0−0.05]"
    assert rows["prior"][-3:] == (None, None, None)


def test_a_step_tells_how_much_better_it_is():
    table = table_of(
        {(place, name): [[0.4] * 2] * 8 for place in ("own", "fleet") for name in ("tuned_pd", "pd_friction")},
        upright=0.5,
    )  # fmt: skip
    better = [
        WalkRow(walk.place, walk.condition, walk.seed, walk.draw, {**walk.measures, "upright": 1.0})
        if walk.condition == "pd_friction" else walk
        for walk in table.walks
    ]  # fmt: skip
    speed, upright = step_tables(summarise(WalkTable.of(better)))
    assert speed.columns == upright.columns == ("step", "fleet")
    assert [row[1] for each in (speed, upright) for row in each.rows] == [
        "0.000 [0.000,\u00a00.000]", "+50.0* [+50.0,\u00a0+50.0]",
    ]  # fmt: skip
    assert str(speed.rows[0][0]).endswith(": Coulomb friction") and "how much faster" in speed.caption.lower()


def test_how_many_policies_stand_is_told_at_every_place():
    walks = table_of({(place, "prior"): [[0.4] * 2] * 8 for place in ("own", "fleet")}, upright=1.0).walks
    fallen = [
        WalkRow(walk.place, walk.condition, walk.seed, walk.draw, {**walk.measures, "upright": 0.3})
        if (walk.place, walk.seed) == ("fleet", 5) else walk
        for walk in walks
    ]  # fmt: skip
    table = standing_table(summarise(WalkTable.of(fallen)))
    assert table.columns == ("trained on", "own simulation", "fleet")
    assert table.rows == (("prior", "100\u00a0%", "88\u00a0%"),)


def test_a_measure_that_is_not_known_has_no_column(summary: Summary):
    for place, known in (("fleet", True), ("pybullet", False)):
        way, legs = measure_tables(summary, place, ["FR", "RL"])
        assert ("cost of transport [-]" in way.columns) is known
        assert legs.columns[-3:] == ("foot lift [mm]", "foot lift FR [mm]", "foot lift RL [mm]")
        assert len(way.rows) == len(legs.rows) == len(NAMES)


@pytest.mark.parametrize("name", ["walks.csv", "traces.safetensors", "study.json"])
def test_a_study_that_lacks_a_file_is_refused(tmp_path: Path, name: str):
    write_study(tmp_path, table_of({("own", "prior"): [[0.1]]}), {})
    (tmp_path / name).unlink()
    with pytest.raises(ArtifactError) as caught:
        build_study_report(tmp_path, "motorprior transfer")
    assert name in str(caught.value)


@pytest.mark.parametrize(
    ("header", "trace"),
    [
        ({}, steps_in_place(3)),
        ({"robot": "pupper_v2"}, steps_in_place(3)),
        ({"robot": "pupper_v2", "control_dt": 0.0}, steps_in_place(3)),
        ({"robot": "pupper_v2", "control_dt": 0.01}, np.zeros((3, 5))),
    ],
)
def test_traces_that_are_none_are_refused(tmp_path: Path, header: dict, trace: np.ndarray):
    write_study(tmp_path, table_of({("own", "prior"): [[0.1]]}), {})
    write_tensors(tmp_path / "traces.safetensors", {"own/prior": trace}, header)
    with pytest.raises(ArtifactError, match=r"traces\.safetensors.*run the study again"):
        build_study_report(tmp_path, "motorprior transfer")


def test_settings_that_are_no_table_are_refused(tmp_path: Path):
    write_study(tmp_path, table_of({("own", "prior"): [[0.1]]}), {})
    write_json(tmp_path / "study.json", [1])
    with pytest.raises(ArtifactError, match=r"study\.json.*not a table"):
        build_study_report(tmp_path, "motorprior transfer")
