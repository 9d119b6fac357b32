"""Reads the logs of the bench `logs` with magline, then with pyulog and pymavlink.

    python3 -m venv venv && venv/bin/pip install pyulog pymavlink
    venv/bin/python datasets/benches/logs.py BENCH [MEGABYTES]

BENCH is the path that `cargo bench -p magline-datasets --bench logs --profile dev --no-run` prints.
"""

import os
import subprocess
import sys
import tempfile
import time

from pymavlink.DFReader import DFReader_binary
from pyulog import ULog


def speed(path, read):
    """Speed in megabytes per second of wall-clock time and of processor time."""
    start, used = time.perf_counter(), time.process_time()
    read()
    wall, process = time.perf_counter() - start, time.process_time() - used
    megabytes = os.path.getsize(path) / 1e6
    return f"{megabytes / wall:.1f} MB/s ({megabytes / process:.1f} by the time of the process)"


def mavlink(path, kind):
    log = DFReader_binary(path)
    rows = []
    while (message := log.recv_match(type=kind)) is not None:
        rows.append(message.to_dict())


def main():
    bench, megabytes = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "200"
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([bench, megabytes, folder], check=True)
        ulog, dataflash = os.path.join(folder, "log.ulg"), os.path.join(folder, "log.bin")
        for topic in ["vehicle_attitude", "sensor_combined"]:
            print(f"pyulog 1.3.0, {topic} alone: {speed(ulog, lambda: ULog(ulog, [topic]))}")
        print(f"pyulog 1.3.0, all topics: {speed(ulog, lambda: ULog(ulog))}")
        for kind in ["MAG", "IMU"]:
            print(f"pymavlink 2.4.50, {kind} alone: {speed(dataflash, lambda: mavlink(dataflash, kind))}")


main()
