"""Prints the results of gnadt_2022_navigation, gnadt_2022_second_aircraft, lee_2019 and lee_2019_calibration with the
published tables.

    python published_navigation_tables.py STORE

STORE is the store of the runs; pipelines without results are skipped. Needs pandas and pyarrow.
Published: Gnadt 2022 (MIT), Lee 2019 (AFIT). Several realisations of an INS, and several flights, are combined by their
root mean square. A dash marks a missing figure.
"""

import sys
from pathlib import Path

import pandas as pd

from published_tables import show, table

LINES = ["1003.10", "1007.04", "1007.06"]
# Tables 6.1, 6.3 and 6.5: error of Tolles-Lawson, PLSR and model 2c; nT.
ERRORS = {("mag_3_uc", "small_1"): ("6.1", [[83, 60, 34], [113, 69, 40], [102, 48, 44]]),
          ("mag_3_uc", "small_2"): ("6.3", [[83, 70, 55], [113, 72, 58], [102, 52, 55]]),
          ("mag_5_uc", "small_2"): ("6.5", [[13, 12, 15], [26, 12, 9.5], [19, 8.9, 9.4]])}
# Tables 6.2, 6.4 and 6.6: DRMS of Tolles-Lawson, PLSR, model 2c, online 2c, stinger, no magnetometer; m.
DRMS = {("mag_3_uc", "small_1"): ("6.2", [[271, 296, 122, 83, 32, 350],
                                          [88, 88, 68, 25, 25, 88],
                                          [71, 58, 48, 25, 19, 300]]),
        ("mag_3_uc", "small_2"): ("6.4", [[247, 187, 120, 122, 32, 350],
                                          [88, 88, 70, 34, 25, 88],
                                          [71, 57, 53, 32, 19, 300]]),
        ("mag_5_uc", "small_2"): ("6.6", [[58, 70, 58, 57, 32, 350],
                                          [33, 23, 23, 21, 25, 88],
                                          [20, 21, 21, 18, 19, 300]])}
# Table 5.10, DRMS on line 1007.06, m: model 2c, adaptive, adaptive neural, online 2c, online Tolles-Lawson, stinger, no
# magnetometer.
END_TO_END = {"mag_4_uc": [51, 48, 51, 37, 51, 19, 300], "mag_5_uc": [21, 22, 21, 18, 21, 19, 300]}
# Section 5.9.4, magnetometer 4, assumed sigma 5 nT: EKF, adaptive and adaptive neural filter.
TOLD_WRONG = [124, 48, 86]
# Assumed noise of an EKF at 10 Hz, nT: sections 6.1.2 and 5.9.4 (not published for magnetometer 5). TOLD has the values
# for 2 Hz.
SIGMA = {"mag_3_uc": 120.0, "mag_4_uc": 60.0, "mag_5_uc": 15.0}
TOLD = {5.0: 2.24, 15.0: 6.7, 60.0: 26.8, 120.0: 53.7}

# Table 5.2: uncompensated, and with Flux A, C and D.
OTHER_AIRCRAFT = {"mag_1_uc": [7.3, 7.3, 7.4, 7.3], "mag_2_uc": [272, 124, 126, 125], "mag_4_uc": [37, 22, 22, 22],
                  "mag_5_uc": [370, 11, 11, 10]}
# Tables 5.3 to 5.6: Tolles-Lawson, PLSR and model 2c; nT.
LINES_2021 = ["2005.36", "2005.18", "2005.38"]
NOT_TRAINED = {"1007.02": [54, 32, 34], "2005.36": [170, 268, 228], "2005.18": [184, 288, 305],
               "2005.38": [170, 271, 242]}
TRAINED = {3: ("5.4", [[21, 5.8, 8.4], [25, 13, 8.3], [22, 8.3, 11]]),
           2: ("5.5", [[21, 8.1, 6.4], [25, 23, 17], [22, 6.8, 5.7]]),
           1: ("5.6", [[21, 11, 13], [25, 26, 22], [22, 11, 15]])}
