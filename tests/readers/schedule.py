"""Validates summary, metrics and events of a run with independent schemas and parsers.

python3 tests/readers/schedule.py SUMMARY METRICS EVENTS, the files of `magline run --summary --metrics --openlineage`.
Needs jsonschema, referencing, prometheus_client and openlineage-python.
"""

import json
import sys
from datetime import datetime
from pathlib import Path

from jsonschema import Draft202012Validator, FormatChecker
from openlineage.client.event_v2 import Job, Run, RunEvent, RunState
from openlineage.client.facet_v2 import column_lineage_dataset, parent_run, schema_dataset
from prometheus_client.parser import text_string_to_metric_families
from referencing import Registry, Resource

ROOT = Path(__file__).resolve().parents[2]
SCHEMAS = [json.loads(f.read_text()) for f in sorted((ROOT / "tests/reference/openlineage").glob("*.json"))]
REGISTRY = Registry().with_resources((s["$id"], Resource.from_contents(s)) for s in SCHEMAS)


def valid(schema, value):
    Draft202012Validator(schema, registry=REGISTRY, format_checker=FormatChecker()).validate(value)


def facets(value):
    if isinstance(value, dict):
        if "_schemaURL" in value:
            valid({"$ref": value["_schemaURL"]}, value)
        for inner in value.values():
            facets(inner)
    elif isinstance(value, list):
        for inner in value:
            facets(inner)


def the_client_takes(event):
    """The classes of the client reject invalid UUIDs, times and addresses."""
    run = event["run"]["facets"]
    if "parent" in run:
        parent_run.ParentRunFacet(
            run=parent_run.Run(run["parent"]["run"]["runId"]), job=parent_run.Job(**run["parent"]["job"]))
    for output in event["outputs"]:
        fields = output["facets"]["schema"]["fields"]
        schema_dataset.SchemaDatasetFacet([schema_dataset.SchemaDatasetFacetFields(**f) for f in fields])
        for column in output["facets"]["columnLineage"]["fields"].values():
            for field in column["inputFields"]:
                made = [column_lineage_dataset.Transformation(**t) for t in field["transformations"]]
                column_lineage_dataset.InputField(field["namespace"], field["name"], field["field"], made)
    RunEvent(eventTime=event["eventTime"], producer=event["producer"], eventType=RunState(event["eventType"]),
             run=Run(event["run"]["runId"]), job=Job(event["job"]["namespace"], event["job"]["name"]))


def main(summary, metrics, events):
    said = json.loads(Path(summary).read_text())
    valid(json.loads((ROOT / "datasets/examples/schedule/run_summary.schema.json").read_text()), said)

    families = {f.name: f for f in text_string_to_metric_families(Path(metrics).read_text())}
    units = {(s.labels["table"], s.labels["outcome"]): s.value for s in families["magline_run_units"].samples}
    for table in said["tables"]:
        for outcome in ("computed", "reused", "failed", "skipped"):
            assert units[table["name"], outcome] == table[outcome], (table, outcome)
    (status,) = families["magline_run_exit_status"].samples
    assert status.value == said["exit"], status

    found = [json.loads(line) for line in Path(events).read_text().splitlines()]
    states = {}
    for event in found:
        valid({"$ref": event["schemaURL"]}, event)
        facets(event)
        the_client_takes(event)
        datetime.fromisoformat(event["eventTime"].replace("Z", "+00:00"))
        states.setdefault(event["run"]["runId"], []).append(event["eventType"])
    assert said["id"] in states
    for run, kinds in states.items():
        assert kinds[0] == "START" and kinds[1] in ("COMPLETE", "FAIL", "ABORT") and len(kinds) == 2, (run, kinds)
    print(f"{len(families)} metrics, {len(found)} events of {len(states)} runs: valid")


main(*sys.argv[1:])
