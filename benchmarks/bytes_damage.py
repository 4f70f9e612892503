"""Inputs spoilt at random: bytes, lines and cells of text, trees and texts of YAML.

Everything is drawn from one `random.Random`, so that its seed repeats the input.
"""

from __future__ import annotations

import contextlib
import copy
import json
import math
from collections.abc import Iterator, Sequence
from random import Random
from typing import Any

LONGEST_BYTES = 1 << 20
"""No input grows beyond this by repeating parts of it."""
WHOLE = (0, 1, 2, 3, 7, 127, 128, 255, 256, 32767, 65535, 65536, 2**24, 2**31 - 1, 2**31,
         2**32 - 1, 2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 1)
"""Whole numbers at the ends of types."""
NUMBERS = (0, 1, -1, 0.0, -0.0, 5e-324, 1e-320, 1e-9, 1e9, 1e15, 1e154, 1e308, -1e308, 2**31,
           2**63, 2**200, -2**70, math.nan, math.inf, -math.inf, True, False, 10**400)
NUMBER_TEXTS = (b"nan", b"-nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e400", b"1e-400",
                b"0x10", b"1_000", b"1,5", b"--1", b"+", b"-", b".", b"1e", b"NaN(7)",
                b"99999999999999999999999999", b"\xd9\xa1\xd9\xa2", b"1d5", b"", b" ", b"0",
                b"0.001", b"-0", b"infinity", b"1" * 400)
TEXTS = (b"\0", b"\n", b"\r", b"\r\n", b"\t", b",", b";", b'"', b"'", b"#", b"%", b"\xff",
         b"\xef\xbb\xbf", b"\xff\xfe", b"\xc3\xa9", b"\xe2\x80\xae", b"\xed\xa0\x80",
         b"\xe2\x80\xa8", b"\xf0\x9f\x92\xa3", b"\x1b[2J", b"\x0c", b"\x1c", b"\x85")
YAML_TEXTS = (b"\t", b"\n", b":", b"- ", b"&a ", b"*a ", b"<<: *a\n", b"!!x ", b"!!binary ",
              b"!!python/object/apply:os.system [ls]", b"!!set ", b"!!omap ", b"!!timestamp ",
              b"!!float ", b"!!int ", b"{", b"[", b"]", b"}", b"%", b"%YAML 9.9\n---\n", b"---\n",
              b"...\n", b"|\n", b">\n", b"? ", b"@", b"`", b"'", b'"', b"\xff", b"\0", b"\\x0",
              b"2001-13-45", b"2001-01-01T99:99:99Z", b"12:30:45", b"0o9", b".nan", b"-.inf",
              b"1e999", b"=", b"~", b"yes")
WORDS = ("", " ", "x", "nan", "1e3", "null", "../..", "/", "/dev/stdin", "\0", "é\n", "{", "!!x",
         "!!python/object/apply:os.system", "a" * 300, "0x10", "1_000", "12:30:45", "2001-01-01",
         "multisine", "paper_stage", "step", "csv", "<<", "=", "x.y", "\u202e", "name", "kind")


