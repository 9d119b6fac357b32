"""Examples of the reference: one spec with every stage, model and filter, and a command line for each command.

`build.py` runs them and writes their output into the pages. The stages of the spec are the examples of the program's
declarations, so that they have no second source.
"""

import re
import shutil
import subprocess
from functools import cached_property
from pathlib import Path

from check import DOCS, REPOSITORY, run

TABLES = """name  = "reference"
store = "store"

[tables.flights]
path = "example.synth.toml"

[tables.anomaly]
path  = "datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif"
alt_m = 300.0

[tables.observatory]
path = "datasets/samples/boulder/bou20141104vmin.min"
"""
# A slow flight whose track crosses itself, for the metric of crossings.
CROSSING = """
[tables.crossing]
path = "crossing.synth.toml"
"""
# Stages of the example of a model or a filter.
MODEL = """
[[stages]]
name   = "fit_{name}"
stage  = "fit"
input  = "a_matrix"
where  = "line = '1.01'"
target = "mag_4_uc"
{keys}
[[stages]]
name  = "compensate_{name}"
stage = "compensate"
input = "a_matrix"
model = "fit_{name}"
mag   = "mag_4_uc"

[[stages]]
name    = "score_{name}"
stage   = "score"
input   = "compensate_{name}"
truth   = "mag_1_c"
metrics = ["std_uncompensated", "std_error"]
"""
FILTER = """
[[stages]]
name            = "navigate_{name}"
stage           = "navigate"
input           = "compensate"
where           = "line = '1.02'"
map             = "anomaly"
offset_window_s = 1.0
{keys}
[[stages]]
name    = "score_{name}"
stage   = "score"
input   = ["compensate", "navigate_{name}"]
metrics = ["ins_drms", "{metric}", "nees", "nis"]
"""
# Scores that the example of `score` does not give.
FURTHER = """
[[stages]]
name  = "score_map"
stage = "score"
input = "map_value"
mag   = "mag_1_c"

[[stages]]
name  = "score_track"
stage = "score"
input = ["compensate", "navigate_ekf"]
truth = "mag_1_c"

[[stages]]
name            = "navigate_gnss"
stage           = "navigate"
input           = "compensate"
where           = "line = '1.02'"
map             = "anomaly"
offset_window_s = 1.0
gnss_lost_s     = [100.0, 300.0]
flat_over_m     = 500.0

[[stages]]
name  = "score_gnss"
stage = "score"
input = ["compensate", "navigate_gnss"]

[[stages]]
name    = "score_crossing"
stage   = "score"
input   = "crossing"
mag     = "mag_1_uc"
metrics = ["figure_of_merit_crossings"]
"""
# Columns of stages whose new columns do not show their effect.
SHOWN = {
    "resample": ["mag_4_uc", "flux_a_x"], "despike": ["mag_4_uc"], "simulate_ins": ["ins_lat", "ins_lon", "ins_vn"],
    "select": ["mag_4_uc", "alt"], "derive": ["mag_d", "heading"], "diurnal": ["diurnal"],
    "join": ["mag_4_uc_bp", "flux_a_x"], "navigate": ["lat", "lon", "sd_n", "sd_e"],
    "importance": ['"group"', "value", "spread", "unit"], "summary": ["metric", "value", "low", "high"],
}
SYNTHS = ["example.synth.toml", "crossing.synth.toml"]
ROWS = 3
COLUMNS = 4
LINES = 24
OSBORNE = "datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif"
POINTS = "datasets/samples/britain/britain_sw_survey_points.parquet"

