"""The page of a demo, from the stages that are finished."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from motorprior.artifacts import read_json, write_text
from motorprior.exceptions import ConfigError
from motorprior.pipeline.identify import PRIOR
from motorprior.pipeline.stage import MARKER
from motorprior.robots.load import load_robot
from motorprior.transfer.robustness import MAPS, load_maps

PAGE, SETTINGS, STAGES = "report.html", "demo.json", "stages.json"
# settings that follow from others: the robot of all but the first section, and whether it replays the logs
WALKER, REPLAYED = "robot_that_walks", "logs_replayed"


def build_report(run: Path) -> Path:
    """Write report.html from the finished stages; returns its path.

    Raises:
        ConfigError: the folder is not that of a demo.
    """
    from motorprior.report import chapters  # here, since they import matplotlib
    from motorprior.report.page import Section, page
    from motorprior.report.real_motors import real_motors

    if not (run / SETTINGS).is_file():
        raise ConfigError(f"no {SETTINGS} in it", where=run, remedy="give the folder that `motorprior demo` wrote")
    demo = read_json(run / SETTINGS)
    settings, finished = demo["settings"], finished_stages(run)
    walks: dict[str, list[Path]] = {}
    for folder in finished:
        if folder.startswith("walk/"):  # walk/CONDITION_SEED
            walks.setdefault(Path(folder).name.rsplit("_", 1)[0], []).append(run / folder)
    maps = {name: f"robustness/{name}_0" for name in walks}

    def robustness() -> list[Section]:
        return [chapters.robustness_section({name: load_maps(run / folder / MAPS) for name, folder in maps.items()})]

    prior = run / "priors" / "rollout" / PRIOR
    stages: dict[str, tuple[list[str], Callable[[], list[Section]]]] = {
        "real_motors": (["real_motors"], lambda: real_motors(run)),
        "bench": (["bench/rollout"], lambda: [chapters.bench(run / "bench" / "rollout")]),
        "identify": (["priors/rollout"], lambda: [chapters.identify(prior, run / "bench" / "rollout")]),
        "validate": (["validate"], lambda: chapters.validate(run / "validate")),
        "replay": (["replay"], lambda: [chapters.replay(run / "replay")]),
        "walk": (["walk/rollout_0"], lambda: [chapters.learning(walks)]),
        "transfer": (["transfer"], lambda: [chapters.transfer(run / "transfer", load_robot(settings[WALKER]))]),
        "robustness": (list(maps.values()) or ["robustness"], robustness),
    }  # name -> folders that it needs, and its sections
    unwanted = {"real_motors"} if settings["logs"] is None else set()
    unwanted |= set() if settings[REPLAYED] else {"replay"}
    sections, pending = [], []
    for name, (needed, make) in stages.items():
        if name == "walk" and settings["logs"] is None:
            sections.append(chapters.no_logs())
        if set(needed) <= set(finished):
            sections += make()
        elif name not in unwanted:
            pending.append(name)
    title = "motorprior: motor logs, motor prior, walking policies, transfer"
    write_text(run / PAGE, page(title, sections, settings, demo["command"], pending))
    return run / PAGE


def finished_stages(run: Path) -> list[str]:
    """Folders of finished stages of the present settings, relative to ``run``, sorted."""
    listed = read_json(run / STAGES) if (run / STAGES).is_file() else []
    return sorted(folder for folder in listed if (run / folder / MARKER).is_file())