# Table 5.8: error on line 2005.36 of a calibration with each manoeuvre set, flown low and high; nT.
LOW = [19, 24, 17, 27, 32, 20, 24, 19, 21, 18, 22, 27, 24, 20, 18, 18, 16, 26]
HIGH = [22, 20, 24, 24, 18, 22, 11, 16, 18, 23, 23, 23, 19, 19, 21, 17, 20, 26]
# Table 5.9: error of Tolles-Lawson, nT; DRMS of the EKF, online Tolles-Lawson, stinger, no magnetometer; m.
SETS = [[17, 45, 43, 55, 85], [15, 64, 53, 25, 38], [14, 50, 37, 22, 11], [15, 40, 31, 45, 39], [13, 48, 47, 24, 62],
        [13, 73, 38, 21, 39], [14, 43, 27, 27, 16], [11, 30, 21, 24, 36], [12, 111, 101, 24, 44], [12, 34, 43, 27, 44],
        [16, 56, 29, 30, 23], [18, 55, 36, 27, 21], [17, 37, 29, 28, 43], [19, 60, 50, 23, 58], [21, 95, 52, 21, 44],
        [15, 56, 32, 25, 12], [18, 48, 56, 33, 54], [17, 32, 36, 33, 57]]

# Lee 2019, Table 2: north, east, DRMS of the INS, of SLAM by a Gaussian process and by a scattered interpolant; m.
SURVEY = {"INS alone": [320.6, 438.8, 543.5], "regression": [9.4, 14.2, 17.0],
          "inverse_distance": [18.46, 24.11, 30.36]}
# Table 11: north, east and DRMS of 14 minutes, for each grade without and with SLAM; m.
LOITER = {"navigation": ([12.29, 1.24, 12.35], [4.74, 10.35, 11.38]),
          "tactical": ([434.27, 41.37, 436.24], [24.74, 31.12, 39.76]),
          "commercial": ([8792.26, 5279.09, 10255.37], [77.34, 114.71, 138.35])}
# Table 12: figure of merit along the true track, the INS track and the SLAM track; nT.
MERIT = {"navigation": [1.079, 1.40, 1.073], "tactical": [1.079, 10.15, 1.52], "commercial": [1.079, 7.90, 2.46]}
# Table 7: figure of merit before and after calibration, nT, and the calibration line.
MERITS = {"a": (31.52, 1.26, "b"), "b": (33.97, 0.56, "b"), "c": (67.23, 1.9, "b"), "d": (63.44, 0.92, "d"),
          "e": (93.65, 1.08, "d"),
          "f": (60.52, 1.42, "d")}
# Table 14: standard deviation of the residual on the calibration flight and on the grid; nT.
RESIDUALS = {"raw": [50.014, 50.515], "TL": [5.946, 14.774], "MTL": [5.946, 14.764], "TLL": [0.661, 1.049],
             "TLQ": [0.6588, 1.007],
             "MTLL": [0.6586, 0.975]}


def pooled(d: pd.DataFrame, metric: str = "drms", **keys) -> float | None:
    """Root mean square of a metric over the rows with these keys; for a ratio, the mean."""
    d = d[d.metric == metric]
    for key, value in keys.items():
        d = d[d[key] == value]
    if not len(d):
        return None
    return float(d.value.mean()) if metric in ("nees", "nis") else float((d.value**2).mean() ** 0.5)


def beside(ours: list, published: list) -> list:
    return [x for pair in zip(ours, published) for x in pair]


def with_published(heads: list[str]) -> list[str]:
    return [x for head in heads for x in (head, "published")]


