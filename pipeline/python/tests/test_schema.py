"""The JSON Schema of `magline schema`, by the validator `jsonschema`."""

import copy
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import tomllib
from jsonschema import Draft7Validator

EXAMPLES = Path(__file__).parents[3] / "datasets/examples"
SPECS = sorted(path for path in EXAMPLES.glob("*.toml") if not path.stem.endswith((".synth", "_mapping")))


@pytest.fixture(scope="module")
def validator() -> Draft7Validator:
    """Validator of the schema that the command prints."""
    printed = subprocess.run([sys.executable, "-m", "magline", "schema"], capture_output=True, check=True).stdout
    schema = json.loads(printed)
    Draft7Validator.check_schema(schema)
    return Draft7Validator(schema)


def read(path: Path) -> dict[str, Any]:
    """Spec without dates, which JSON lacks."""
    return json.loads(json.dumps(tomllib.loads(path.read_text()), default=str))


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_schema_accepts_every_example(validator: Draft7Validator, path: Path) -> None:
    errors = [f"{list(e.absolute_path)}: {e.message[:300]}" for e in validator.iter_errors(read(path))]
    assert errors == []


def test_schema_rejects_what_check_rejects(validator: Draft7Validator) -> None:
    good = read(EXAMPLES / "osborne.toml")

    def changed(*place: Any, value: Any) -> dict[str, Any]:
        spec = copy.deepcopy(good)
        inner: Any = spec
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
        return spec

    stages = {stage["name"]: number for number, stage in enumerate(good["stages"])}
    assert validator.is_valid(good)
    for wrong in [
        changed("stage", value=[]),
        changed("seed", value=-1),
        changed("seed", value="7"),
        changed("tables", "anomaly", "altm", value=500),
        changed("stages", stages["even"], "rate_hz", value="ten"),
        changed("stages", stages["even"], "rate_hz", value=0),
        changed("stages", stages["even"], "ratehz", value=10),
        changed("stages", stages["even"], "stage", value="resampel"),
        changed("stages", stages["coefficients"], "model", value="tolles_lawsen"),
        changed("stages", stages["coefficients"], "epochs", value=10),
        changed("stages", stages["track"], "filter", value="ekff"),
        changed("stages", stages["scores"], "metrics", value=["drms", "dmrs"]),
        changed("publish", "titel", value="x"),
    ]:
        assert not validator.is_valid(wrong)
    # A number may be an axis.
    assert validator.is_valid(changed("stages", stages["even"], "rate_hz", value="$rate"))
