"""The command from the extension module."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from pathlib import Path

import magline
import pytest

SCRIPT = Path(sysconfig.get_path("scripts")) / "magline"


def command(*arguments: str, program: list[str] | None = None) -> subprocess.CompletedProcess[str]:
    started = program or [sys.executable, "-m", "magline"]
    return subprocess.run([*started, *arguments], capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("program", [[sys.executable, "-m", "magline"], [str(SCRIPT)]])
def test_the_module_and_the_script_are_the_command(program: list[str]) -> None:
    done = command("--version", program=program)
    assert (done.returncode, done.stdout) == (0, f"magline {magline.__version__}\n")


def test_a_wrong_argument_has_the_exit_status_2() -> None:
    done = command("no-such-command")
    assert done.returncode == 2
    assert "no-such-command" in done.stderr


@pytest.mark.parametrize("program", [[sys.executable, "-m", "magline"], [str(SCRIPT)]])
def test_a_query_runs_in_a_child_process(run: magline.Run, program: list[str]) -> None:
    done = command("sql", "select 41 + 1 as n", "--store", run.store.path, "--format", "csv", program=program)
    assert (done.returncode, done.stdout) == (0, "n\n42\n"), done.stderr


def test_worker_processes_are_started(spec: Path, tmp_path: Path) -> None:
    done = command("run", str(spec), "--set", f"store={tmp_path}", "--engine", "processes", "--threads", "2")
    assert done.returncode == 0, done.stderr
    assert "computed" in done.stdout


def test_the_import_loads_no_optional_library() -> None:
    optional = ["pandas", "polars", "pyarrow", "xarray"]
    code = f"import sys, magline; print([name for name in {optional} if name in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
