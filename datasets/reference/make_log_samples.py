"""Makes excerpts of real logs for the tests: whole messages and variables, byte for byte where possible.

    python make_log_samples.py FLIGHTS SCIPY_DATA ../samples/logs

FLIGHTS holds px4_ulog/, ardupilot_dataflash/, skywalker_x8/ and thor75/ as named in the manifest of the samples.
SCIPY_DATA holds the MATLAB files of SciPy's tests (scipy/io/matlab/tests/data). Requires SciPy 1.17.
"""

import shutil
import struct
import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat, savemat

MATLAB = [
    "big_endian.mat",
    "parabola.mat",
    "test3dmatrix_7.1_GLNX86.mat",
    "testcell_7.1_GLNX86.mat",
    "testdouble_6.1_SOL2.mat",
    "testdouble_7.1_GLNX86.mat",
    "testfunc_7.4_GLNX86.mat",
    "testhdf5_7.4_GLNX86.mat",
    "testmatrix_6.1_SOL2.mat",
    "testmatrix_7.4_GLNX86.mat",
    "testobject_7.4_GLNX86.mat",
    "testsparse_7.4_GLNX86.mat",
    "teststructnest_6.1_SOL2.mat",
    "teststructnest_7.1_GLNX86.mat",
    "corrupted_zlib_checksum.mat",
    "corrupted_zlib_data.mat",
    "malformed1.mat",
]
# The omitted variables have 1.8 of 2.1 MB.
LEFT_OUT = ["ATT", "IMU", "CTUN", "NTUN"]


def ulog(source: Path, to: Path) -> None:
    """The whole messages within the first 400 kB."""
    data = source.read_bytes()
    at = 16
    while at + 3 <= len(data):
        size = struct.unpack_from("<H", data, at)[0] + 3
        if at + size > 400_000:
            break
        at += size
    to.write_bytes(data[:at])


def dataflash(source: Path, to: Path) -> None:
    """The first 300 kB, which end in the middle of a message."""
    to.write_bytes(source.read_bytes()[:300_000])


def flight_of_dataflash(source: Path, to: Path) -> None:
    """Copies the messages of the compass, attitude, GNSS, current and barometer, and the formats of all messages."""
    data, at, kept = source.read_bytes(), 0, bytearray()
    formats = {128: (89, b"FMT")}
    while at + 3 <= len(data):
        length, name = formats.get(data[at + 2], (1, b"")) if data[at : at + 2] == b"\xa3\x95" else (1, b"")
        message = data[at : at + length]
        if name == b"FMT" and len(message) == length:
            formats[message[3]] = (message[4], message[5:9].rstrip(b"\0"))
        if name in (b"FMT", b"MAG", b"ATT", b"GPS", b"CURR", b"BARO") and len(message) == length:
            kept += message
        at += length
    to.write_bytes(kept)


def skywalker(source: Path, to: Path) -> None:
    """All variables except the largest, unchanged."""
    data = source.read_bytes()
    names = [name for name, *_ in __import__("scipy.io").io.whosmat(source)]
    out, at, i = data[:128], 128, 0
    while at < len(data):
        size = struct.unpack_from("<I", data, at + 4)[0] + 8
        if names[i] not in LEFT_OUT:
            out += data[at : at + size]
        at, i = at + size, i + 1
    to.write_bytes(out)


def thor(source: Path, to: Path) -> None:
    """Some vectors of the structure: 1500 rows in flight, and 64 rows on the clock of the motor."""
    whole = loadmat(source, struct_as_record=True)
    flight, info = whole["flight_data"][0, 0], whole["flight_info"]
    names = ["time", "lat", "lon", "alt", "hx", "hy", "hz", "phi", "theta", "psi", "dthr", "satVisible", "mode"]
    cut = {name: flight[name][12000:13500] for name in names}
    cut |= {name: flight[name][500:564] for name in ["motor_time", "motor_voltage", "motor_current"]}
    savemat(to, {"flight_data": cut, "flight_info": info}, do_compression=True)


def main() -> None:
    flights, scipy_data, to = map(Path, sys.argv[1:])
    (to / "matlab").mkdir(parents=True, exist_ok=True)
    shutil.copy(flights / "px4_ulog/sample_log_small.ulg", to)
    ulog(flights / "px4_ulog/sample.ulg", to / "sample_cut.ulg")
    dataflash(flights / "ardupilot_dataflash/log171.bin", to / "log171_cut.bin")
    flight_of_dataflash(flights / "ardupilot_dataflash/log171.bin", to / "log171_flight.bin")
    skywalker(flights / "skywalker_x8/TestLog2.mat", to / "TestLog2_cut.mat")
    thor(flights / "thor75/thor_flight75.mat", to / "thor_flight75_cut.mat")
    for name in MATLAB:
        shutil.copy(scipy_data / name, to / "matlab")


main()
