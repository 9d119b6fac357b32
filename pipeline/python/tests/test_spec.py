"""Specs that are built in Python: the same documents, plans and keys as their files."""

from __future__ import annotations

import inspect
import keyword
import re
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

import magline
import numpy as np
import pytest
from conftest import REPOSITORY, tomllib
from magline import Spec

COMMAND = str(Path(sysconfig.get_path("scripts")) / "magline")
SAMPLE = "../samples/magnavjl_tl/magnavjl_tl.parquet"
EXAMPLES = REPOSITORY / "datasets" / "examples"
SPECS = [path for path in sorted(EXAMPLES.glob("*.toml")) if "stages" in tomllib.loads(path.read_text())]


def built(keys: dict[str, Any]) -> Spec:
    """Spec of the same keys, with one call for each part."""
    spec = Spec(keys["name"], seed=keys.get("seed"), store=keys["store"], folder=EXAMPLES)
    search = dict(keys.get("search", {}))
    axes = {name: spec.axis(name, values) for name, values in keys.get("axes", {}).items()}
    for name, axis in search.pop("axes", {}).items():
        given = axis if isinstance(axis, dict) else {"choices": axis}
        axes[name] = spec.search_axis(name, **given)
    if search:
        spec.search(**search)
    for name, table in keys["tables"].items():
        spec.table(name, **table)
    handles = {name: spec[name] for name in spec.tables}
    for stage in keys["stages"]:
        given = {}
        for key, item in stage.items():
            if isinstance(item, str):
                item = handles.get(item, axes.get(item.removeprefix("$"), item) if item.startswith("$") else item)
            if key not in {"stage", "name", "where"}:
                given[f"{key}_" if keyword.iskeyword(key) else key] = item
        handles[stage["name"]] = getattr(spec, stage["stage"])(name=stage["name"], where=stage.get("where"), **given)
    if "publish" in keys:
        spec.publish(**keys["publish"])
    return spec


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_every_example_is_read_built_and_written_back(path: Path, tmp_path: Path) -> None:
    keys = tomllib.loads(path.read_text())
    assert len(SPECS) > 30
    for spec in (Spec.read(path), built(keys), Spec.from_dict(keys)):
        # The document determines the plan. Lists keep their order, and the keys of a table have none.
        assert tomllib.loads(spec.toml()) == keys
        assert list(tomllib.loads(spec.toml()).get("axes", {})) == list(keys.get("axes", {}))
    file = Spec.read(path).write(tmp_path / "moved.toml")
    moved = tomllib.loads(file.read_text())
    for name, table in keys["tables"].items():
        for key in ("path", "mapping"):
            if (path.parent / table.get(key, "")).is_file():
                assert (tmp_path / moved["tables"][name][key]).samefile(path.parent / table[key])


@pytest.mark.parametrize("name", ["tolles_lawson", "search", "uav"])
def test_a_written_spec_is_the_same_plan(name: str, tmp_path: Path) -> None:
    path = EXAMPLES / f"{name}.toml"
    store = ["--set", f"store={tmp_path / 'store'}"]

    def plan(file: Path) -> str:
        return subprocess.check_output([COMMAND, "explain", str(file), *store], text=True, stderr=subprocess.DEVNULL)

    expected = plan(path)
    assert "runs" in expected and "0 of" in expected
    assert plan(Spec.read(path).write(tmp_path / "read.toml")) == expected
    again = built(tomllib.loads(path.read_text()))
    assert plan(again.write(tmp_path / "built.toml")) == expected
    if name == "tolles_lawson":
        assert again.explain(set={"store": tmp_path / "store"}) == expected


def ridge(store: Path, values: Any) -> Spec:
    """The Tolles-Lawson example with other ridge parameters, in Python."""
    source = tomllib.loads((EXAMPLES / "tolles_lawson.toml").read_text())
    spec = Spec(source["name"], store=store, folder=EXAMPLES)
    flights = spec.table("flights", **source["tables"]["flights"])
    terms = spec.a_matrix(name="terms", input=flights, vector="flux_a")
    fit = spec.fit(
        name="coefficients",
        input=terms,
        model="tolles_lawson",
        target="mag_1_uc",
        lambda_=spec.axis("lambda", values),
    )
    clean = spec.compensate(name="clean", input=terms, model=fit, mag="mag_1_uc", detrend=True)
    spec.score(name="scores", input=clean)
    return spec