def gnadt_2022_navigation(store: Path) -> None:
    names = ["tl", "pls", "honest", "stinger", "alone", "online_boxes", "online_cold", "lagged", "adaptive_4",
             "adaptive_5"]
    d = {name: table(store, f"gnadt_2022_navigation/{name}_scores") for name in names}
    for (mag, chosen), (number, published) in ERRORS.items():
        rows = []
        for line, known in zip(LINES, published):
            tl = pooled(d["tl"], "std_error", mag=mag, line=line)
            pls = pooled(d["pls"], "std_error", mag=mag, line=line, set=chosen)
            rows.append([line] + beside([tl, pls, None], known))
        show(f"Gnadt 2022, Table {number}: magnetometer {mag[4]}, {chosen}; nT",
             ["line"] + with_published(["Tolles-Lawson", "PLSR", "2c"]), rows)
    for (mag, chosen), (number, published) in DRMS.items():
        rows = []
        for line, known in zip(LINES, published):
            at = {"mag": mag, "line": line}
            ours = [pooled(d["tl"], sigma=TOLD[SIGMA[mag]], **at),
                    pooled(d["pls"], sigma=TOLD[SIGMA[mag]], set=chosen, **at), None,
                    None, pooled(d["stinger"], line=line), pooled(d["alone"], line=line)]
            rows.append([line] + beside(ours, known))
        heads = ["Tolles-Lawson", "PLSR", "2c", "online 2c", "stinger", "INS alone"]
        show(f"Gnadt 2022, Table {number}: magnetometer {mag[4]}, {chosen}, assumed sigma {SIGMA[mag]:.0f} nT; DRMS, m",
             ["line"] + with_published(heads), rows)
    rows = []
    for mag, known in END_TO_END.items():
        at = {"mag": mag, "line": "1007.06"}
        adaptive = d["adaptive_4"] if mag == "mag_4_uc" else d["adaptive_5"]
        ours = [pooled(d["tl"], sigma=TOLD[SIGMA[mag]], **at), pooled(adaptive, print_tables=TOLD[60.0], **at), None,
                None, pooled(d["online_boxes"], **at), pooled(d["stinger"], line="1007.06"),
                pooled(d["alone"], line="1007.06")]
        rows.append([mag[4]] + beside(ours, known))
    heads = ["EKF (here T-L, there 2c)", "adaptive", "adaptive neural", "online 2c", "online T-L", "stinger",
             "INS alone"]
    show("Gnadt 2022, Table 5.10: line 1007.06; DRMS, m", ["mag"] + with_published(heads), rows)
    at = {"mag": "mag_4_uc", "line": "1007.06"}
    ours = [pooled(d["tl"], sigma=TOLD[5.0], **at), pooled(d["adaptive_4"], print_tables=TOLD[5.0], **at), None]
    show("Gnadt 2022, section 5.9.4: magnetometer 4, assumed sigma 5 nT; DRMS, m",
         with_published(["EKF", "adaptive", "adaptive neural"]), [beside(ours, TOLD_WRONG)])
    rows = []
    for name, label in [("alone", "INS alone"), ("stinger", "stinger, EKF, sigma 10 nT")]:
        rows.append([label, "1"] + [pooled(d[name], line=line) for line in LINES]
                    + [pooled(d[name], "nees"), pooled(d[name], "nis")])
    for mag in SIGMA:
        for name, label, keys in [("tl", "T-L, EKF, sigma 15 nT", {"sigma": TOLD[15.0]}),
                                  ("tl", "T-L, EKF, sigma 60 nT", {"sigma": TOLD[60.0]}),
                                  ("tl", "T-L, EKF, sigma 120 nT", {"sigma": TOLD[120.0]}),
                                  ("honest", "T-L, EKF, noise of line 1003.08", {}),
                                  ("online_boxes", "online T-L from five boxes", {}),
                                  ("online_cold", "online T-L, cold", {}),
                                  ("lagged", "fixed lag, cold", {})]:
            x = d[name]
            row = [pooled(x, mag=mag, line=line, **keys) for line in LINES]
            rows.append([label, mag[4]] + row + [pooled(x, m, mag=mag, **keys) for m in ("nees", "nis")])
    show("All linear models and filters, lines of Gnadt 2022; DRMS, m",
         ["filter", "mag"] + LINES + ["NEES (2)", "NIS (1)"], rows)


