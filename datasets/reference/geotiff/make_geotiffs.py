"""Makes small GeoTIFF files of one 7 x 5 grid in many layouts; the value of a cell is 10 row + column, row 0 north.

python3 make_geotiffs.py   (standard library and numpy only; from the specifications of TIFF 6.0, BigTIFF and GeoTIFF)
"""
import struct
import zlib

import numpy as np

ROWS, COLUMNS = 5, 7
GRID = 10.0 * np.arange(ROWS)[:, None] + np.arange(COLUMNS)[None, :]


def predicted(block, predictor):
    if predictor == 1:
        return block.tobytes()
    if predictor == 2:
        return np.concatenate([block[:, :1], np.diff(block, axis=1)], axis=1).astype(block.dtype).tobytes()
    # Predictor 3: the bytes of each row are sorted by significance, then replaced by differences.
    out = b""
    for row in block:
        planes = np.frombuffer(row.astype(block.dtype.newbyteorder(">")).tobytes(), "u1").reshape(-1, block.itemsize).T
        flat = planes.reshape(-1)
        out += np.concatenate([flat[:1], np.diff(flat)]).astype("u1").tobytes()
    return out


def write(name, dtype="f4", order="<", tile=None, deflate=False, predictor=1, geographic=False, point=False,
          matrix=False, nodata=None, big=False, height=None, south_up=False):
    grid = GRID.copy()
    if nodata is not None:
        grid[1, 2] = float(nodata)
    if south_up:
        grid = grid[::-1]
    data = grid.astype(np.dtype(dtype).newbyteorder(order))
    blocks = []
    if tile:
        for r in range(0, ROWS, tile):
            for c in range(0, COLUMNS, tile):
                block = np.zeros((tile, tile), data.dtype)
                part = data[r:r + tile, c:c + tile]
                block[:part.shape[0], :part.shape[1]] = part
                blocks.append(predicted(block, predictor))
    else:
        blocks = [predicted(data[r:r + 2], predictor) for r in range(0, ROWS, 2)]
    if deflate:
        blocks = [zlib.compress(b) for b in blocks]
    step = 0.01 if geographic else 100.0
    x0, y0 = (140.5, -22.0) if geographic else (448350.0, 7594850.0)
    if point:
        x0, y0 = x0 + step / 2, y0 - step / 2
    code = (2, 2048, 4326) if geographic else (1, 3072, 32754)
    keys = [1, 1, 0, 3, 1024, 0, 1, code[0], 1025, 0, 1, 2 if point else 1, code[1], 0, 1, code[2]]
    kinds = {"H": (3, 2), "I": (4, 4), "d": (12, 8), "s": (2, 1), "Q": (16, 8)}
    kind = {"f": 3, "i": 2, "u": 1}[np.dtype(dtype).kind]
    tags = {256: ("H", [COLUMNS]), 257: ("H", [ROWS]), 258: ("H", [8 * data.itemsize]),
            259: ("H", [8 if deflate else 1]),
            262: ("H", [1]), 277: ("H", [1]), 284: ("H", [1]), 339: ("H", [kind]), 34735: ("H", keys)}
    if predictor != 1:
        tags[317] = ("H", [predictor])
    if tile:
        tags[322], tags[323] = ("H", [tile]), ("H", [tile])
    else:
        tags[278] = ("H", [2])
    dy = -step if not south_up else step
    if south_up:
        y0 = y0 - step * ROWS
    if matrix or south_up:
        tags[34264] = ("d", [step, 0, 0, x0, 0, dy, 0, y0, 0, 0, 0, 0, 0, 0, 0, 1])
    else:
        tags[33550], tags[33922] = ("d", [step, step, 0.0]), ("d", [0, 0, 0, x0, y0, 0])
    if nodata is not None:
        tags[42113] = ("s", nodata.encode() + b"\0")
    if height is not None:
        tags[42112] = ("s", f'<GDALMetadata>\n  <Item name="level_height_m">{height}</Item>\n</GDALMetadata>\n'.encode()
                       + b"\0")
    offsets, counts = (324, 325) if tile else (273, 279)
    word = "Q" if big else "I"
    tags[offsets], tags[counts] = (word, [0] * len(blocks)), (word, [len(b) for b in blocks])
    header = 16 if big else 8
    entry, inline = (20, 8) if big else (12, 4)
    directory = header
    extra = directory + (8 if big else 2) + entry * len(tags) + (8 if big else 4)
    size = lambda t: len(t[1]) * kinds[t[0]][1]
    data_at = extra + sum(size(t) + size(t) % 2 for t in tags.values() if size(t) > inline)
    at = data_at
    for i, b in enumerate(blocks):
        tags[offsets][1][i] = at
        at += len(b)
    out_entries, out_extra = b"", b""
    for tag in sorted(tags):
        letter, values = tags[tag]
        raw = values if letter == "s" else struct.pack(f"{order}{len(values)}{letter}", *values)
        out_entries += struct.pack(order + ("HHQ" if big else "HHI"), tag, kinds[letter][0], len(values))
        if len(raw) <= inline:
            out_entries += raw.ljust(inline, b"\0")
        else:
            out_entries += struct.pack(order + word, extra + len(out_extra))
            out_extra += raw + b"\0" * (len(raw) % 2)
    magic = b"II" if order == "<" else b"MM"
    head = magic + (struct.pack(order + "HHHQ", 43, 8, 0, 16) if big else struct.pack(order + "HI", 42, 8))
    body = struct.pack(order + ("Q" if big else "H"), len(tags)) + out_entries
    body += struct.pack(order + word, 0) + out_extra
    open(name, "wb").write(head + body + b"".join(blocks))


write("f32_strips.tif", height=500)
write("f64_tiles.tif", dtype="f8", tile=16)
write("i16_deflate_predictor.tif", dtype="i2", deflate=True, predictor=2)
write("f32_deflate_float_predictor_tiles.tif", tile=16, deflate=True, predictor=3)
write("f32_big_endian.tif", order=">")
write("f32_bigtiff.tif", big=True)
write("f32_point.tif", point=True)
write("f32_matrix.tif", matrix=True)
write("f32_south_up.tif", south_up=True)
write("f32_nodata.tif", nodata="-3.4028234663852886e+38")
write("i16_nodata.tif", dtype="i2", nodata="-32768")
write("f32_geographic.tif", geographic=True)
write("f64_geographic_point.tif", dtype="f8", geographic=True, point=True)