def test_results_have_the_same_keys(tmp_path: Path) -> None:
    store = tmp_path / "store"
    first = magline.run(EXAMPLES / "tolles_lawson.toml", store=store)
    assert sum(count["computed"] for count in first.counts.values()) > 0
    values = np.array([0.0, 0.001, 0.025, 0.25])
    spec = ridge(store, values)
    values[0] = 7.0  # the spec has a copy
    (tmp_path / "sub").mkdir()
    written = spec.write(tmp_path / "sub" / "written.toml")
    keys = spec.to_dict()
    keys["tables"]["flights"]["path"] = EXAMPLES / SAMPLE
    for same in (spec, written, Spec.read(written), keys):
        again = magline.run(same, store=store)
        assert sum(count["computed"] for count in again.counts.values()) == 0
        assert sum(count["reused"] for count in again.counts.values()) > 0
        assert again.id == first.id
    other = ridge(store, [0.5]).run(store=store)
    assert other.counts["terms"]["computed"] == 0 and other.counts["coefficients"]["computed"] == 1


def test_names_and_handles() -> None:
    spec = Spec("names")
    flights = spec.table("flights", Path("a") / "b.csv", units={"x": "nT"})
    assert [spec.lowpass(input=flights, columns="x").name for _ in range(3)] == ["lowpass", "lowpass_2", "lowpass_3"]
    assert spec.tables == ["flights", "lowpass", "lowpass_2", "lowpass_3"]
    assert str(spec["lowpass_2"]) == "lowpass_2"
    plan = spec.axis("plan", ["a", "b"])
    assert spec.axis("plan", ("a", "b")) == plan == spec.axes["plan"]
    own = spec.stage("my_stage", input=flights, depth=plan)
    assert spec.to_dict()["stages"][-1] == {"name": own.name, "stage": "my_stage", "input": "flights", "depth": "$plan"}
    joined = spec.join(input=flights, with_="lowpass", where=f"flight = '{plan}'", publish=False)
    keys = spec.to_dict()["stages"][-1]
    assert keys.pop("name") == joined.name
    where = "flight = '$plan'"
    assert keys == {"stage": "join", "input": "flights", "where": where, "with": "lowpass", "publish": False}
    assert spec.to_dict()["tables"]["flights"]["path"] == "a/b.csv"
    assert list(tomllib.loads(spec.toml())) == ["name", "store", "tables", "axes", "stages"]
    for wrong in (
        lambda: spec.axis("plan", ["c"]),
        lambda: spec.search_axis("plan", ["c"]),
        lambda: spec.search_axis("depth"),
        lambda: spec.search_axis("depth", [1, 2], low=1),
        lambda: spec.table("lowpass", "c.csv"),
        lambda: spec.lowpass(name="flights", input=flights, columns="x"),
        lambda: Spec("other").lowpass(input=flights, columns="x"),
        lambda: Spec("other").lowpass(input="flights", columns=[plan]),
    ):
        with pytest.raises(ValueError, match="plan|depth|flights|lowpass"):
            wrong()
    with pytest.raises(KeyError, match="lowpass_2"):
        spec["none"]
    for untyped in (
        lambda: spec.axis("n", "abc"),
        lambda: spec.axis("n", 3),
        lambda: spec.table("n", "p", units={"x": object()}),
        lambda: spec.fit(input=flights, model="ridge", target="x", lamda=1.0),
    ):
        with pytest.raises(TypeError, match="list|type|lamda"):
            untyped()