def gnadt_2022_second_aircraft(store: Path) -> None:
    names = ["any", "tl_2020_at_home", "pls_2020_at_home", "tl_2020_abroad", "pls_2020_abroad", "tl", "pls", "set",
             "alone", "stinger",
             "cabin", "online"]
    d = {name: table(store, f"gnadt_2022_second_aircraft/{name}_scores") for name in names}
    rows = []
    for mag, known in OTHER_AIRCRAFT.items():
        ours = [pooled(d["any"], "std_uncompensated", mag=mag)]
        ours += [pooled(d["any"], "std_error", mag=mag, vector=f"flux_{v}") for v in "acd"]
        rows.append([mag[4]] + beside(ours, known))
    show("Gnadt 2022, Table 5.2: another aircraft, line 2005.36; nT",
         ["mag"] + with_published(["uncompensated", "Flux A", "Flux C", "Flux D"]), rows)
    rows = []
    for line, known in NOT_TRAINED.items():
        where = "at_home" if line == "1007.02" else "abroad"
        ours = [pooled(d[f"{model}_2020_{where}"], "std_error", line=line) for model in ("tl", "pls")] + [None]
        rows.append([line] + beside(ours, known))
    head = ["line"] + with_published(["Tolles-Lawson", "PLSR", "2c"])
    show("Gnadt 2022, Table 5.3: models of 2020, magnetometer 4; nT", head, rows)
    for flights, (number, published) in TRAINED.items():
        rows = []
        for line, known in zip(LINES_2021, published):
            ours = [pooled(d["tl"], "std_error", line=line), pooled(d["pls"], "std_error", line=line, flights=flights),
                    None]
            rows.append([line] + beside(ours, known))
        show(f"Gnadt 2022, Table {number}: fitted on {flights} flights of 2021, magnetometer 4; nT", head, rows)
    rows = []
    for k in range(18):
        ours = [pooled(d["set"], "std_error", number=f"{k + 1:02}", height=height) for height in ("low", "high")]
        rows.append([str(k + 1)] + beside(ours, [LOW[k], HIGH[k]]))
    show("Gnadt 2022, Table 5.8: line 2005.36, calibrated on a manoeuvre set; nT",
         ["set"] + with_published(["low", "high"]), rows)
    rows = []
    for k in range(18):
        line = f"low.{k + 1:02}"
        ours = [pooled(d["cabin"], "std_error", line=line)]
        ours += [pooled(d[name], line=line) for name in ("cabin", "online", "stinger", "alone")]
        rows.append([str(k + 1)] + beside(ours, SETS[k]))
    columns = list(zip(*[row[1:] for row in rows]))
    rows.append(["all"] + [None if None in c else (sum(x * x for x in c) / len(c)) ** 0.5 for c in columns])
    show("Gnadt 2022, Table 5.9: navigation through the manoeuvre sets, magnetometer 4; nT, then DRMS, m",
         ["set"] + with_published(["T-L error", "T-L, EKF", "online T-L", "stinger", "INS alone"]), rows)


