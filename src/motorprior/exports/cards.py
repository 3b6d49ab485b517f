"""Motor cards: a prior with a page about it. The package ships cards of motors whose public logs allow it."""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

from motorprior.actuator.constants import COLUMNS
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import CARD_PRIOR, MotorPrior, card_file, shipped_cards
from motorprior.artifacts import write_text
from motorprior.bench.class_behaviour import class_behaviours
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.exports.exporter import Exporter, Request

PICTURE = "behaviour.png"


def from_pretrained(name: str | Path) -> MotorPrior:
    """The prior of a motor card: a shipped one by name (`shipped_cards`), or your folder.

    Raises:
        ArtifactError: neither a shipped card nor a folder with a prior.
    """
    path = card_file(str(name)) or Path(name) / CARD_PRIOR
    if not path.is_file():
        remedy = f"give a folder with {CARD_PRIOR}, or one of {', '.join(shipped_cards())}"
        raise ArtifactError("no motor card", where=name, remedy=remedy)
    return MotorPrior.load(path)


def write_card(
    prior: MotorPrior, folder: Path, about: Mapping[str, str | float] | None = None
) -> list[Path]:
    """Write prior, page and picture; ``about`` are more lines of the front matter, such as the licence."""
    from PIL import Image

    from motorprior.report.plots import draw_class_behaviours  # here: it imports matplotlib
    from motorprior.report.plots_style import png_bytes

    prior.save(folder / CARD_PRIOR)
    write_text(folder / "README.md", _page(prior, folder.name, about or {}))
    picture = Image.open(BytesIO(png_bytes(draw_class_behaviours(class_behaviours(prior)), dpi=80)))
    # a quarter of the bytes
    picture.convert("RGB").quantize(32).save(folder / PICTURE, optimize=True)
    return [folder / CARD_PRIOR, folder / "README.md", folder / PICTURE]


def _page(prior: MotorPrior, name: str, about: Mapping[str, str | float]) -> str:
    gains = (
        "absolute"
        if not prior.model.gain_unit
        else f"multiples of the logged gains [{prior.model.gain_unit}]"
    )
    front: dict[str, str | float] = {
        "robot": prior.robot,
        "motor": prior.motor,
        "training_motors": len(prior.mean),
        "joints": ", ".join(prior.joint_names) or "bench",
        "gains": gains,
        "period_s": prior.model.period,
        **{
            name: value
            for name, value in prior.metrics.items()
            if name in ("replay_rmse", "minutes_of_log")
        },
        **about,
    }
    lines = [
        "---",
        *(f"{name}: {_yaml(value)}" for name, value in front.items()),
        "---",
        "",
        f"# {prior.motor}",
        "",
    ]
    lines += [f'`mp.from_pretrained("{name}").sample(n, seed=0)` samples n of these motors.', ""]
    lines += [f"![Step, chirp and friction of samples and training motors]({PICTURE})", ""]
    lines += [*(f"- {line}" for line in prior.spread_notes()), ""]
    for each in prior.classes.names:
        rows = [COLUMNS, ("---",) * len(COLUMNS), *prior.constants(each).cells]
        lines += [f"## Constants of sampled motors{f', {each}' if each else ''}", ""]
        lines += [*(f"| {' | '.join(row)} |" for row in rows), ""]
    return "\n".join(lines) + "\n"


def _yaml(value: str | float) -> str:
    return (
        f"{value:.4g}"
        if isinstance(value, float)
        else f'"{value}"'
        if isinstance(value, str)
        else str(value)
    )


def _write(request: Request) -> list[Path]:
    if isinstance(request.source, MotorPosterior):
        raise ConfigError(
            "a card is of a prior, not of a posterior", remedy="export the prior", argument="format"
        )
    return write_card(request.source, request.out)


CARD = Exporter("card", (), _write)
