"""Contents of logs as read by pyulog, pymavlink, SciPy and h5py: references for the tests of the formats.

    python logs.py ../samples/logs logs

Requires pyulog 1.3.0, pymavlink 2.4.50, SciPy 1.17.1, h5py 3.16.0, NumPy 2.4. Writes for each log NAME.tsv: topic,
rows, column, sum of the finite values in order, and the values of rows 0, 500, 1000, ... and the last; texts are
URL-quoted after a `"`. Also writes small logs with features that the real logs lack; the same libraries read them back.
"""

import math
import struct
import sys
from pathlib import Path
from urllib.parse import quote

import h5py
import numpy as np
from pymavlink.DFReader import DFReader_binary
from pyulog import ULog
from scipy.io import loadmat, savemat

EVERY = 500


def shown(value) -> str:
    if isinstance(value, str):
        return '"' + quote(value)
    return repr(float(value))


def line(topic: str, column: str, values: list) -> str:
    total = 0.0
    for value in values:
        if not isinstance(value, str) and math.isfinite(float(value)):
            total += float(value)
    at = sorted({*range(0, len(values), EVERY), len(values) - 1})
    picked = "\t".join(shown(values[i]) for i in at)
    return f"{quote(topic)}\t{len(values)}\t{quote(column)}\t{total!r}\t{picked}\n"


def write(to: Path, rows: list[str]) -> None:
    to.write_text("".join(rows))
    print(to, len(rows), "columns")


def ulog(path: Path, to: Path) -> None:
    """Joins text fields, which pyulog reads as single characters, up to the first NUL."""
    rows = []
    for data in ULog(str(path)).data_list:
        topic = data.name if data.multi_id == 0 else f"{data.name}:{data.multi_id}"
        texts: dict[str, list] = {}
        for field in data.field_data:
            name, values = field.field_name, data.data[field.field_name]
            if "_padding" in name:
                continue
            if field.type_str == "char":
                texts.setdefault(name.rsplit("[", 1)[0], []).append(values.astype(np.uint8))
            elif field.type_str in ("uint64_t", "int64_t") and (np.abs(values.astype(float)) > 2.0**53).any():
                rows.append(line(topic, name, [str(int(v)) for v in values]))
            else:
                rows.append(line(topic, name, values.tolist()))
        for name, characters in texts.items():
            words = [bytes(c).split(b"\0")[0].decode() for c in zip(*characters)]
            rows.append(line(topic, name, words))
    write(to, rows)


def dataflash(path: Path, to: Path) -> None:
    log = DFReader_binary(str(path))
    columns: dict[tuple[str, str], list] = {}
    while (message := log.recv_msg()) is not None:
        fmt = message.fmt
        topic = fmt.name
        if fmt.instance_field is not None:
            topic += f":{getattr(message, fmt.instance_field)}"
        for name, character in zip(fmt.columns, fmt.format):
            value = getattr(message, name)
            if isinstance(value, bytes):
                value = value.split(b"\0")[0].decode("latin-1")
            if character == "a":
                for i, x in enumerate(value):
                    columns.setdefault((topic, f"{name}[{i}]"), []).append(x)
            elif character in "qQ" and abs(value) > 2**53:
                columns.setdefault((topic, name), []).append(str(value))
            else:
                columns.setdefault((topic, name), []).append(value)
    units = [
        f"unit\t{quote(f.name)}\t{quote(c)}\t{quote(u)}\n"
        for f in log.formats.values()
        if f.units
        for c, u in zip(f.columns, f.units)
    ]
    write(to, [line(topic, name, values) for (topic, name), values in columns.items()] + units)


def vector(values: np.ndarray) -> list:
    values = values.ravel(order="F").tolist()
    wide = any(isinstance(x, int) and abs(x) > 2**53 for x in values)
    return [str(x) for x in values] if wide else values