def damaged(rng: Random, data: bytes, others: Sequence[bytes] = (),
            words: Sequence[bytes] = TEXTS) -> bytes:
    """Change one to six places: bits, numbers at the ends of types, words, parts."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        at = rng.randrange(len(out) + 1)
        size = min(rng.choice((1, 2, 4, 8, 16, 64, len(out) // 4 + 1)), len(out) - at)
        kind = rng.randrange(9)
        if kind == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            width = rng.choice((1, 2, 4, 8))
            number = rng.choice(WHOLE) % 2**(8 * width)
            out[at:at + width] = number.to_bytes(width, rng.choice(("little", "big")))
        elif kind == 2:
            out[at:at + rng.choice((0, 0, 1, 4))] = rng.choice(words)
        elif kind == 3:
            del out[at:at + size]
        elif kind == 4:
            other = rng.randrange(len(out) + 1)
            out[other:other] = out[at:at + size]
        elif kind == 5 and rng.random() < 0.5:
            del out[at:]
        elif kind == 6 and others:
            other_data = rng.choice(others)
            begin = rng.randrange(len(other_data) + 1)
            out[at:at + size] = other_data[begin:begin + rng.choice((4, 64, 1024))]
        elif kind == 7:
            out[at:at + size] = rng.randbytes(size)
        elif kind == 8 and rng.random() < 0.1:
            times = rng.choice((10, 100, 10_000))
            out[at:at] = (out[at:at + size] * times)[:LONGEST_BYTES]
    return bytes(out[:2 * LONGEST_BYTES])


def spoilt_table(rng: Random, text: bytes, others: Sequence[bytes]) -> bytes:
    """Change cells, lines, separators or the encoding of a table in text."""
    kind = rng.randrange(12)
    if kind == 0:
        return _odd_table(rng)
    if kind == 1:
        return damaged(rng, text, others)
    if kind == 2:
        return text.decode().encode(rng.choice(("utf-16", "utf-16-le", "utf-32", "utf-8-sig",
                                                "utf-7", "cp500")))
    lines = text.split(b"\n")
    for _ in range(rng.choice((1, 1, 2, 5, 30))):
        at = rng.randrange(len(lines)) if rng.random() < 0.7 else 0
        cells = lines[at].split(b",")
        place = rng.randrange(len(cells))
        act = rng.randrange(8)
        if act < 3:
            cells[place] = rng.choice(NUMBER_TEXTS)
        elif act == 3:
            cells[place] += rng.choice(TEXTS)
        elif act == 4:
            cells.insert(place, rng.choice(cells))
        elif act == 5:
            del cells[place]
        lines[at] = b",".join(cells)
        if act == 6:
            lines[at:at + 1] = lines[at:at + 1] * rng.choice((0, 2, 2, 50))
        elif act == 7:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        if not lines:
            lines = [b""]
    out = b"\n".join(lines)
    if rng.random() < 0.2:
        out = out.replace(b",", rng.choice((b";", b"\t", b" ", b"|", b",,", b'","')))
    return out.replace(b"\n", rng.choice((b"\r", b"\r\n", b"\x85"))) if rng.random() < 0.1 else out


def _odd_table(rng: Random) -> bytes:
    """A table whose shape is the trouble."""
    kind = rng.randrange(8)
    count = rng.choice((1, 10, 1000, 100_000, 1_000_000) if rng.random() < 0.02 else (1, 10, 1000))
    if kind == 0:
        head = b"time_s,input_v,position_m," + b",".join(b"c%d" % k for k in range(count))
        return head + b"\n" + b"\n".join(b",".join([b"%d" % k] * 4) for k in range(20))
    if kind == 1:
        return b"time_s,input_v,position_m\n" + b"," * count + b"\n0,0,0\n" * 20
    if kind == 2:
        return b'"' + b"a" * (200 * count) + b'",b,c\n' + b"1,2,3\n" * 20
    if kind == 3:
        return b'time_s,input_v,position_m\n"' + b"0,0,0\n" * min(count, 10_000)
    if kind == 4:
        return b"\n" * count
    if kind == 5:
        return b"#" * count + b"\ntime_s,input_v,position_m\n" + b"0,0,0\n" * 20
    number = rng.choice(NUMBER_TEXTS)
    rows = [b"%s,%s,%s" % (b"%d" % k if kind == 6 else number, rng.choice(NUMBER_TEXTS), number)
            for k in range(30)]
    return b"time_s,input_v,position_m\n" + b"\n".join(rows)


def nodes(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every (container, key) of a tree of plain lists and dicts."""
    items = tree.items() if isinstance(tree, dict) else (
        enumerate(tree) if isinstance(tree, list) else ())
    for key, value in list(items):
        yield tree, key
        yield from nodes(value)


