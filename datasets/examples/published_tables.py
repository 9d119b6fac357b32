"""Prints the results of gnadt_2022.toml and van_der_meer_2025.toml with the published tables.

    python published_tables.py STORE

STORE is the store of the runs; pipelines without results are skipped. Needs pandas and pyarrow.
Published: Gnadt 2022 (MIT), van der Meer 2025 (Delft).
"""

import sys
from pathlib import Path

import pandas as pd

# Tables 3.3 and 3.4: classical, modified, elastic net, PLSR; nT.
LINES = ["1003.10", "4014.00", "4013.00", "4006.00", "4005.00", "1007.04", "1007.06"]
BOX = [[125, 123, 125, 110], [51, 50, 242, 79], [54, 53, 264, 101], [38, 38, 161, 65], [30, 30, 156, 62],
       [105, 101, 283, 137], [94, 91, 153, 98]]
HOURS = [[123, 109, 74, 73], [62, 58, 32, 32], [57, 51, 36, 37], [39, 34, 25, 26], [31, 28, 24, 23],
         [97, 74, 42, 41], [90, 72, 44, 44]]
# Tables 4.10 and 4.12: Tolles-Lawson and PLSR error of one magnetometer, by vector magnetometers; nT.
SINGLE = {"3": [91, 103, 87, 91, 91, 87], "4": [105, 102, 106, 102, 105, 102], "5": [19, 18, 20, 18, 19, 18],
          "2": [33281, 32749, 32957, 33281, 33281, 32957]}
SINGLE_PLS = {"3": [57, 68, 57, 25, 18, 39], "4": [23, 70, 54, 10, 16, 16], "5": [9.5, 26, 13, 4.7, 5.3, 5.3],
              "2": [132, 82, 129, 29, 18, 58]}
# Tables 4.11 and 4.12: PLSR error of magnetometer 5 with another one.
DUAL_PLS = {"2": [9.5, 26, 13, 4.7, 5.4, 5.3], "3": [8.9, 19, 13, 4.7, 5.4, 5.3], "4": [9.5, 17, 11, 4.4, 5.3, 5.1]}
VECTORS = ["A", "C", "D", "A,C", "A,D", "C,D"]
# Tables 4.13 and 4.14: PLSR error with small feature sets.
SMALL_PLS = {("3", "small_1"): 60, ("4", "small_1"): 26, ("5", "small_1"): 9.7,
             ("3", "small_2"): 65, ("4", "small_2"): 54, ("5", "small_2"): 11}
# Tables 4.1 to 4.5 of van der Meer 2025, means over the manoeuvres: uncompensated nT, ratio of TL, with a ridge,
# extended.
DRONE = {"mag_1_uc": (37.85, 4.97, 4.90, 7.31), "mag_2_uc": (27.45, 3.22, 4.03, 3.92),
         "flux_a_t": (251.99, None, 10.19, 18.76), "flux_b_t": (180.28, None, 8.51, 17.60)}


def table(store: Path, name: str) -> pd.DataFrame:
    return pd.read_parquet(store / "tables" / name)


def show(title: str, header: list[str], rows: list[list]) -> None:
    def cell(x) -> str:
        return "-" if x is None or x != x else x if isinstance(x, str) else f"{x:.4g}"

    print(f"\n**{title}**\n\n| " + " | ".join(header) + " |\n|" + ":--|" + "--:|" * (len(header) - 1))
    for row in rows:
        print("| " + " | ".join(cell(x) for x in row) + " |")


def vectors(text: str) -> str:
    return ",".join(sorted(part[-1].upper() for part in str(text).replace("+", ",").split(",")))


def of_lines(store: Path, train: str, published: list, lam: float, penalty: float, components: int) -> None:
    columns = []
    for model, axis, value in [("classical", "lambda", lam), ("modified", "lambda", lam), ("net", "penalty", penalty),
                               ("plsr", "components", components)]:
        d = table(store, f"gnadt_2022/{model}_scores")
        d = d[(d.metric == "std_error") & (d.train == train) & (d[axis] == value)]
        columns.append(dict(zip(d.line, d.value)))
    rows = [[line] + [x for c, p in zip(columns, known) for x in (c.get(line), p)]
            for line, known in zip(LINES, published)]
    heads = ["classical", "modified", "elastic net", f"PLSR, {components} of 19"]
    what = "3.3: one calibration box" if train == "box" else "3.4: hours of data"
    show(f"Gnadt 2022, Table {what}; nT", ["line"] + [x for h in heads for x in (h, "published")], rows)