def mat(path: Path, to: Path) -> None:
    """Matrices with the names of their labels, structures with their fields, vectors at the root."""
    rows, found = [], {k: v for k, v in loadmat(path).items() if not k.startswith("__")}

    def fields(topic: str, prefix: str, record) -> None:
        for name in record.dtype.names:
            value = record[name]
            if value.dtype.names and value.size == 1:
                fields(topic, f"{prefix}{name}.", value.flat[0])
            elif value.dtype.kind == "U":
                rows.append(line(topic, prefix + name, vector(value)))
            elif value.dtype.kind in "fiub" and value.size and 1 in value.shape:
                rows.append(line(topic, prefix + name, vector(value)))
            elif value.dtype.kind in "fiub" and value.size:
                for i in range(value.shape[1]):
                    rows.append(line(topic, f"{prefix}{name}[{i}]", vector(value[:, i])))

    for name, value in found.items():
        if value.dtype.names and value.size == 1:
            fields(name, "", value.flat[0])
        elif value.dtype.kind in "fiub" and value.ndim == 2 and value.size:
            labels = [str(x.item()) for x in found.get(name + "_label", np.array([])).ravel()]
            if len(labels) == value.shape[1]:
                for i, label in enumerate(labels):
                    rows.append(line(name, label.strip(), vector(value[:, i])))
            elif 1 in value.shape:
                rows.append(line(".", name, vector(value)))
            else:
                for i in range(value.shape[1]):
                    rows.append(line(name, f"{name}[{i}]", vector(value[:, i])))
    write(to, rows)


def hdf5(path: Path, to: Path) -> None:
    rows = []

    def put(topic: str, name: str, value: np.ndarray) -> None:
        value = value.T
        if 1 in value.shape:
            rows.append(line(topic, name, vector(value)))
        else:
            for i in range(value.shape[1]):
                rows.append(line(topic, f"{name}[{i}]", vector(value[:, i])))

    def group(topic: str, prefix: str, of: h5py.Group) -> None:
        for name, value in of.items():
            if isinstance(value, h5py.Group):
                group(topic, f"{prefix}{name}.", value)
            elif value.attrs["MATLAB_class"] == b"char":
                rows.append(line(topic, prefix + name, ["".join(map(chr, value[()].ravel()))]))
            elif value.attrs["MATLAB_class"] != b"cell":
                put(topic, prefix + name, value[()])

    with h5py.File(path) as file:
        for name, value in file.items():
            if isinstance(value, h5py.Group) and not name.startswith("#"):
                group(name, "", value)
            elif isinstance(value, h5py.Dataset) and value.attrs["MATLAB_class"] != b"cell":
                put("." if 1 in value.shape else name, name, value[()])
    write(to, rows)