def merit(track: pd.DataFrame) -> float:
    """(66) of Lee 2019 along the positions of a track: pairs of samples at most 1 m and more than 1 s apart."""
    north, east = track.lat.to_numpy() * 110_720.0, track.lon.to_numpy() * 103_300.0
    z, tt = track.mag_1_uc.to_numpy(), track.tt.to_numpy()
    cells = pd.DataFrame({"row": range(len(track)), "n": (north // 1.0).astype(int), "e": (east // 1.0).astype(int)})
    squares = pairs = 0
    for dn in (-1, 0, 1):
        for de in (-1, 0, 1):
            both = cells.merge(cells.assign(n=cells.n + dn, e=cells.e + de), on=["n", "e"])
            a, b = both.row_x.to_numpy(), both.row_y.to_numpy()
            near = (tt[b] - tt[a] > 1.0) & ((north[a] - north[b]) ** 2 + (east[a] - east[b]) ** 2 <= 1.0)
            squares, pairs = squares + ((z[a] - z[b])[near] ** 2).sum(), pairs + near.sum()
    return float((squares / pairs) ** 0.5) if pairs else float("nan")


def lee_2019(store: Path) -> None:
    axes = ["rms_north", "rms_east", "drms"]
    heads = ["north", "east", "DRMS"]
    ins, slam, smoothed, by_thesis = [table(store, f"lee_2019/survey_{name}_scores")
                                      for name in ("ins", "slam", "smoothed", "thesis")]
    rows = [["INS alone"] + beside([pooled(ins, m) for m in axes], SURVEY["INS alone"])]
    rows += [[f"SLAM, {how}, as published"] + beside([pooled(by_thesis, m, expected=how) for m in axes], SURVEY[how])
             for how in ("regression", "inverse_distance")]
    rows += [["SLAM, defaults"] + beside([pooled(slam, m) for m in axes], [None] * 3)]
    rows += [["SLAM, smoothed"] + beside([pooled(smoothed, m) for m in axes], [None] * 3)]
    show("Lee 2019, Table 2: 100 minutes with a navigation-grade INS; m", ["method"] + with_published(heads), rows)
    ins, slam, smoothed = [table(store, f"lee_2019/{name}_scores") for name in ("ins", "slam", "smoothed")]
    rows = []
    for grade, (alone, held) in LOITER.items():
        rows.append([f"{grade}, INS alone"] + beside([pooled(ins, m, grade=grade) for m in axes], alone)
                    + [worst(ins, grade)])
        rows.append([f"{grade}, SLAM"] + beside([pooled(slam, m, grade=grade) for m in axes], held)
                    + [worst(slam, grade)])
        rows.append([f"{grade}, SLAM, smoothed"] + beside([pooled(smoothed, m, grade=grade) for m in axes], [None] * 3)
                    + [worst(smoothed, grade)])
    show("Lee 2019, Table 11: 14 minutes; m", ["grade"] + with_published(heads) + ["DRMS of each flight"], rows)
    keys = ["grade", "flight", "line", "tt"]
    measured = table(store, "lee_2019/loiter")[keys + ["mag_1_uc"]]
    tracks = {name: table(store, f"lee_2019/{name}")[keys + ["lat", "lon"]].merge(measured, on=keys)
              for name in ("ins", "slam", "smoothed")}
    rows = []
    for grade, known in MERIT.items():
        ours = [pooled(ins, "figure_of_merit_crossings", grade=grade)]
        for track in tracks.values():
            of_flights = pd.Series([merit(x.sort_values("tt"))
                                    for _, x in track[track.grade == grade].groupby("flight")], dtype=float)
            ours.append((of_flights**2).mean() ** 0.5 if len(of_flights) else None)
        rows.append([grade] + beside(ours, known + [None]))
    show("Lee 2019, Table 12: figure of merit; nT",
         ["grade"] + with_published(["true track", "INS", "SLAM", "SLAM, smoothed"]), rows)


def worst(d: pd.DataFrame, grade: str) -> str:
    values = sorted(d[(d.metric == "drms") & (d.grade == grade)].value)
    return ", ".join(f"{x:.0f}" for x in values) or "-"


def lee_2019_calibration(store: Path) -> None:
    d = {name: table(store, f"lee_2019_calibration/{name}") for name in
         ["tl_own_scores", "tls_own_scores", "mtl_own_scores", "mtll_own_scores", "raw_merit", "merit"]}
    rows = []
    for line, (raw, calibrated, on) in MERITS.items():
        ours = [pooled(d["raw_merit"], "figure_of_merit_crossings", line=line),
                pooled(d["merit"], "figure_of_merit_crossings", line=line, on=on)]
        rows.append([line, on] + beside(ours, [raw, calibrated]))
    show("Lee 2019, Table 7: figure of merit; nT", ["flight", "calibrated on"] + with_published(["raw", "calibrated"]),
         rows)
    of = {"raw": ("tl_own_scores", "std_uncompensated", {}), "TL": ("tl_own_scores", "std_error", {}),
          "MTL": ("mtl_own_scores", "std_error", {}),
          "TLL": ("tls_own_scores", "std_error", {"slope": "slope"}),
          "TLQ": ("tls_own_scores", "std_error", {"slope": "slope_quadratic"}),
          "MTLL": ("mtll_own_scores", "std_error", {})}
    rows = [[model] + beside([pooled(d[name], metric, on=on, **keys) for on in ("b", "d")], RESIDUALS[model])
            for model, (name, metric, keys) in of.items()]
    show("Lee 2019, Table 14: standard deviation of the residual; nT", ["model"] + with_published(["squares", "grid"]),
         rows)


if __name__ == "__main__":
    place = Path(sys.argv[1] if len(sys.argv) > 1 else "store")
    for print_tables in [gnadt_2022_navigation, gnadt_2022_second_aircraft, lee_2019, lee_2019_calibration]:
        if (place / "tables" / print_tables.__name__).is_dir():
            print_tables(place)
