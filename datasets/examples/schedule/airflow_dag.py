"""Runs a sweep every night, with an alert when a unit fails. For Airflow 3 (or 2.10); put this file into the folder
`dags`.

MAGLINE_SPEC is the path of the spec, MAGLINE the path of the program. Try it with `airflow dags test magline_sweep`.
"""

import json
import os
import subprocess
import tempfile
from datetime import datetime, timedelta

try:
    from airflow.sdk import dag, task
    from airflow.sdk.exceptions import AirflowException, AirflowFailException, AirflowSkipException
except ImportError:  # Airflow before 3.0, and names that later versions moved
    try:
        from airflow.sdk import dag, task
    except ImportError:
        from airflow.decorators import dag, task
    from airflow.exceptions import AirflowException, AirflowFailException, AirflowSkipException

SPEC = os.environ.get("MAGLINE_SPEC", "/srv/sweep/spec.toml")
MAGLINE = os.environ.get("MAGLINE", "magline")


@dag(schedule="30 2 * * *", start_date=datetime(2026, 1, 1), catchup=False, max_active_runs=1, tags=["magline"])
def magline_sweep():
    # Exit status 4, the time limit, is retried, and the run resumes; 1 and 2 would fail again in the same way.
    @task(retries=3, retry_delay=timedelta(seconds=10))
    def run() -> dict:
        with tempfile.TemporaryDirectory() as folder:
            summary = os.path.join(folder, "summary.json")
            command = [MAGLINE, "run", SPEC, "--quiet", "--settle", os.environ.get("MAGLINE_SETTLE", "2m"),
                       "--max-time", "6h", "--summary", summary]
            done = subprocess.run(command, stderr=subprocess.PIPE, text=True)
            if not os.path.exists(summary):
                raise AirflowFailException(done.stderr)
            with open(summary) as file:
                said = json.load(file)
        if done.returncode == 3:
            raise AirflowSkipException(said["error"])
        if done.returncode in (1, 2):
            raise AirflowFailException(done.stderr)
        if done.returncode != 0:
            raise AirflowException(done.stderr)
        return {"run": said["run"], "version": said["version"], "units": said["units"]}

    @task
    def report(said: dict) -> None:
        print(f"version {said['version']}: {said['units']}")

    report(run())


magline_sweep()