# A short spec for the commands, from examples of stages.
SHORT = ["resample", "a_matrix", "fit", "compensate"]
END = """
[[stages]]
name  = "score"
stage = "score"
input = "compensate"
truth = "mag_1_c"

[publish]
title       = "A simulated flight"
description = "Compensation of a simulated flight over the map of Osborne."
licence     = "CC-BY-4.0"
date        = "2026-01-31"
contact     = "ada@example.org"

[[publish.authors]]
given  = "Ada"
family = "Example"
"""
# Command lines of each command. Servers end by a time limit.
COMMANDS = {
    "run": ["magline run flight.toml"],
    "compact": ["magline compact flight.toml"],
    "tasks": ["magline tasks flight.toml --set store=other | cut -c 1-100"],
    "task": ["magline tasks flight.toml --set store=other | magline task --store other | cut -c 1-100"],
    "scheduler": ["timeout 1 magline scheduler --bind 127.0.0.1:0 --insecure-loopback"],
    "worker": ["timeout 1 magline worker --scheduler 127.0.0.1:1 --insecure-loopback"],
    "check": ["magline check flight.toml"],
    "explain": ["magline explain flight.toml"],
    "why": ["magline why flight.toml compensate --set fit.lambda=0.5"],
    "sql": ["magline sql \"SELECT line, metric, value FROM flight.score WHERE metric LIKE 'std%' ORDER BY line\""],
    "export": ["magline export flight.compensate -o clean.csv", "head -n 2 clean.csv | cut -c 1-100"],
    "serve": ["timeout 1 magline serve --bind 127.0.0.1:0"],
    "view": ["timeout 1 magline view flight.toml"],
    "ls": ["magline ls flight"],
    "rm": ["magline rm flight.score", "magline run flight.toml --until score --quiet"],
    "runs": ["magline runs flight"],
    "gc": ["magline gc"],
    "verify": ["magline verify"],
    "lineage": ["magline lineage flight.compensate"],
    "stages": ["magline stages lag"],
    "report": ["magline report flight.toml -o report.html"],
    "publish": ["magline publish flight.toml score --to set", "magline verify set"],
    "bench": ["magline bench data --flights example.synth.toml --to bench"],
    "onnx": ["magline onnx reference.fit_m1 -o network.onnx"],
    "ingest": ["magline ingest datasets/samples/logs/sample_log_small.ulg --to flights"],
    "init": ["magline init datasets/samples/logs/sample_log_small.ulg -o own.toml"],
    "new": ["magline new osborne", "ls osborne"],
    "doctor": ["magline doctor flight.toml"],
    "schema": ["magline schema | head -c 300"],
    "completions": ["magline completions bash | head -n 4"],
    "man": ["magline man check | head -n 12"],
    "synth": ["magline synth example.synth.toml --to simulated"],
    "map info": [f"magline map info {OSBORNE}"],
    "map grid": ["magline map grid simulated/1.parquet --spacing 200 --level 330 -o grid.tif"],
    "map fill": ["magline map fill grid.tif --method minimum-curvature -o full.tif"],
    "map continue": [f"magline map continue {OSBORNE} --to 900 -o up.tif"],
    "map convert": [f"magline map convert {OSBORNE} --to-epsg 4326 --spacing 0.005 -o map.nc"],
    "map vector": [f"magline map vector {OSBORNE} --decimal-year 2020.5 --component north -o north.tif"],
    "map spectrum": [f"magline map spectrum {OSBORNE} | head -n 5"],
    "map plot": [f"magline map plot {OSBORNE} --width 400 -o map.png"],
}
# Command lines that read a file of each format. A format without an entry has no file in the repository.
FLIGHTS = {
    "parquet": ["magline ingest simulated --to parquet"],
    "ulog": ["magline ingest datasets/samples/logs/sample_log_small.ulg --to ulog"],
    "dataflash": ["magline ingest datasets/samples/logs/log171_flight.bin --to dataflash"],
    "mat": ["magline ingest datasets/samples/logs/TestLog2_cut.mat --mapping skywalker_x8 --to mat"],
    "sgl_hdf5": ["magline ingest datasets/samples/magnavjl_sample/sgl_2020.h5 --to sgl_hdf5"],
    "magnav_hdf5": ["magline ingest datasets/samples/simple_magnav/xyz.h5 --to magnav_hdf5"],
    "geosoft_xyz": [
        r"printf '/ tt lat lon mag_1_uc\nLine 10\n0.0 -22.0 140.6 51712.4\n0.1 -22.0001 140.6 51712.9\n' > line.xyz",
        "magline ingest line.xyz --flight 1 --to geosoft_xyz",
    ],
    "sgl_xyz": ["magline ingest datasets/samples/magnavjl_sample/Flt1003_sample.xyz --to sgl_xyz"],
    "magnav_csv": ["magline ingest datasets/samples/simple_magnav/xyz.csv --to magnav_csv"],
    "imf": [
        # An hour of the record of Boulder in the other format: tenths of nT, and hundredths of a minute of arc.
        """awk 'BEGIN { print "BOU NOV0414 308 00 HDZF R GOL 04992548 005527 RRRRRRRRRRRRRRRR" } """
        """/^2014/ && n < 60 { printf "%7.0f %7.0f %7.0f %7.0f%s", 10*$4, 100*$5, 10*$6, 10*$7, """
        """n++ % 2 ? "\\n" : " " }' """
        "datasets/samples/boulder/bou20141104vmin.min > bou.imf",
        "head -n 2 bou.imf", "magline ingest bou.imf --to imf",
    ],
    "mfam": [
        r"printf 'Counter,Date,Time,Latitude,Longitude,Mag1Data,Mag1Valid\n"
        r"0,2026/04/24,09:30:00.0,49.5,7.0,48213.1204,1\n"
        r"1,2026/04/24,09:30:00.1,49.5,7.0,48213.0987,1\n' > magarrow.csv",
        "magline ingest magarrow.csv --flight 1 --to mfam",
    ],
    "iaga2002": ["magline ingest datasets/samples/boulder/bou20141104vmin.min --to iaga2002"],
    "csv": [
        "magline sql 'SELECT flight, line, tt, lat, lon, alt, mag_4_uc FROM flight.compensate ORDER BY line, tt' "
        "--format csv -o log.csv",
        "head -n 2 log.csv", "magline ingest log.csv --to csv",
    ],
    "synth": ["magline ingest example.synth.toml --to synth"],
    "points": [f"magline ingest {POINTS} --format points --to points"],
}
MAPS = {
    "parquet": "map.parquet", "geotiff": "map.tif", "netcdf": "map.nc", "gxf": "map.gxf", "er_mapper": "map.ers",
    "esri_ascii": "map.asc", "xyz": "map.xyz", "surfer7": "map7.grd", "surfer6": "map6.grd",
    "surfer6_text": "map6_text.grd",
}
READ_MAPS = {
    "magnav_hdf5": "datasets/samples/simple_magnav/map.h5", "magnav_csv": "datasets/samples/simple_magnav/map",
    "magnav_mat": "datasets/reference/maps/scipy_map.mat",
    "emag2_csv": "datasets/reference/maps/emag2_v3.csv --alt 4000",
    "geosoft_grd": "datasets/reference/maps/geosoft_float.grd --epsg 32630",
}


