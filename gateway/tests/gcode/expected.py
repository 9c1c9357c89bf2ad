"""Writes NAME.expected beside NAME.gcode: where the tool is after each line, as interpreters that are
not ours say.

    pip install pygcode==0.2.1 && python3 expected.py

`square` and `arcs` are read by pygcode, arcs also cut into chords by it. pygcode knows neither G53, G92
and G28 nor inches, so that `offsets` and `inches` are read by the little interpreter below, which
agrees with pygcode on the other two. Both are written in another style than the gateway's, on purpose.
A line is `X Y Z` in mm, `~ X Y Z` is a place on an arc on the way there.
"""

import math
import pathlib
import re

HERE = pathlib.Path(__file__).parent
# Zeros of G54 to G59, as in gcode.rs.
ZEROS = {n: (0.0, 0.0, 0.0) for n in range(54, 60)} | {55: (100.0, -20.0, 3.0), 59: (7.5, 8.25, 0.125)}


def little(text):
    """Each line's words are looked up, one question after the other."""
    place, named = [0.0] * 3, [0.0] * 3
    inch = relative = False
    zero, verb = 54, 0
    for line in text.splitlines():
        line = re.sub(r"\([^)]*\)|;.*|%", "", line).upper().replace(" ", "")
        words = [(a, float(b)) for a, b in re.findall(r"([A-Z])([-+.\d]+)", line)]
        codes = {b for a, b in words if a == "G"}
        values = {a: b for a, b in words if a not in "GMN"}
        inch = 20 in codes or inch and 21 not in codes
        relative = 91 in codes or relative and 90 not in codes
        zero = next((int(c) for c in codes if 54 <= c <= 59), zero)
        verb = next((c for c in codes if c < 4), verb)
        unit = 25.4 if inch else 1.0
        ways = {"XYZ".index(a): b * unit for a, b in values.items() if a in "XYZ"}
        if 92.1 in codes:
            named = [0.0] * 3
        elif 92 in codes:
            for i, value in ways.items():
                named[i] = place[i] - ZEROS[zero][i] - value
        elif 28 in codes:
            place = [0.0] * 3
        else:
            for i, value in ways.items():
                if 53 in codes:
                    place[i] = value
                elif relative:
                    place[i] += value
                else:
                    place[i] = value + ZEROS[zero][i] + named[i]
        yield [tuple(place)]


def by_pygcode(text):
    from pygcode import Line, Machine
    from pygcode.gcodes import GCodeArcMove
    from pygcode.transform import ArcLinearizeInside, linearize_arc

    class Mill(Machine):
        axes = set("XYZ")

    mill = Mill()
    where = lambda at: (float(at.X), float(at.Y), float(at.Z))
    for text_line in text.splitlines():
        block = Line(text_line.replace("%", "")).block
        places = []
        for code in block.gcodes:
            if isinstance(code, GCodeArcMove):
                chords = linearize_arc(
                    code,
                    mill.pos,
                    plane=mill.mode.plane_selection,
                    method_class=ArcLinearizeInside,
                    max_error=0.0005,
                    decimal_places=9,
                )
                x, y, z = where(mill.pos)
                for chord in chords:
                    at = {a: float(b) for a, b in chord.get_param_dict().items()}
                    x, y, z = at.get("X", x), at.get("Y", y), at.get("Z", z)
                    places.append((x, y, z))
        mill.process_block(block)
        yield places[:-1:7] + [where(mill.abs_pos)]


def same(a, b):
    ends = lambda lines: [places[-1] for places in lines]
    return all(math.dist(p, q) < 1e-9 for p, q in zip(ends(a), ends(b), strict=True))


for name in ("square", "arcs", "offsets", "inches"):
    text = (HERE / f"{name}.gcode").read_text()
    lines = list(little(text))
    if name in ("square", "arcs"):
        theirs = list(by_pygcode(text))
        assert same(lines, theirs), name
        lines = theirs
    out = ""
    for places in lines:
        for index, place in enumerate(places):
            mark = "~ " if index < len(places) - 1 else ""
            out += mark + " ".join(f"{v:.6f}" for v in place) + "\n"
    (HERE / f"{name}.expected").write_text(out)
