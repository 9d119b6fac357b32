"""Runs a sweep every hour: `python prefect_flow.py` serves it; `python prefect_flow.py now` runs it once.

MAGLINE_SPEC is the path of the spec, MAGLINE the path of the program.
"""

import json
import os
import subprocess
import sys
import tempfile

from prefect import flow, get_run_logger, task

SPEC = os.environ.get("MAGLINE_SPEC", "/srv/sweep/spec.toml")
MAGLINE = os.environ.get("MAGLINE", "magline")


class Stopped(Exception):
    """The time limit or a signal stopped the run; the next run resumes it."""


def goes_on(task, run, state) -> bool:
    """Whether a retry may succeed."""
    try:
        state.result()
    except Stopped:
        return True
    except Exception:
        return False
    return False


@task(retries=3, retry_delay_seconds=10, retry_condition_fn=goes_on)
def magline_run(spec: str) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        summary = os.path.join(folder, "summary.json")
        command = [MAGLINE, "run", spec, "--quiet", "--settle", os.environ.get("MAGLINE_SETTLE", "2m"),
                   "--max-time", "6h", "--summary", summary]
        done = subprocess.run(command, stderr=subprocess.PIPE, text=True)
        if not os.path.exists(summary):
            raise RuntimeError(done.stderr)
        with open(summary) as file:
            said = json.load(file)
    if done.returncode in (4, 130):
        raise Stopped(done.stderr)
    if done.returncode not in (0, 3):
        raise RuntimeError(done.stderr)
    return said


@flow(name="magline-sweep")
def sweep(spec: str = SPEC) -> dict:
    said = magline_run(spec)
    get_run_logger().info("%s: version %s, %s", said["status"], said["version"], said["units"])
    return said


if __name__ == "__main__":
    if sys.argv[1:] == ["now"]:
        sweep()
    else:
        sweep.serve(name="hourly", cron="0 * * * *")