def parts(text: str) -> list[tuple[str, str, str]]:
    """Returns kind, name and example of every stage, model and filter of `magline stages --markdown`."""
    found = []
    for part in re.split(r"(?m)^(?=##+ )", text):
        heading = re.match(r"##+ (?:The (model|filter) )?`(\w+)`", part)
        if heading:
            code = re.search(r"(?ms)^```toml\n(.*?)^```", part)
            found.append((heading[1] or "stage", heading[2], code[1] if code else ""))
    return found


def aligned(keys: str, width: int) -> str:
    """Returns lines `key = value` with the equals signs in one column."""
    pairs = [line.split("=", 1) for line in keys.splitlines() if "=" in line]
    return "".join(f"{key.strip():<{width}} = {value.strip()}\n" for key, value in pairs)


class Examples:
    """The run of the examples in a folder."""

    def __init__(self, program: str, reference: str, folder: Path) -> None:
        self.folder = folder
        (folder / ".bin").mkdir(parents=True)
        (folder / ".bin" / "magline").symlink_to(program)
        # Only linked: no example writes to it.
        (folder / "datasets").symlink_to(REPOSITORY / "datasets")
        for name in SYNTHS:
            shutil.copyfile(DOCS / "reference" / name, folder / name)
        self.stages: dict[tuple[str, str], str] = {}
        for kind, name, example in parts(reference):
            if kind == "model":
                example = MODEL.format(name=name, keys=aligned(example, 6))
            elif kind == "filter":
                keys = aligned(example or f'filter = "{name}"', 15)
                example = FILTER.format(name=name, keys=keys, metric="drms_bound" if name == "crlb" else "drms")
            self.stages[kind, name] = example.strip() + "\n"
        self.spec = TABLES + CROSSING + "\n" + "\n".join([*self.stages.values(), FURTHER.strip() + "\n"])
        (folder / "example.toml").write_text(self.spec, encoding="utf-8")
        short = [TABLES.replace('"reference"', '"flight"').split("\n[tables.anomaly]")[0]]
        self.short = "\n".join([*short, *(self.stages["stage", name] for name in SHORT), END.lstrip()])
        (folder / "flight.toml").write_text(self.short, encoding="utf-8")
        for command in ("run example.toml", "synth example.synth.toml --to simulated"):
            done = subprocess.run([program, *command.split(), "--quiet"], cwd=folder, capture_output=True, text=True)
            if done.returncode != 0:
                raise SystemExit(f"error: the examples of the reference fail\n{done.stdout}{done.stderr}")

    def console(self, commands: list[str]) -> str:
        """Returns a console block with the commands and their output, of at most `LINES` lines each."""
        text = ""
        for command in commands:
            output, status = run(command, self.folder)
            # A time limit ends a server. A pipe hides the status of its first command.
            if status not in (0, 124) or re.search("(?m)^error:", output):
                raise SystemExit(f"error: `{command}` ends with status {status}\n{output}")
            lines = [line[:160] for line in output.replace(f"{REPOSITORY}/", "").splitlines()]
            lines = lines if len(lines) <= LINES else [*lines[:LINES - 1], "..."]
            text += f"$ {command}\n" + "".join(line + "\n" for line in lines)
        return f"```console\n{text}```\n"

    @cached_property
    def columns(self) -> dict[str, list[str]]:
        """The columns of each table of the store, from one query."""
        query = "SELECT table_name, column_name FROM information_schema.columns WHERE table_schema = 'reference'"
        output, _ = run(f'magline sql "{query} ORDER BY table_name, ordinal_position" --format csv', self.folder)
        found: dict[str, list[str]] = {}
        for line in output.splitlines()[1:]:
            table, column = line.split(",")
            found.setdefault(table, []).append(column)
        return found

    def rows(self, name: str) -> str:
        """Returns the query of the first rows of a stage's table, with the columns that the stage adds."""
        own = self.columns[name]
        if "anomaly" in own:
            query = f"SELECT lat, lon, alt, anomaly FROM reference.{name} WHERE NOT isnan(anomaly) LIMIT {ROWS}"
            return self.console([f'magline sql "{query}"'])
        inputs = re.findall(r"(?m)^(?:input|map|model|with|noise|track) += (.*)$", self.stages["stage", name])
        tables = [t for t in re.findall(r'"(\w+)"', " ".join(inputs)) if ("stage", t) in self.stages]
        before = {column for table in tables for column in self.columns[table]}
        keys = [key for key in ("line", "tt") if key in own]
        added = SHOWN.get(name) or [c for c in own if c not in before and c not in ("flight", *keys)][:COLUMNS]
        added = added or [c for c in own if c not in ("flight", *keys)][-COLUMNS:]
        # The first three values stand in place of a list.
        shown = [f"{c}[1:3] AS {c}" if c in ("tl", "features") else c for c in [*keys, *added]]
        order = " ORDER BY line, tt" if "tt" in own else ""
        query = f"SELECT {', '.join(shown)} FROM reference.{name}{order} LIMIT {ROWS}"
        return self.console([f"magline sql '{query}'" if '"' in query else f'magline sql "{query}"'])

    def scores(self, name: str) -> str:
        """Returns the query of the scores of the example of a model or filter."""
        query = f"SELECT line, metric, value, unit, in_sample FROM reference.score_{name} ORDER BY line, metric"
        return self.console([f'magline sql "{query}"'])

    @cached_property
    def scored(self) -> dict[str, str]:
        """The table of each metric that has a value."""
        tables = ("score_crossing", "score_gnss", "score_crlb", "score_map", "score", "score_track")
        union = " UNION ALL ".join(f"SELECT '{t}', metric, value FROM reference.{t}" for t in tables)
        output, _ = run(f'magline sql "{union}" --format csv', self.folder)
        rows = [line.split(",") for line in output.splitlines()[1:]]
        return {metric: table for name in tables for table, metric, value in rows if table == name and value}

    def metric(self, name: str) -> str | None:
        """Returns the query of a metric, or `None` if no example has a value of it."""
        table = self.scored.get(name)
        query = f"SELECT line, value, unit, n FROM reference.{table} WHERE metric = '{name}' ORDER BY line"
        return self.console([f'magline sql "{query}"']) if table else None

    def map_format(self, name: str) -> str | None:
        """Returns commands that write a map in a format and read it, or that read a sample."""
        if name in READ_MAPS:
            return self.console([f"magline map info {READ_MAPS[name]}"])
        if name not in MAPS:
            return None
        grd = MAPS[name].endswith("grd")
        option, code = (f" --output-format {name}", " --epsg 32754") if grd else ("", "")
        convert = f"magline map convert {OSBORNE} --bounds 460000,7560000,470000,7570000 -o {MAPS[name]}{option}"
        return self.console([convert, f"magline map info {MAPS[name]}{code}"])
