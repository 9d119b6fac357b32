"""Stages, models and metrics written in Python."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import magline
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import REPOSITORY
from magline import _toml

PARTS = Path(__file__).parent / "own_parts.py"
LINES = ["1.01", "1.02", "1.03"]
ROWS = 400


@pytest.fixture(scope="session")
def parts() -> Any:
    """The module of the parts of the tests."""
    return magline.load_parts(PARTS)


@pytest.fixture(scope="session")
def columns() -> dict[str, dict[str, np.ndarray]]:
    """Columns of three lines: a truth, an aircraft field of three currents, and a vector magnetometer."""
    random = np.random.default_rng(5)
    lines = {}
    for i, line in enumerate(LINES):
        tt = 40_000.0 + 100.0 * i + 0.1 * np.arange(ROWS)
        currents = {f"cur_{k}": np.sin(0.3 * k * tt + i) + random.normal(size=ROWS) for k in (1, 2, 3)}
        truth = 50_000.0 + 20.0 * np.sin(0.05 * tt)
        aircraft = 3.0 * currents["cur_1"] - 2.0 * currents["cur_2"] + 0.5 * currents["cur_3"]
        flux = {f"flux_a_{axis}": random.normal(30_000.0, 500.0, ROWS) for axis in "xyz"}
        noise = random.normal(0.0, 0.2, ROWS)
        lines[line] = {"tt": tt, "mag_1_c": truth, "mag_1_uc": truth + aircraft + noise, **currents, **flux}
    return lines


@pytest.fixture(scope="session")
def spec(tmp_path_factory: pytest.TempPathFactory, columns: dict[str, dict[str, np.ndarray]]) -> dict[str, Any]:
    """A sweep with a stage, a model and two metrics written in Python."""
    path = tmp_path_factory.mktemp("parts") / "flight.parquet"
    tables = []
    for line, values in columns.items():
        keys = {"flight": ["1"] * ROWS, "line": [line] * ROWS}
        tables.append(pa.table(keys | values))
    pq.write_table(pa.concat_tables(tables), path)
    return {
        "name": "own",
        "store": str(path.parent / "store"),
        "tables": {"flights": {"path": str(path)}},
        "axes": {"alpha": [0.1, 100.0]},
        "stages": [
            {"name": "size", "stage": "total", "input": "flights", "vector": "flux_a"},
            {"name": "built_in", "stage": "magnitude", "input": "flights", "vector": "flux_a"},
            {"name": "off", "stage": "derive", "input": "size", "columns": {"off": "mag_1_uc - mag_1_c"}},
            {
                "name": "model",
                "stage": "fit",
                "input": "off",
                "where": "line != '1.03'",
                "model": "sk_ridge",
                "target": "off",
                "features": ["cur_1", "cur_2", "cur_3"],
                "alpha": "$alpha",
            },
            {"name": "clean", "stage": "compensate", "input": "size", "model": "model", "mag": "mag_1_uc"},
            {
                "name": "scores",
                "stage": "score",
                "input": "clean",
                "truth": "mag_1_c",
                "metrics": ["rms_error", "median_error", "own_rms"],
            },
        ],
    }


def files(run: magline.Run) -> dict[str, bytes]:
    """Contents of the published tables."""
    return {str(path.relative_to(run.folder)): path.read_bytes() for path in sorted(run.folder.rglob("*.parquet"))}


def counts(run: magline.Run) -> dict[str, int]:
    return {name: one["computed"] for name, one in run.counts.items() if one["computed"]}


def line_stage(spec: dict[str, Any], **keys: Any) -> dict[str, Any]:
    """The spec with one stage of lines."""
    return {**spec, "axes": {}, "stages": [{"name": "one", "input": "flights", **keys}]}


def table(run: magline.Run, name: str) -> Any:
    """A table in the order of axes, lines and times: a query reads files in any order."""
    found = run.table(name).pandas()
    keys = [key for key in ("alpha", "north", "line", "tt") if key in found.columns]
    return found.sort_values(keys, kind="stable", ignore_index=True)


def toml(path: Path, keys: dict[str, Any]) -> Path:
    """A spec as a file."""
    path.write_text(_toml.document(keys))
    return path


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command with the parts of the tests."""
    given = [sys.executable, "-m", "magline", "--parts", str(PARTS), *map(str, arguments)]
    return subprocess.run(given, capture_output=True, text=True, timeout=300)


