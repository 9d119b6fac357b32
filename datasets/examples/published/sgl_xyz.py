#!/usr/bin/env python3
"""Writes simulated flights in the layout of the SGL survey's `.xyz` files: python3 sgl_xyz.py TABLE.csv FOLDER

TABLE.csv has the columns of the twin, from a run of `sgl_lines.toml` on `sgl_twin.synth.toml`:

    magline sql -f sgl_xyz.sql --store store_twin --format csv -o TABLE.csv

The survey's files have the velocity of the INS to the west and upwards, its latitude and longitude in radians, its
specific force in axes rotated by the wander angle (0 here), and no velocity by GNSS. `*` marks a missing value.
"""

import csv
import math
import sys
from pathlib import Path

# Name in the file, in the order of the survey, with the column and its number of decimals.
FIELDS = """LINE line:, FLT flight:, YEAR year:0, DOY doy:0, TIME tt:2, UTM-X, UTM-Y, UTM-Z alt:2, MSL-Z, LAT lat:9,
LONG lon:9, BARO, RADAR, TOPO, DEM, DRAPE, PITCH ins_pitch:4, ROLL ins_roll:4, AZIMUTH ins_yaw:4,
DIURNAL diurnal:4, COMPMAG1 mag_1_c:4, LAGMAG1, DCMAG1 dc:4, IGRFMAG1 anomaly:4, UNCOMPMAG1, UNCOMPMAG2, UNCOMPMAG3,
UNCOMPMAG4 mag_4_uc:4, UNCOMPMAG5 mag_5_uc:4, FLUXD_X flux_d_x:4, FLUXD_Y flux_d_y:4, FLUXD_Z flux_d_z:4,
INS_ACC_X ins_fn:7, INS_ACC_Y west:7, INS_ACC_Z up:7, INS_WANDER wander:6, INS_LAT ins_lat_rad:12,
INS_LON ins_lon_rad:12, INS_HGT ins_alt:3, INS_VEL_N ins_vn:5, INS_VEL_W ins_vw:5, INS_VEL_V ins_vu:5,
CUR_COM1 cur_com_1:5, CUR_ACHi cur_ac_hi:5, CUR_ACLo cur_ac_lo:5, CUR_TANK cur_tank:5, CUR_FLAP cur_flap:5,
CUR_STRB cur_strb:5, CUR_SRVO_O cur_srvo_o:5, CUR_SRVO_M cur_srvo_m:5, CUR_SRVO_I cur_srvo_i:5, CUR_IHTR cur_heat:5,
CUR_ACPWR cur_acpwr:5"""
COLUMNS = [(*field.split(), "")[:2] for field in FIELDS.replace("\n", " ").split(", ")]


def survey(row: dict[str, str]) -> dict[str, float]:
    """Returns the numbers of a row, with those that the survey derives or reverses."""
    values = {name: float(text or "nan") for name, text in row.items() if name not in ("flight", "line")}
    values |= {"ins_vw": -values["ins_ve"], "ins_vu": -values["ins_vd"], "west": -values["ins_fe"]}
    values |= {"up": -values["ins_fd"], "wander": 0.0, "dc": values["mag_1_c"] - values["diurnal"]}
    values["anomaly"] = values["dc"] - values["igrf"]
    return values | {f"{name}_rad": math.radians(values[name]) for name in ("ins_lat", "ins_lon")}


def cell(row: dict[str, str], values: dict[str, float], column: str) -> str:
    name, _, decimals = column.partition(":")
    if not decimals:
        return row.get(name, "*")
    return "*" if math.isnan(values[name]) else f"{values[name]:.{decimals}f}"


def main(table: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    files = {}
    with table.open(encoding="utf-8", newline="") as rows:
        for row in csv.DictReader(rows):
            if row["flight"] not in files:
                files[row["flight"]] = (folder / f"Flt{row['flight']}.xyz").open("w", encoding="utf-8")
                print("/\n/\n/ " + " ".join(name for name, _ in COLUMNS), file=files[row["flight"]])
            values = survey(row)
            print("", *(cell(row, values, column) for _, column in COLUMNS), file=files[row["flight"]])
    for file in files.values():
        file.close()


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
