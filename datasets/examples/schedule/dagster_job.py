"""The published tables as one asset, which is updated every hour. Try it with `dagster job execute -f dagster_job.py -j
sweep`.

MAGLINE_SPEC is the path of the spec, MAGLINE the path of the program.
"""

import json
import os
import subprocess
import tempfile

import dagster

SPEC = os.environ.get("MAGLINE_SPEC", "/srv/sweep/spec.toml")
MAGLINE = os.environ.get("MAGLINE", "magline")


@dagster.op(retry_policy=None)
def magline_run(context: dagster.OpExecutionContext) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        summary = os.path.join(folder, "summary.json")
        command = [MAGLINE, "run", SPEC, "--quiet", "--settle", os.environ.get("MAGLINE_SETTLE", "2m"),
                   "--max-time", "6h", "--summary", summary]
        done = subprocess.run(command, stderr=subprocess.PIPE, text=True)
        if not os.path.exists(summary):
            raise dagster.Failure(done.stderr, allow_retries=False)
        with open(summary) as file:
            said = json.load(file)
    if done.returncode in (4, 130):
        raise dagster.RetryRequested(max_retries=3, seconds_to_wait=10)
    if done.returncode == 3:
        context.log.warning(said["error"])
        return said
    if done.returncode != 0:
        raise dagster.Failure(done.stderr, allow_retries=False)
    for table in said["tables"]:
        context.log_event(dagster.AssetMaterialization(
            asset_key=[said["pipeline"], table["name"]],
            metadata={key: table[key] for key in ("computed", "reused", "seconds")} | {"version": said["version"]},
        ))
    return said


@dagster.job
def sweep():
    magline_run()


hourly = dagster.ScheduleDefinition(job=sweep, cron_schedule="0 * * * *")
definitions = dagster.Definitions(jobs=[sweep], schedules=[hourly])