# Logs with features that the real logs lack.


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def made_ulog(to: Path) -> None:
    """Nested formats, arrays of them, texts, padding in the middle and at the end, instances, and 64 bits."""
    formats = [
        "part:uint64_t timestamp;float x;uint8_t[4] _padding0;",
        "whole:uint64_t timestamp;part[2] parts;char[8] name;bool on;int16_t[3] small;uint64_t id;"
        "uint8_t[1] _padding0;",
        "types:uint64_t timestamp;int8_t a;uint8_t b;int16_t c;uint16_t d;int32_t e;uint32_t f;int64_t g;"
        "float h;double i;",
    ]
    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
    body = b"".join(message("F", f.encode()) for f in formats)
    body += message("I", bytes([12]) + b"char[4] name" + b"PX4 ") + message("P", bytes([7]) + b"float K" + bytes(4))
    for i, (instance, name) in enumerate([(0, "whole"), (1, "whole"), (0, "types"), (3, "types")]):
        body += message("A", struct.pack("<BH", instance, i) + name.encode())

    # Without the padding at the end, which loggers omit; pyulog 1.3.0 rejects messages with padding as damaged.
    def whole(k: int) -> bytes:
        parts = b"".join(struct.pack("<Qf4x", 10 * k + j, k / 3 + j) for j in range(2))
        data = struct.pack("<Q", 1000 * k) + parts + f"n{k}".encode().ljust(8, b"\0")
        data += struct.pack("<?hhhQ", k % 2 == 1, -k, k, 3 * k, 2**63 + k)
        return data

    def types(k: int) -> bytes:
        return struct.pack("<QbBhHiIqfd", k, -k % 100, k % 256, -k, k, -k, 2**32 - 1 - k, -(2**62) - k, k / 7, k / 7)

    for k in range(1200):
        body += message("D", struct.pack("<H", k % 2) + whole(k))
        if k % 4 == 0:
            body += message("D", struct.pack("<H", 2 + k % 8 // 4) + types(k))
        if k == 600:
            body += message("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12") + message("O", struct.pack("<H", 42))
            body += message("L", b"6" + struct.pack("<Q", 5) + b"text")
            body += message("C", b"6\1\0" + struct.pack("<Q", 5) + b"tagged")
    to.write_bytes(head + message("B", bytes(40)) + body)


class DataFlash:
    """Messages of a log, with a definition for each."""

    size = dict(a=64, b=1, B=1, g=2, h=2, H=2, i=4, I=4, f=4, n=4, N=16, Z=64, c=2, C=2, e=4, E=4, L=4, d=8, M=1, q=8,
                Q=8)
    code = dict(a="32h", g="e", n="4s", N="16s", Z="64s", c="h", C="H", e="i", E="I", L="i", M="b")

    def __init__(self) -> None:
        self.defined = {}

    def fmt(self, kind: int, name: str, form: str, labels: str) -> bytes:
        self.defined[name] = (kind, "<" + "".join(self.code.get(c, c) for c in form))
        length = 3 + sum(self.size[c] for c in form)
        head = struct.pack("<BBB", 0xA3, 0x95, 0x80)
        return head + struct.pack("<BB4s16s64s", kind, length, name.encode(), form.encode(), labels.encode())

    def put(self, name: str, *values) -> bytes:
        kind, form = self.defined[name]
        values = [v.encode() if isinstance(v, str) else v for v in values]
        return struct.pack("<BBB", 0xA3, 0x95, kind) + struct.pack(form, *values)


def made_dataflash(to: Path) -> None:
    """Every format character, units, and instances by number and by name."""
    log = DataFlash()
    fmt, put = log.fmt, log.put
    out = fmt(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    out += fmt(1, "UNIT", "QbZ", "TimeUS,Id,Label") + fmt(2, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
    out += fmt(3, "MULT", "Qbd", "TimeUS,Id,Mult") + fmt(4, "ALL", "QbBhHiIfgdMqa", "TimeUS,b,B,h,H,i,I,f,g,d,M,q,a")
    out += fmt(5, "SCAL", "QcCeEL", "TimeUS,c,C,e,E,L") + fmt(6, "MAG", "QBhhhI", "TimeUS,I,MagX,MagY,MagZ,S")
    out += fmt(7, "NVF", "QNf", "TimeUS,Name,Value") + fmt(8, "TXT", "QnNZ", "TimeUS,n,N,Z")
    for character, label in [("s", "s"), ("G", "Gauss"), ("#", "instance"), ("D", "deglatitude"), ("m", "m"),
                             ("v", "V")]:
        out += put("UNIT", 1_000_000, ord(character), label)
    for character, factor in [("F", 1e-6), ("C", 1e-3), ("B", 1e-2), ("G", 1e-7), ("0", 1.0), ("-", 0.0)]:
        out += put("MULT", 1_000_000, ord(character), float(np.float32(factor)))
    out += put("FMTU", 1_000_000, 5, "svvmmD", "FBBBBG") + put("FMTU", 1_000_000, 6, "s#GGG-", "F-CCC-")
    out += put("FMTU", 1_000_000, 7, "s#-", "F--")
    for k in range(1100):
        t = 1_000_000 + 20_000 * k
        out += put("ALL", t, -k % 100, k % 256, -k, k, -k, 4_000_000_000 - k, k / 7, k / 8, k / 7, k % 20, -k,
                   *range(k, k + 32))
        out += put("SCAL", t, -k, 2 * k, -3 * k, 4 * k, -353_632_621 + k)
        out += put("MAG", t, k % 3, k, -k, 2 * k, k)
        if k % 10 == 0:
            out += put("NVF", t, ["rpm", "temperature"][k // 10 % 2], k / 3)
            out += put("TXT", t, "abcd", f"name {k}", f"text {k} of a log")
    to.write_bytes(out)


def made_ardupilot(to: Path, instances: bool) -> None:
    """Messages as defined by ArduPilot (LogStructure.h of AP_Compass, AP_GPS, AP_BattMonitor, AP_Baro and
    AP_InertialSensor of version 4.1; of DataFlash of version 3.6 without `instances`): 12 s of two compasses at 10 Hz,
    GNSS at 5 Hz, the rest at 5 Hz."""
    log = DataFlash()
    put = log.put
    i = ("B", "I,", "#", "-") if instances else ("", "", "", "")

    def defined(kind: int, name: str, form: str, labels: str, units: str, factors: str) -> bytes:
        """`form`, `units` and `factors` begin with the time stamp; an instance follows it."""
        own = i if name in ("MAG", "GPS", "IMU", "BAT", "BARO") else ("", "", "", "")
        label = "Instance," if own[1] and name == "BAT" else own[1]
        head = log.fmt(kind, name, form[0] + own[0] + form[1:], f"TimeUS,{label}{labels}")
        meant.append((kind, units[0] + own[2] + units[1:], factors[0] + own[3] + factors[1:]))
        return head

    meant = []
    out = log.fmt(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    out += log.fmt(1, "UNIT", "QbZ", "TimeUS,Id,Label") + log.fmt(2, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
    out += log.fmt(3, "MULT", "Qbd", "TimeUS,Id,Mult")
    motor = "MOX,MOY,MOZ" if instances else "MOfsX,MOfsY,MOfsZ"
    compass = ("QhhhhhhhhhBI", f"MagX,MagY,MagZ,OfsX,OfsY,OfsZ,{motor},Health,S", "sGGGGGGGGG-s", "FCCCCCCCCC-F")
    out += defined(10, "MAG", *compass)
    if not instances:
        out += log.fmt(11, "MAG2", compass[0], f"TimeUS,{compass[1]}")
        meant.append((11, compass[2], compass[3]))
    out += defined(12, "GPS", "QBIHBcLLeffffB", "Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
                   "s-s-S-DUmnhnh-", "F-C-0BGGB000--")
    out += defined(13, "ATT", "QccccCCCCB", "DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF", "sddddhhdh-",
                   "FBBBBBBBB-")
    out += defined(14, "IMU", "QffffffIIfBBHH", "GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz", "sEEEooo--O--zz",
                   "F000000-----00")
    out += defined(15, "BAT", "Qfffffcf", "Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res", "svvAiJOw", "F000!/?0")
    out += defined(16, "BARO", "QffcfIffB", "Alt,Press,Temp,CRt,SMS,Offset,GndTemp,Health", "smPOnsmO-", "F00B0C?0-")
    for character, label in [("s", "s"), ("G", "Gauss"), ("#", "instance"), ("D", "deglatitude"), ("U", "deglongitude"),
                             ("m", "m"), ("v", "V"), ("A", "A"), ("d", "deg"),
                             ("h", "degheading"), ("n", "m/s"), ("E", "rad/s"), ("o", "m/s/s"), ("P", "Pa")]:
        out += put("UNIT", 1_000_000, ord(character), label)
    for character, factor in [("F", 1e-6), ("C", 1e-3), ("B", 1e-2), ("G", 1e-7), ("0", 1.0), ("-", 0.0), ("?", 1.0)]:
        out += put("MULT", 1_000_000, ord(character), factor)
    for kind, units, factors in meant:
        out += put("FMTU", 1_000_000, kind, units, factors)
    for k in range(120):
        # Noon of a Wednesday by GPS time is second 302,400 of the week, and 0 of the clock.
        t = 30_000_000 + 100_000 * k
        number = lambda j: (j,) if instances else ()
        out += put("MAG", t, *number(0), 200 + k, -40, -586 + 2 * k, -97, 118, 213, k % 5, 1, -2, 1, t)
        if instances:
            out += put("MAG", t + 5, 1, -30, 250 - k, -400, 10, -20, 30, 0, 0, 0, 1, t)
        else:
            out += put("MAG2", t + 5, -30, 250 - k, -400, 10, -20, 30, 0, 0, 0, 1, t)
        if k % 2:
            continue
        week, fix = (2200, 3) if instances else (2000, 3)
        out += put("GPS", t, *number(0), fix if k > 3 else 1, 302_400_000 + t // 1000, week, 14, 81,
                   -353_626_210 + 100 * k, 1_491_652_300, 58_432 + k,
                   12.0, 90.0, -0.5, 0.0, 1)
        out += put("ATT", t, 0, 1250, 0, -375, 0, 27_025, 0, 0, 3)
        out += put("IMU", t, *number(0), 0.1, -0.2, 0.3, 0.5, -0.25, -9.75, 0, 0, 41.5, 1, 1, 1000, 1000)
        out += put("BAT", t, *number(0), 15.875, 16.0, 12.25, 100.0, 1.5, 2500, 0.01)
        out += put("BARO", t, *number(0), 42.5, 95_123.5, 3125, 0.25, t // 1000, 0.0, 20.0, 1)
    to.write_bytes(out)


def made_mat(to: Path) -> None:
    """A transposed matrix, whole numbers of 64 bits, nested fields, and types that are not read."""
    k = np.arange(1300)
    log = {"t": k / 10.0, "gyro": np.stack([k, -k, 2 * k]).T / 7,
           "gps": {"lat": 50 + k / 1e5, "sat": (k % 12).astype(np.uint8)}}
    log |= {"other": np.arange(20.0), "note": "a flight", "cells": np.array([1.0, "x"], dtype=object),
            "none": np.zeros((0, 0))}
    root = {"log": log, "time": k / 50.0, "id": 2**62 + k.astype(np.int64), "flag": k % 2 == 0, "scalar": 7.0}
    savemat(to, root | {"complex": np.array([1j, 2.0])}, do_compression=True)


def made_v73(to: Path) -> None:
    """The layout of MATLAB 7.3: HDF5 after 512 bytes, dimensions in the opposite order, classes as attributes."""
    k = np.arange(1300)
    with h5py.File(to, "w", userblock_size=512) as file:

        def put(group: h5py.Group, name: str, value: np.ndarray, kind: str) -> None:
            chunked = {"compression": "gzip", "chunks": True} if value.size > 100 else {}
            group.create_dataset(name, data=np.atleast_2d(value), **chunked).attrs["MATLAB_class"] = np.bytes_(kind)

        put(file, "time", k / 50.0, "double")
        put(file, "count", k.astype(np.int16), "int16")
        put(file, "matrix", np.stack([k, -k, 2 * k]) / 7.0, "double")
        log = file.create_group("log")
        log.attrs["MATLAB_class"] = np.bytes_("struct")
        put(log, "lat", 50 + k / 1e5, "double")
        put(log, "name", np.array([[ord(c)] for c in "thor"], dtype=np.uint16), "char")
        gps = log.create_group("gps")
        gps.attrs["MATLAB_class"] = np.bytes_("struct")
        put(gps, "sat", (k % 12).astype(np.uint8), "uint8")
        refs = file.create_group("#refs#")
        put(refs, "a", np.array([1.0]), "double")
        cell = file.create_dataset("cells", data=np.array([[refs["a"].ref]], dtype=h5py.ref_dtype))
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  1 00:00:00 2024 HDF5 schema 1.00 ."
    with open(to, "r+b") as raw:
        raw.write(text.ljust(116) + bytes(8) + b"\x00\x02IM")


def main() -> None:
    samples, to = map(Path, sys.argv[1:])
    to.mkdir(exist_ok=True)
    made_ulog(to / "made.ulg")
    made_dataflash(to / "made.bin")
    made_mat(to / "made.mat")
    made_v73(to / "made_v73.mat")
    for path in [samples / "sample_log_small.ulg", samples / "sample_cut.ulg", to / "made.ulg"]:
        ulog(path, to / f"{path.name}.tsv")
    made_ardupilot(to / "ardupilot_4.bin", True)
    made_ardupilot(to / "ardupilot_3.bin", False)
    for path in [samples / "log171_cut.bin", to / "made.bin", to / "ardupilot_4.bin", to / "ardupilot_3.bin"]:
        dataflash(path, to / f"{path.name}.tsv")
    names = ["big_endian", "testdouble_6.1_SOL2", "testdouble_7.1_GLNX86", "testmatrix_6.1_SOL2",
             "testmatrix_7.4_GLNX86"]
    names += ["teststructnest_6.1_SOL2", "teststructnest_7.1_GLNX86"]
    matlab = [samples / "TestLog2_cut.mat", samples / "thor_flight75_cut.mat", to / "made.mat"]
    for path in matlab + [samples / f"matlab/{name}.mat" for name in names]:
        mat(path, to / f"{path.name}.tsv")
    hdf5(to / "made_v73.mat", to / "made_v73.mat.tsv")
    old = samples / "matlab" / "testhdf5_7.4_GLNX86.mat"
    hdf5(old, to / f"{old.name}.tsv")


main()
