"""Compiled kernels never outlive the source they were compiled from."""

import os

from motorprior.kernel_cache import choose_folder, source_digest


def test_any_change_of_any_source_file_gives_another_folder(tmp_path):
    (tmp_path / "inner").mkdir()
    kernel, callee = tmp_path / "kernel.py", tmp_path / "inner" / "callee.py"
    kernel.write_text("a")
    callee.write_text("b")
    before = source_digest(tmp_path)
    assert source_digest(tmp_path) == before
    os.utime(callee, ns=(1, 1))
    assert source_digest(tmp_path) != before


def test_the_folder_a_user_chose_is_kept(monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "chosen")
    choose_folder()
    assert os.environ["NUMBA_CACHE_DIR"] == "chosen"


def test_old_folders_are_removed(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for age in range(9):
        folder = tmp_path / "motorprior" / "kernels" / f"old{age}"
        folder.mkdir(parents=True)
        os.utime(folder, (1000 + age, 1000 + age))
    choose_folder()
    left = sorted(path.name for path in (tmp_path / "motorprior" / "kernels").iterdir())
    assert left[-4:] == ["old5", "old6", "old7", "old8"] and len(left) == 5


def test_an_unwritable_home_is_no_error(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    choose_folder()
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_a_folder_that_another_process_removes_meanwhile_is_no_error(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kernels = tmp_path / "motorprior" / "kernels"
    kernels.mkdir(parents=True)
    (kernels / "gone").symlink_to(tmp_path / "nowhere")  # listed, but stat fails as for a removed folder
    choose_folder()
    assert os.environ["NUMBA_CACHE_DIR"].startswith(str(kernels))