def test_hostile_text_is_written_back(tmp_path: Path) -> None:
    text = 'a"b\\c\n\x00\x1b[31m\x7f\u202e<b>\'\'\'""" é\U0001f6e9'
    spec = Spec(text)
    spec.table(text, text, rename={text: "tt", "": "x", "a.b": "c"})
    spec.axis(text, [text])
    spec.derive(name=text + "2", input=text, columns={text: "1"})
    assert tomllib.loads(spec.toml()) == spec.to_dict()
    assert tomllib.loads(spec.write(tmp_path / "hostile.toml").read_text(encoding="utf-8"))["name"] == text
    for shown in (spec._repr_html_(), repr(spec)):
        assert not {"\x00", "\x1b", "\u202e"} & set(shown)
    assert "<b>" not in spec._repr_html_()


def test_a_spec_that_cannot_be_read(tmp_path: Path) -> None:
    for name, content in (("missing.toml", None), ("broken.toml", b"a = [1"), ("binary.toml", b"\xff\xfe\x00")):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(magline.SpecError, match=name):
            Spec.read(path)


WRONG_FORMS: list[dict[str, Any]] = [
    {},
    {"name": 3, "tables": 3, "axes": [], "stages": "x", "search": 1, "publish": 2},
    {"tables": {"a": 1}, "stages": [1, {"name": 2}, {}], "axes": 1, "other": {"a": {}}},
]


@pytest.mark.parametrize("keys", WRONG_FORMS)
def test_a_spec_of_a_wrong_form_is_reported_by_the_check(keys: dict[str, Any], tmp_path: Path) -> None:
    spec = Spec.from_dict(keys)
    assert repr(spec) and spec._repr_html_() and spec.axes == {}
    assert tomllib.loads(spec.toml()) == keys == spec.to_dict()
    for wrong in (spec, spec.write(tmp_path / "wrong.toml")):
        with pytest.raises(magline.SpecError):
            magline.check(wrong)


def test_a_fault_has_its_place_in_the_text() -> None:
    spec = Spec.read(EXAMPLES / "tolles_lawson.toml")
    keys = spec.to_dict()
    keys["stages"][1]["lamda"] = 1.0
    wrong = Spec.from_dict(keys, folder=EXAMPLES)
    with pytest.raises(magline.SpecError) as caught:
        wrong.check()
    place = caught.value.faults[0].spec_line
    assert place is not None and wrong.toml().splitlines()[place - 1].startswith("lamda")


def test_a_failed_write_keeps_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "spec.toml"
    path.write_text("old")
    path.chmod(0o640)

    def fail(*_: object) -> None:
        raise OSError("no space")

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", fail)
        with pytest.raises(OSError, match="no space"):
            Spec("new").write(path)
    assert path.read_text() == "old" and [one.name for one in tmp_path.iterdir()] == ["spec.toml"]
    Spec("new").write(path)
    assert 'name  = "new"' in path.read_text() and path.stat().st_mode & 0o777 == 0o640
    link = tmp_path / "link.toml"
    link.symlink_to(path)
    Spec("newer").write(link)
    assert link.is_symlink() and 'name  = "newer"' in path.read_text()


def test_the_methods_are_those_of_the_declarations(generator: Any) -> None:
    committed = REPOSITORY / "pipeline/python/magline/_stages.py"
    assert committed.read_text() == generator.generate(COMMAND), "generate.py prints another `_stages.py`"
    listed = subprocess.check_output([COMMAND, "stages"], text=True)
    kinds = re.findall(r"^(\w+) +v\d", listed, re.MULTILINE)
    assert len(kinds) > 30
    reference = (REPOSITORY / "stages/REFERENCE.md").read_text()
    for kind in kinds:
        method = getattr(Spec, kind)
        assert inspect.getdoc(method) and kind not in vars(Spec), kind
        chapter = reference.partition(f"\n## `{kind}` ")[2].partition("\n## ")[0]
        types = "text|number|whole number|boolean|list|table"
        keys = set(re.findall(rf"^\| `(\w+)` \| (?:{types})\b[^|]*\|", chapter, re.MULTILINE))
        found = {name.removesuffix("_") for name in inspect.signature(method).parameters}
        assert keys <= found, kind
