"""Coastlines for the maps of the report and of `magline view`, from Natural Earth (public domain).

    python3 make_coastline.py ne_50m_coastline.json ../../pipeline/report/src/html/web/vendor/coastline.bin

The input is the layer `ne_50m_coastline` as GeoJSON. Points that change a line by less than 0.01 degrees are dropped,
and the others are rounded to 0.005 degrees. The module `coast` of the report describes the format.
"""
import json
import math
import sys

TOLERANCE_DEG = 0.01
STEPS = 200


def lines(path):
    for feature in json.load(open(path))["features"]:
        geometry = feature["geometry"]
        yield from [geometry["coordinates"]] if geometry["type"] == "LineString" else geometry["coordinates"]


def far(point, a, b):
    """Distance in degrees of latitude from a segment."""
    shrink = math.cos(math.radians((a[1] + b[1]) / 2))
    dx, dy = (b[0] - a[0]) * shrink, b[1] - a[1]
    x, y = (point[0] - a[0]) * shrink, point[1] - a[1]
    square = dx * dx + dy * dy
    part = 0.0 if square == 0 else max(0.0, min(1.0, (x * dx + y * dy) / square))
    return math.hypot(x - part * dx, y - part * dy)


def simplified(line):
    """The line without points nearer than the tolerance to the rest. [Douglas, Peucker 1973]"""
    keep, open_ = {0, len(line) - 1}, [(0, len(line) - 1)]
    while open_:
        a, b = open_.pop()
        away = [(far(line[i], line[a], line[b]), i) for i in range(a + 1, b)]
        most, at = max(away, default=(0.0, a))
        if most > TOLERANCE_DEG:
            keep.add(at)
            open_ += [(a, at), (at, b)]
    return [line[i] for i in sorted(keep)]


def number(value):
    out = bytearray()
    while value >= 128:
        out.append(value & 127 | 128)
        value >>= 7
    return out + bytes([value])


def zigzag(value):
    return number(2 * value if value >= 0 else -2 * value - 1)


def main(source, target):
    parts, points = [], 0
    for line in lines(source):
        steps = [(round(x * STEPS), round(y * STEPS)) for x, y in simplified(line)]
        steps = steps[:1] + [b for a, b in zip(steps, steps[1:]) if a != b]
        if len(steps) > 1:
            before = [(0, 0), *steps]
            parts.append(number(len(steps)) + b"".join(
                zigzag(x - u) + zigzag(y - v) for (x, y), (u, v) in zip(steps, before)))
            points += len(steps)
    with open(target, "wb") as file:
        file.write(number(len(parts)) + b"".join(parts))
    print(f"{len(parts)} lines, {points} points")


main(*sys.argv[1:])
