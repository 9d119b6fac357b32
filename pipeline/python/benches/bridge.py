"""Time that a unit of a stage written in Python spends between the run and the function.

The stage returns one of its columns, so the time is that of the bridge: views of the columns, the call, and the checks
of the result. The run then copies the result, which is measured as a copy of an array.

Run: python pipeline/python/benches/bridge.py
"""

import sys
import tempfile
import timeit
from pathlib import Path

import magline
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from magline._calls import StageCall
from numpy.typing import NDArray

KEPT: list[magline.Line] = []


@magline.stage(reads={"mag_1_uc": "nT"}, makes={"same": "nT"}, version=1)
def same(line: magline.Line) -> NDArray[np.float64]:
    """A copy of a column."""
    KEPT.append(line)
    values: NDArray[np.float64] = line["mag_1_uc"]
    return values


def line_of(samples: int) -> magline.Line:
    """The line that a run passes to a stage."""
    KEPT.clear()
    with tempfile.TemporaryDirectory() as name:
        flights = Path(name) / "flights.parquet"
        tt = np.arange(samples) / 10.0
        pq.write_table(pa.table({"tt": tt, "mag_1_uc": 50_000.0 + np.sin(tt)}), flights)
        magline.run(
            {
                "name": "bridge",
                "store": str(Path(name) / "store"),
                "tables": {"flights": {"path": str(flights), "flight": "1", "line": "1"}},
                "stages": [{"name": "one", "stage": "same", "input": "flights"}],
            }
        )
    return KEPT[0]


def microseconds(call: str, scope: dict[str, object]) -> float:
    """Smallest mean time of a call, us."""
    return min(timeit.repeat(call, globals=scope, number=2000, repeat=7)) / 2000 * 1e6


def main() -> None:
    """Print the times for lines of several lengths."""
    print(f"Python {sys.version.split()[0]}, NumPy {np.__version__}")
    for samples in (600, 36_000):
        line = line_of(samples)
        scope: dict[str, object] = {"line": line, "run": StageCall(lambda line: line["mag_1_uc"])}
        view = microseconds("line['mag_1_uc']", scope)
        call = microseconds("run(line, {}, ['same'])", scope)
        copy = microseconds("values.copy()", {"values": line["mag_1_uc"]})
        print(f"{samples} samples: view {view:.1f} us, call with view and checks {call:.1f} us, copy {copy:.1f} us")


if __name__ == "__main__":
    main()