def junk(rng: Random, depth: int = 2) -> Any:
    """A value that nobody expects."""
    kind = rng.randrange(8 if depth else 6)
    if kind < 3:
        return rng.choice(NUMBERS)
    if kind < 6:
        return rng.choice(WORDS) if kind < 5 else None
    if kind == 6:
        return [junk(rng, depth - 1) for _ in range(rng.randrange(4))]
    return {rng.choice(WORDS): junk(rng, depth - 1) for _ in range(rng.randrange(4))}


def spoilt_tree(rng: Random, tree: Any) -> Any:
    """Replace, remove, add, rename or double up to four nodes of a copy of a tree."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 2, 4))):
        every = list(nodes(tree))
        if not every:
            return junk(rng)
        container, key = rng.choice(every)
        kind = rng.randrange(7)
        if kind < 3:
            number = isinstance(container[key], (int, float)) and rng.random() < 0.7
            container[key] = rng.choice(NUMBERS) if number else junk(rng)
        elif kind == 3:
            del container[key]
        elif kind == 4:
            other, place = rng.choice(every)
            with contextlib.suppress(IndexError, KeyError):      # removed a moment ago
                container[key] = copy.deepcopy(other[place])
        elif isinstance(container, list):
            container.append(junk(rng))
        elif kind == 5:
            container[rng.choice(WORDS)] = junk(rng)
        else:
            container[rng.choice(WORDS)] = container.pop(key)
    return tree


def yaml_of(tree: Any) -> bytes:
    """JSON is YAML; with YAML's words for what JSON has none for."""
    text = json.dumps(tree, allow_nan=True)
    return text.replace("-Infinity", "-.inf").replace("Infinity", ".inf").replace(
        "NaN", ".nan").encode("utf-8", "replace")


def spoilt_yaml(rng: Random, texts: Sequence[bytes], trees: Sequence[Any]) -> bytes:
    """A text of YAML spoilt as a tree or as a text, or one with aliases, depth or length."""
    kind = rng.randrange(20)
    if kind < 10:
        return yaml_of(spoilt_tree(rng, rng.choice(trees)))
    if kind < 18:
        return damaged(rng, rng.choice(texts), texts, YAML_TEXTS)
    if kind == 18:
        return odd_yaml(rng, yaml_of(rng.choice(trees)))
    tree = spoilt_tree(rng, rng.choice(trees))
    if isinstance(tree, dict) and tree:
        return b"" .join(b"%s: %s\n" % (yaml_of(str(key)), odd_yaml(rng, yaml_of(value))
                                         if rng.random() < 0.3 else yaml_of(value))
                         for key, value in tree.items())
    return odd_yaml(rng, yaml_of(tree))


def odd_yaml(rng: Random, inside: bytes) -> bytes:
    """A value in flow style whose aliases, depth or length are the trouble."""
    kind = rng.randrange(7)
    if kind == 0:       # a billion laughs
        levels, width = rng.choice((3, 9, 30)), rng.choice((2, 9))
        parts = [b"&a0 [%s]" % inside]
        parts += [b"&a%d [%s]" % (k, b", ".join([b"*a%d" % (k - 1)] * width))
                  for k in range(1, levels)]
        return b"[" + b", ".join(parts) + b"]"
    if kind == 1:       # a value that holds itself
        return rng.choice((b"&a [*a]", b"&a {a: *a}", b"&a {<<: *a}", b"&a [&b [*a, *b]]"))
    if kind == 2:
        depth = rng.choice((20, 300, 1000, 30_000))
        return b"[" * depth + inside + b"]" * rng.choice((depth, 0))
    if kind == 3:
        depth = rng.choice((20, 300, 1000, 10_000))
        return b"{a: " * depth + inside + b"}" * depth
    if kind == 4:
        return b'"' + b"a\\u0000" * rng.choice((10, 10_000)) + b'"'
    if kind == 5:
        return b"9" * rng.choice((20, 400, 5000, 100_000))
    return b"[" + b", ".join([b"%d" % k for k in range(rng.choice((10, 3000)))]) + b"]"
