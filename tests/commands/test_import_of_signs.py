"""`logs import` warns, before anything is fitted, where gravity says that the map's signs are not the model's."""

import io
from pathlib import Path

import pytest
from weighed_arm import slow_motion, write_arm, write_table

from motorprior.commands.logs_import import LogsImport, import_logs
from motorprior.progress import Lines


@pytest.mark.parametrize(
    ("turned", "suspended", "warns"), [("", True, False), ("elbow", True, True), ("elbow", False, False)]
)
def test_an_import_with_loads_warns_of_turned_signs(tmp_path: Path, turned: str, suspended: bool, warns: bool):
    robot = write_arm(tmp_path)
    table, columns = write_table(slow_motion(robot), tmp_path, turned)
    said = io.StringIO()
    import_logs(LogsImport((table,), tmp_path / "out", columns=columns, suspended=suspended, robot=robot), Lines(said))
    assert ("with elbow reversed" in said.getvalue()) == warns
    assert said.getvalue().startswith("warning: ") == warns
