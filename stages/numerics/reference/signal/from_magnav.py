"""Takes the filter and Tolles-Lawson cases out of the golden values that MagNav.jl 1.3.3 produced.

    python3 stages/numerics/reference/signal/from_magnav.py magnav_golden.json

The input of each case is a formula that the tests repeat; only the values are kept here.
"""
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCE = ("# MagNav.jl 1.3.3 (golden case `{}`); "
          "python3 stages/numerics/reference/signal/from_magnav.py magnav_golden.json\n")
CASES = {
    "bpf_default": "magnav_bpf_default.csv",
    "lpf_0.2": "magnav_lpf_02.csv",
    "hpf_0.5": "magnav_hpf_05.csv",
    "TL_A_rows_1_2_80": "magnav_tl_a.csv",
    "TL_coef_lambda0.025": "magnav_tl_coef.csv",
    "TL_coef_i3_e3_b_lambda0.1": "magnav_tl_coef_i3_e3_b.csv",
    "TL_coef_lowpass0.9": "magnav_tl_coef_lowpass.csv",
}


def main():
    golden = json.load(open(sys.argv[1]))
    for case, name in CASES.items():
        value = golden[case]["value"]
        rows = value if isinstance(value[0], list) else [value]
        with open(HERE / name, "w") as file:
            file.write(SOURCE.format(case))
            file.write(",".join(f"row{j}" for j in range(len(rows))) + "\n")
            for values in zip(*rows, strict=True):
                file.write(",".join(repr(value) for value in values) + "\n")


if __name__ == "__main__":
    main()
