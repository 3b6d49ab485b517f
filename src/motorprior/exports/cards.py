"""Motor cards: a prior with a page about it.

The package ships cards of motors whose public logs allow it.
"""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import CARD_PRIOR, MotorPrior, card_file, shipped_cards
from motorprior.artifacts import write_text
from motorprior.bench.class_behaviour import class_behaviours
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.exports.exporter import Exporter, Request

PAGE = "README.md"
PICTURE = "behaviour.png"
_SHOWN_METRICS = ("minutes_of_log", "replay_rmse")  # metrics of the fit in the front matter

FrontMatter = Mapping[str, str | float]


def from_pretrained(name: str | Path) -> MotorPrior:
    """The prior of a motor card: a shipped one by name (`shipped_cards`), or your file or folder.

    Raises:
        ArtifactError: neither a shipped card nor a file or folder with a prior.
    """
    path = card_file(str(name)) or Path(name)
    if path.is_dir():
        path /= CARD_PRIOR
    if not path.is_file():
        remedy = f"give a {CARD_PRIOR} or its folder, or one of {', '.join(shipped_cards())}"
        raise ArtifactError("no motor card", where=name, remedy=remedy)
    return MotorPrior.load(path)


def write_card(prior: MotorPrior, folder: Path, about: FrontMatter | None = None) -> list[Path]:
    """Write prior, page and picture; returns the files.

    ``about`` are more lines of the page's front matter, such as the licence.
    """
    prior.save(folder / CARD_PRIOR)
    write_text(folder / PAGE, _page(prior, folder.name, about or {}))
    _write_picture(prior, folder / PICTURE)
    return [folder / CARD_PRIOR, folder / PAGE, folder / PICTURE]


def _write_picture(prior: MotorPrior, path: Path) -> None:
    from PIL import Image

    from motorprior.report.plots import draw_class_behaviours  # here: it imports matplotlib
    from motorprior.report.plots_style import png_bytes

    figure = draw_class_behaviours(class_behaviours(prior))
    picture = Image.open(BytesIO(png_bytes(figure, dpi=80)))
    # 32 colours need a quarter of the bytes
    picture.convert("RGB").quantize(32).save(path, optimize=True)


def _page(prior: MotorPrior, name: str, about: FrontMatter) -> str:
    lines = ["---"]
    for key, value in _front_matter(prior, about).items():
        lines.append(f"{key}: {_yaml(value)}")
    lines += ["---", ""]

    lines += [f"# {prior.motor}", ""]
    first_class = prior.classes.names[0]
    joints = f'["{first_class}"] * n' if first_class else "n"
    which = f" of the class {first_class}" if first_class else ""
    sample = f'`mp.from_pretrained("{name}").sample({joints}, seed=0)`'
    lines += [f"{sample} samples n motors{which}.", ""]
    lines += [f"![Step, chirp and friction of samples and training motors]({PICTURE})", ""]
    lines += [f"- {note}" for note in prior.spread_notes()]
    lines += [""]

    for joint_class in prior.classes.names:
        suffix = f", {joint_class}" if joint_class else ""
        lines += [f"## Constants{suffix}", ""]
        constants = prior.constants(joint_class)
        rows = [constants.columns, ("---",) * len(constants.columns), *constants.cells]
        lines += [f"| {' | '.join(row)} |" for row in rows]
        lines += [""]
    return "\n".join(lines) + "\n"


def _front_matter(prior: MotorPrior, about: FrontMatter) -> dict[str, str | float]:
    gain_unit = prior.model.gain_unit
    front_matter: dict[str, str | float] = {
        "robot": prior.robot,
        "motor": prior.motor,
        "training_motors": len(prior.mean),
        "joints": ", ".join(prior.joint_names) or "bench",
        "gains": f"multiples of the logged gains [{gain_unit}]" if gain_unit else "absolute",
        "period_s": prior.model.period,
    }
    for name in _SHOWN_METRICS:
        value = getattr(prior.metrics, name)
        if value is not None:
            front_matter[name] = value
    return front_matter | dict(about)


def _yaml(value: str | float) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str):
        return f'"{value}"'
    return str(value)


def _write(request: Request) -> list[Path]:
    if isinstance(request.source, MotorPosterior):
        raise ConfigError(
            "a card is of a prior, not of a posterior", remedy="export the prior", argument="format"
        )
    return write_card(request.source, request.out)


CARD = Exporter(name="card", not_expressed=(), write=_write)