def test_a_stage_gives_the_numbers_of_the_built_in_one(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    run = magline.run(spec, store=tmp_path)
    assert run.failures == []
    own, built_in = table(run, "size"), table(run, "built_in")
    assert len(own) == ROWS * len(LINES)
    np.testing.assert_allclose(own["flux_a_total"], built_in["flux_a_t"], rtol=1e-15)


def test_a_model_is_ridge_regression(
    parts: Any, spec: dict[str, Any], columns: dict[str, dict[str, np.ndarray]], tmp_path: Path
) -> None:
    run = magline.run(spec, store=tmp_path)
    x = np.concatenate([np.stack([columns[line][f"cur_{k}"] for k in (1, 2, 3)], axis=1) for line in LINES])
    off = np.concatenate([columns[line]["mag_1_uc"] - columns[line]["mag_1_c"] for line in LINES])
    train = np.repeat([True, True, False], ROWS)
    clean = table(run, "clean")
    for alpha in (0.1, 100.0):
        # The closed solution with an unpenalised constant.
        mean, level = x[train].mean(axis=0), off[train].mean()
        centred = x[train] - mean
        b = np.linalg.solve(centred.T @ centred + alpha * np.eye(3), centred.T @ (off[train] - level))
        expected = level + (x - mean) @ b
        found = clean[np.isclose(clean["alpha"], alpha)].sort_values(["line", "tt"])
        np.testing.assert_allclose(found["mag_aircraft"], expected, rtol=0, atol=1e-8)
    model = table(run, "model")
    assert set(model["model"]) == {"sk_ridge"}
    assert set(model["lines"]) == {"1/1.01, 1/1.02"}


def test_a_registered_metric_is_scored_only_where_it_is_named(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    unnamed = [{k: v for k, v in stage.items() if k != "metrics"} for stage in spec["stages"]]
    run = magline.run({**spec, "stages": unnamed}, store=tmp_path / "store")
    found = set(table(run, "scores")["metric"])
    assert "rms_error" in found
    assert not found & {"median_error", "own_rms"}


def test_metrics_are_scored_pooled_and_shown(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    run = magline.run(spec, store=tmp_path)
    scores = run.scores["scores"]
    assert scores.units == {"median_error": "nT", "own_rms": "nT"}
    clean, lines, pooled = table(run, "clean"), table(run, "scores"), table(run, "scores_pooled")
    for values in (lines["value"], pooled["value"], pooled["value_in_sample"]):
        metric = (lines if len(values) == len(lines) else pooled)["metric"]
        own, built_in = values[metric == "own_rms"], values[metric == "rms_error"]
        assert len(own) >= 2
        np.testing.assert_allclose(own, built_in, rtol=1e-12)
    for record in scores.records():
        here = clean[np.isclose(clean["alpha"], record["alpha"])]
        error = (here["mag_c"] - here["mag_1_c"]).abs()
        of_line = error.groupby(here["line"]).median()
        found = lines[(lines["metric"] == "median_error") & np.isclose(lines["alpha"], record["alpha"])]
        np.testing.assert_allclose(found.set_index("line")["value"].sort_index(), of_line.sort_index(), rtol=1e-12)
        assert set(found["n"]) == {ROWS}
        assert dict(zip(found["line"], found["in_sample"], strict=True)) == {"1.01": True, "1.02": True, "1.03": False}
        # The line that was not fitted is the pooled one.
        assert record["median_error"] == pytest.approx(of_line["1.03"], rel=1e-12)
    means = pooled[pooled["metric"] == "median_error"].set_index("alpha")["value_in_sample"]
    for alpha, value in means.items():
        inside = lines[(lines["metric"] == "median_error") & np.isclose(lines["alpha"], alpha) & lines["in_sample"]]
        assert value == pytest.approx(inside["value"].mean(), rel=1e-12)
    report = run.report(tmp_path / "report.html").read_text()
    assert "median_error" in report and "sk_ridge" in report


def test_threads_and_processes_give_the_same_bytes(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    one, two = (magline.run(spec, store=tmp_path / str(n), threads=n) for n in (1, 2))
    assert files(one) == files(two)
    assert len(files(one)) > 6
    path = toml(tmp_path / "spec.toml", {**spec, "store": str(tmp_path / "processes")})
    done = command("run", path, "--engine", "processes", "--threads", 2, "--json")
    assert done.returncode == 0, done.stderr
    finished = json.loads(done.stdout.splitlines()[-1])
    assert finished["computed"] == sum(counts(one).values())
    folder = Path(finished["folder"])
    found = {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}
    assert found == files(one)


def test_stages_run_in_worker_processes(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    path = toml(tmp_path / "spec.toml", {**line_stage(spec, stage="process"), "store": str(tmp_path / "store")})
    program = [sys.executable, "-m", "magline", f"--parts={PARTS}", "run", str(path), "--engine", "processes"]
    with subprocess.Popen([*program, "--json"], stdout=subprocess.PIPE, text=True) as driver:
        out, _ = driver.communicate(timeout=300)
    assert driver.returncode == 0, out
    numbers = {int(one) for one in magline.Store(tmp_path / "store")["own"]["one"].pandas()["process"]}
    assert numbers and driver.pid not in numbers


def test_a_second_run_computes_nothing_and_another_parameter_only_what_depends_on_it(
    parts: Any, spec: dict[str, Any], tmp_path: Path
) -> None:
    first = magline.run(spec, store=tmp_path)
    again = magline.run(spec, store=tmp_path)
    assert counts(again) == {}
    assert again.id == first.id
    wider = magline.run(spec, set={"axes.alpha": [0.1, 100.0, 1000.0]}, store=tmp_path)
    assert counts(wider) == {"model": 1, "clean": 3, "scores": 3}


SOURCE = """
import magline
from helper import twice

@magline.stage(reads={"mag_1_uc": "nT"}, makes={"scaled": "nT"}, version=1, depends=[twice])
def scale(line, *, power: float = 1.0):
    return scaled(twice(line["mag_1_uc"]))

def scaled(x):
    return FACTOR * x

FACTOR = 1.0
"""


def test_a_changed_source_computes_again_and_why_names_it(spec: dict[str, Any], tmp_path: Path) -> None:
    one = line_stage(spec, stage="scale")
    file, helper = tmp_path / "scale.py", tmp_path / "helper.py"

    def run(source: str, of_helper: str) -> tuple[dict[str, int], float]:
        file.write_text(source)
        helper.write_text(of_helper)
        # Python compares compiled files with their sources to a second.
        sys.modules.pop("helper", None)
        for compiled in (tmp_path / "__pycache__").glob("*"):
            compiled.unlink()
        magline.load_parts(file)
        found = magline.run(one, store=tmp_path / "store")
        return counts(found), float(table(found, "one")["scaled"].mean())

    double = "def twice(x):\n    return 2.0 * x\n"
    first, mean = run(SOURCE, double)
    assert first == {"one": 3}
    # Lines around the stage are not part of it.
    assert run(f"{SOURCE}\n# more\nOTHER = 3\n", double)[0] == {}
    # A constant and a function of the module, and a function in `depends`.
    edits = [
        (SOURCE.replace("FACTOR = 1.0", "FACTOR = 2.0"), double, 2.0),
        (SOURCE.replace("return FACTOR * x", "return 3.0 * FACTOR * x"), double, 3.0),
        (SOURCE, double.replace("2.0", "8.0"), 4.0),
    ]
    for source, of_helper, factor in edits:
        again, found = run(source, of_helper)
        assert again == {"one": 3}, source
        assert found == pytest.approx(factor * mean, rel=1e-12)
    # The first source is still stored.
    assert run(SOURCE, double) == ({}, mean)
    file.write_text(SOURCE.replace("power: float = 1.0", "power: float = 2.0"))
    path = toml(tmp_path / "spec.toml", {**one, "store": str(tmp_path / "store")})
    why = command("--parts", file, "why", path, "one")
    assert why.returncode == 0, why.stderr
    assert "source" in why.stdout and "power" in why.stdout, why.stdout


def test_lineage_reaches_the_file(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    run = magline.run(spec, store=tmp_path)
    tree = command("lineage", "own.scores", "--store", run.store.path).stdout
    assert "size  total v2" in tree, tree
    assert "flux_a_total <- flights.flux_a_x, flights.flux_a_y, flights.flux_a_z" in tree, tree
    assert "flight.parquet" in tree, tree
    about = command("lineage", "own.scores", "--store", run.store.path, "--format", "json").stdout
    for part in magline.parts.registered():
        assert (part.source in about) == (part.name in ("total", "sk_ridge", "median_error", "own_rms")), part


def test_a_stage_that_raises_fails_its_line(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    run = magline.run(line_stage(spec, stage="rough", bad="1.02"), store=tmp_path)
    assert [(failure.stage, failure.line) for failure in run.failures] == [("one", "1.02")]
    assert set(table(run, "one")["line"]) == {"1.01", "1.03"}
    error = pq.read_table(run.folder / "failures")["error"].to_pylist()
    assert len(error) == 1
    for text in ("ValueError", "Traceback", f"{PARTS.name}", "in fail", "in rough"):
        assert text in error[0], error[0]
    assert "parts.py\", line" not in error[0].replace(PARTS.name, ""), "frames of magline itself are left out"
    # The failure is not cached: it may depend on more than the inputs.
    again = magline.run(line_stage(spec, stage="rough", bad="1.02"), store=tmp_path)
    assert len(again.failures) == 1 and counts(again) == {}


@pytest.mark.parametrize(
    ("how", "text"),
    [("short", "399 values for 400 samples"), ("write", "read-only"), ("name", "declares ['seen']")],
)
def test_a_wrong_result_fails_its_line(parts: Any, spec: dict[str, Any], tmp_path: Path, how: str, text: str) -> None:
    run = magline.run(line_stage(spec, stage="rough", bad="1.02", how=how), store=tmp_path)
    assert [failure.line for failure in run.failures] == ["1.02"]
    assert text in run.failures[0].error


def test_the_command_escapes_the_text_of_an_exception(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    keys = {**line_stage(spec, stage="rough", bad="1.02"), "store": str(tmp_path / "store")}
    done = command("run", toml(tmp_path / "spec.toml", keys))
    assert done.returncode == 1
    assert "\x1b" not in done.stdout + done.stderr
    assert "in fail" in done.stderr


def test_columns_have_the_declared_types_units_and_roles(
    parts: Any, spec: dict[str, Any], columns: dict[str, dict[str, np.ndarray]], tmp_path: Path
) -> None:
    keys = {"stage": "several", "columns": ["mag_1_c", "mag_1_uc"], "scale": -1, "kind": "odd"}
    run = magline.run(line_stage(spec, **keys), store=tmp_path)
    assert run.failures == []
    path = sorted((run.folder / "one").rglob("*.parquet"))[0]
    schema = pq.read_schema(path)
    about = {name: schema.field(name).metadata for name in ("mag_1_c_abs", "pair", "sign")}
    assert about["mag_1_c_abs"][b"unit"] == b"nT"
    # A truth column cannot become a feature by way of a stage.
    assert about["mag_1_c_abs"][b"role"] == b"truth"
    assert about["pair"][b"terms"] == b"a,b"
    found = table(run, "one")
    truth = np.concatenate([columns[line]["mag_1_c"] for line in LINES])
    np.testing.assert_array_equal(found["mag_1_uc_abs"] < 0, np.full(len(found), True))
    np.testing.assert_array_equal(np.stack(found["pair"].to_list())[:, 0], truth)
    assert set(found["sign"]) == {"+"}


def test_masked_and_infinite_values_are_missing(
    parts: Any, spec: dict[str, Any], columns: dict[str, dict[str, np.ndarray]], tmp_path: Path
) -> None:
    run = magline.run(line_stage(spec, stage="named", to="held"), store=tmp_path)
    assert run.failures == []
    found = table(run, "one")["held"].to_numpy().reshape(len(LINES), ROWS)
    assert np.isnan(found[:, :2]).all()
    np.testing.assert_array_equal(found[0, 2:], columns["1.01"]["mag_1_uc"][2:])


def test_arrays_are_views_of_the_run(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    found = table(magline.run(line_stage(spec, stage="address"), store=tmp_path), "one")
    assert set(found["address"]) == {0.0}
    assert set(found["writeable"]) == {0.0}


def test_a_pickled_model_is_read_from_its_table(
    parts: Any, spec: dict[str, Any], columns: dict[str, dict[str, np.ndarray]], tmp_path: Path
) -> None:
    stages = [dict(stage) for stage in spec["stages"]]
    del stages[3]["alpha"]
    stages[3] |= {"model": "line_means", "shift": 1.5}
    run = magline.run({**spec, "axes": {}, "stages": stages[:5]}, store=tmp_path)
    assert run.failures == []
    off = [float((columns[line]["mag_1_uc"] - columns[line]["mag_1_c"]).mean()) for line in LINES[:2]]
    clean = table(run, "clean")
    np.testing.assert_allclose(clean["mag_aircraft"], np.mean(off) + 1.5, rtol=1e-9)
    assert set(clean["mag_aircraft_sigma"]) == {2.5}
    terms = list(table(run, "model")["term"])
    assert "family python" in terms and any(term.startswith("pickle[1] ") for term in terms)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"stage": "several", "columns": ["mag_9"]}, "mag_9"),
        ({"stage": "several", "columns": ["cur_1"], "kind": "plan"}, "`plain`"),
        ({"stage": "several", "columns": ["cur_1"], "scale": "much"}, "must be a number"),
        ({"stage": "several", "columns": ["cur_1"], "scales": 1.0}, "did you mean `scale`"),
        ({"stage": "several"}, "needs `columns`"),
        ({"stage": "total", "vector": "cur"}, "cur_x"),
        ({"stage": "no_such_part"}, "--parts FILE.py"),
        ({"stage": "named", "to": "a b"}, "not a valid column name"),
        ({"stage": "named", "to": "tt"}, "key of every line"),
        ({"stage": "named", "to": "alt"}, "`alt` is in m, but the stage declares nT"),
    ],
)
def test_wrong_specs_are_rejected(parts: Any, spec: dict[str, Any], keys: dict[str, Any], text: str) -> None:
    with pytest.raises(magline.SpecError) as caught:
        magline.check(line_stage(spec, **keys))
    assert text in str(caught.value), str(caught.value)


def test_names_of_other_parts_are_refused(parts: Any) -> None:
    with pytest.raises(ValueError, match="built-in"):

        @magline.stage(reads=["tt"], makes={"x": "1"}, version=1)
        def resample(line: magline.Line) -> float:
            return 0.0

    with pytest.raises(ValueError, match="already the name of"):

        @magline.stage(reads=["tt"], makes={"x": "1"}, version=1)
        def total(line: magline.Line) -> float:
            return 0.0

    with pytest.raises(ValueError, match="has the same name as another key"):

        @magline.model(version=1)
        def taking(*, target: str = "") -> object:
            return object()

    with pytest.raises(ValueError, match="built-in"):

        @magline.metric(unit="nT", version=1)
        def std_error(error: np.ndarray) -> float:
            return 0.0


def test_sources_that_do_not_hold_the_whole_part_are_refused() -> None:
    factor = 2.0
    with pytest.raises(ValueError, match="`factor` of an enclosing function, .* the value of `factor`;"):

        @magline.stage(reads=["tt"], makes={"x": "1"}, version=1)
        def captured(line: magline.Line) -> np.ndarray:
            return factor * line["tt"]

    scope: dict[str, Any] = {"magline": magline}
    code = "def unseen(line):\n    return line['tt']\n"
    exec(code, scope)
    with pytest.raises(ValueError, match="source of `unseen` is not available"):
        magline.stage(reads=["tt"], makes={"x": "1"}, version=1)(scope["unseen"])


def test_a_file_that_fails_ends_the_command(tmp_path: Path) -> None:
    file = tmp_path / "wrong.py"
    file.write_text("raise RuntimeError('no parts')\n")
    cases = [(["--parts", str(file)], "no parts"), ([f"--parts={tmp_path}/no.py"], "no.py"), (["--parts"], "requires")]
    for arguments, text in cases:
        done = command("stages", *arguments)
        assert done.returncode == 2
        assert text in done.stderr


def test_the_reference_describes_the_parts() -> None:
    assert "--parts FILE.py" in command("--help").stdout
    assert "The magnitude of a vector magnetometer" in command("stages", "total").stdout
    assert "### The model `sk_ridge`" in command("stages", "fit").stdout
    assert "| `median_error` | nT |" in command("stages", "score").stdout


def test_the_example_runs(tmp_path: Path) -> None:
    example = REPOSITORY / "pipeline" / "python" / "examples" / "own_parts.py"
    done = subprocess.run(
        [sys.executable, str(example), str(tmp_path)], capture_output=True, text=True, cwd=REPOSITORY, env=os.environ
    )
    assert done.returncode == 0, done.stderr
    assert "signal_spread" in done.stdout


def test_a_part_of_a_script_is_the_part_of_the_command(tmp_path: Path) -> None:
    """The same file as a script and with `--parts` has the same keys."""
    example = REPOSITORY / "pipeline" / "python" / "examples" / "own_parts.py"
    code = "print(sorted((p.name, p.source) for p in magline.parts.registered()))"
    by_file = textwrap.dedent(f"""
        import runpy, sys, magline
        sys.argv = ["own_parts.py", {str(tmp_path)!r}]
        runpy.run_path({str(example)!r}, run_name=sys.argv.pop(0) and "parts")
        {code}
    """)
    loaded = f"import magline; magline.load_parts({str(example)!r}); {code}"
    found = [
        subprocess.run([sys.executable, "-c", one], capture_output=True, text=True, cwd=REPOSITORY)
        for one in (by_file, loaded)
    ]
    assert all(one.returncode == 0 for one in found), [one.stderr for one in found]
    assert found[0].stdout == found[1].stdout and "own_ridge" in found[0].stdout
