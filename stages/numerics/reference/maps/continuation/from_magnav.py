"""Takes the continuation cases out of the golden values that MagNav.jl 1.3.3 produced.

    python3 stages/numerics/reference/maps/continuation/from_magnav.py magnav_golden.json

The input of each case is a formula that the tests repeat; only the values are kept here, by rows.
"""
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
COMMAND = "python3 stages/numerics/reference/maps/continuation/from_magnav.py magnav_golden.json"
CASES = [
    "upward_fft_noexpand",
    "upward_fft_expand",
    "downward_fft_alpha200",
    "vector_fft_X",
    "vector_fft_Z",
    "map_chessboard",
]


def write(name, cases, columns):
    with open(HERE / name, "w") as file:
        file.write(f"# MagNav.jl 1.3.3 (golden cases {', '.join(cases)}); {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


def flat(golden, case):
    return [value for row in golden[case]["value"] for value in row]


def main():
    golden = json.load(open(sys.argv[1]))
    write("magnav.csv", CASES, {case: flat(golden, case) for case in CASES})
    write("magnav_expand.csv", ["map_expand"], {"map_expand": flat(golden, "map_expand")})


if __name__ == "__main__":
    main()