def pooled(store: Path, name: str, keys: list[str]) -> dict:
    d = table(store, f"gnadt_2022/{name}")
    d = d[d.metric == "std_error"]
    return {tuple(k): v for *k, v in d[keys + ["value"]].itertuples(index=False)}


def gnadt_2022(store: Path) -> None:
    of_lines(store, "box", BOX, 0.025, 0.0005, 2)
    of_lines(store, "hours", HOURS, 0.25, 0.0005, 18)
    box, single = pooled(store, "box", ["mag", "vector"]), pooled(store, "single", ["mag", "vectors"])
    single = {(m, vectors(v)): x for (m, v), x in single.items()}
    rows = []
    for mag in SINGLE:
        for i, v in enumerate(VECTORS):
            ours = min(x for (m, f), x in box.items() if m == f"mag_{mag}_uc" and f[-1].upper() in v)
            rows.append([mag, v, ours, SINGLE[mag][i], single.get((f"mag_{mag}_uc", v)), SINGLE_PLS[mag][i]])
    head = ["Tolles-Lawson on the box", "published", "PLSR on hours", "published"]
    show("Gnadt 2022, Tables 4.10 and 4.12: one magnetometer; nT", ["mag", "vectors"] + head, rows)
    dual = {(o, vectors(v)): x for (o, v), x in pooled(store, "dual", ["other", "vectors"]).items()}
    rows = [[f"{o},5", v, dual.get((f"mag_{o}_uc", v)), DUAL_PLS[o][i]] for o in DUAL_PLS
            for i, v in enumerate(VECTORS)]
    show("Gnadt 2022, Tables 4.11 and 4.12: magnetometer 5 with another; nT", ["mags", "vectors", "PLSR", "published"],
         rows)
    small = pooled(store, "small", ["mag", "set"])
    rows = [[s, m, small.get((f"mag_{m}_uc", s)), p] for (m, s), p in SMALL_PLS.items()]
    show("Gnadt 2022, Tables 4.13 and 4.14: small feature sets, Flux A; nT", ["set", "mag", "PLSR", "published"], rows)
    fits = table(store, "gnadt_2022/calibrated")
    spread = fits.groupby(["ridge", "term"]).value.agg(lambda x: x.std() / abs(x.mean())).groupby("ridge")
    show("Gnadt 2022, Figure 3-8: coefficient of variation over five calibrations, 9 terms",
         ["lambda", "median", "mean"],
         [[r, m, a] for (r, m), a in zip(spread.median().items(), spread.mean())])


def van_der_meer_2025(store: Path) -> None:
    rows = []
    for side, mags in [("left", ["mag_1_uc", "flux_a_t"]), ("right", ["mag_2_uc", "flux_b_t"])]:
        for mag in mags:
            row = [mag]
            for i, model in enumerate(["plain", "ridge", "extended"]):
                d = table(store, f"van_der_meer_2025/{side}_{model}_scores")
                d = d[d[side] == mag]
                mean = d.groupby("metric").value.mean()
                if i == 0:
                    row += [mean["std_uncompensated"], DRONE[mag][0]]
                row += [mean["improvement_ratio"], DRONE[mag][i + 1]]
            rows.append(row)
    head = ["uncompensated, nT", "TL, ratio", "with a ridge", "extended"]
    show("van der Meer 2025, Tables 4.1 to 4.5: means over test manoeuvres",
         ["sensor"] + [x for h in head for x in (h, "published")], rows)


if __name__ == "__main__":
    place = Path(sys.argv[1] if len(sys.argv) > 1 else "store")
    for name, print_tables in [("gnadt_2022", gnadt_2022), ("van_der_meer_2025", van_der_meer_2025)]:
        if (place / "tables" / name).is_dir():
            print_tables(place)
