"""The command transfer: tables of the evaluation, or of the study, are printed."""

from dataclasses import fields
from typing import Any

from motorprior.cli.terminal import command_line, print_table
from motorprior.commands.transfer import Transfer, TransferCommand, run_study, run_transfer
from motorprior.exceptions import ConfigError
from motorprior.progress import Progress
from motorprior.report.tables import transfer_table
from motorprior.stage import PAGE
from motorprior.studies.compare import NUM_WALKS
from motorprior.studies.study_settings import Study


def run(config: TransferCommand, progress: Progress) -> None:
    """Evaluate policies, or run the study, and print the tables."""
    if config.study:
        _run_study(config, progress)
    else:
        _run_transfer(config, progress)


def _run_study(config: TransferCommand, progress: Progress) -> None:
    if config.policies or config.engine is not None:
        raise ConfigError(
            "a study trains its own policies", remedy="give neither policies nor an engine"
        )
    from motorprior.report.transfer_page import study_sections  # here: it imports matplotlib

    statistics = run_study(Study(**_settings(config, Study)), progress, command_line())
    for section in study_sections(statistics):
        for table in section.tables:
            print_table(table.caption, table.columns, table.rows)
    print(config.out / PAGE)


def _run_transfer(config: TransferCommand, progress: Progress) -> None:
    transfer_settings = _settings(config, Transfer)
    for setting in fields(Study):
        is_changed = getattr(config, setting.name) != setting.default
        if setting.name not in transfer_settings and is_changed:
            raise ConfigError(
                f"{setting.name} needs --study", remedy="add --study", argument=setting.name
            )
    if not config.policies:
        raise ConfigError("no policy given", remedy="give the folders of at least one walk")

    results = run_transfer(Transfer(**transfer_settings), progress)
    title = f"Transfer, {NUM_WALKS} motor samples x 5 s, means over seeds"
    print_table(title, *transfer_table(results))


def _settings(config: TransferCommand, settings: type) -> dict[str, Any]:
    """Values of the fields of the dataclass ``settings``."""
    return {setting.name: getattr(config, setting.name) for setting in fields(settings)}
