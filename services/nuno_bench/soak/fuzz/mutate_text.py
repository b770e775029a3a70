"""Changes to text and to bytes: numbers that no reader expects, words, lines and brackets where none belong."""

from __future__ import annotations

import re
from collections.abc import Callable
from random import Random

NUMBERS = (
    "nan", "-inf", "inf", "1e308", "-1e308", "1e309", "1e-320", "-0", "0", "-1", "1", "2147483647", "2147483648",
    "-2147483649", "18446744073709551616", "9" * 400, "1e9", "1000000000000", "0x10", "1_0", "1e", "--1", "1,5", "٣",
    "0.5", "1e-9", "true", "",
)  # fmt: skip
_TOKEN = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|[A-Za-z_]+|\s+|.", re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d")
Change = Callable[[str, Random, tuple[str, ...]], str]


def mutate_text(data: bytes, random: Random, words: tuple[str, ...] = ()) -> bytes:
    """One to four changes to a text; `words` are those of its language."""
    text = data.decode("utf-8", errors="surrogateescape")
    for _ in range(random.choice((1, 1, 1, 2, 3, 4))):
        text = random.choice(_CHANGES)(text, random, words)
    return text.encode("utf-8", errors="surrogateescape")


def mutate_bytes(data: bytes, random: Random) -> bytes:
    """One to four changes to bytes: flipped, set, cut, repeated, moved."""
    found = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 4))):
        at, length = random.randrange(len(found) + 1), random.choice((1, 1, 2, 4, 8, 64))
        how = random.randrange(6)
        if how == 0 and at < len(found):
            found[at] ^= 1 << random.randrange(8)
        elif how == 1:
            found[at : at + length] = random.choice((b"\0", b"\xff", b"\x7f", b"\x80")) * length
        elif how == 2:
            del found[at : at + length]
        elif how == 3:
            found[at:at] = found[at : at + length]
        elif how == 4:
            found[at:at] = random.randbytes(length)
        else:
            del found[at:]
    return bytes(found)


def _number(text: str, random: Random, words: tuple[str, ...]) -> str:
    """Another number in the place of one."""
    tokens = _TOKEN.findall(text)
    places = [i for i, token in enumerate(tokens) if _NUMBER.match(token)]
    if places:
        place = random.choice(places)
        tokens[place] = random.choice(
            (*NUMBERS, "-" + tokens[place], tokens[place] + "0", tokens[random.choice(places)])
        )
    return "".join(tokens)


def _token(text: str, random: Random, words: tuple[str, ...]) -> str:
    """A token taken away, doubled, or replaced by a word or another of the text's own."""
    tokens = _TOKEN.findall(text) or [""]
    place = random.randrange(len(tokens))
    other = random.choice(words) if words and random.random() < 0.5 else random.choice(tokens)
    tokens[place] = random.choice(("", tokens[place] * 2, other, other + " ", tokens[place] + other))
    return "".join(tokens)


def _line(text: str, random: Random, words: tuple[str, ...]) -> str:
    """A line taken away, doubled, repeated often, moved, cut, or indented otherwise."""
    lines = text.split("\n")
    place, other = random.randrange(len(lines)), random.randrange(len(lines))
    how = random.randrange(6)
    if how == 0:
        del lines[place]
    elif how == 1:
        lines.insert(other, lines[place])
    elif how == 2:
        lines[place:place] = [lines[place]] * random.choice((2, 10, 60))
    elif how == 3:
        lines[place], lines[other] = lines[other], lines[place]
    elif how == 4:
        lines[place] = lines[place][: random.randrange(len(lines[place]) + 1)]
    else:
        lines[place] = random.choice((" ", "  ", "\t", "- ")) + lines[place]
    return "\n".join(lines)


def _word(text: str, random: Random, words: tuple[str, ...]) -> str:
    """A word of the language, or a character from far away, somewhere."""
    at = random.randrange(len(text) + 1)
    far = ("\0", "\ufeff", "\u2028", "\udced\udca0\udc80", "\U0001f9f6", "é", "\r", "\x85", "\x1a")
    return text[:at] + (random.choice(words) if words and random.random() < 0.8 else random.choice(far)) + text[at:]


def _deep(text: str, random: Random, words: tuple[str, ...]) -> str:
    """Brackets within brackets."""
    at, depth = random.randrange(len(text) + 1), random.choice((3, 50, 2000))
    opens, closes = random.choice((("[", "]"), ("{a: ", "}"), ('{"a":', "}"), ("{\n", "}\n"), ("(", ")")))
    return text[:at] + opens * depth + (closes * depth if random.random() < 0.5 else "") + text[at:]


def _cut(text: str, random: Random, words: tuple[str, ...]) -> str:
    """The end, or a piece, gone."""
    start, stop = sorted((random.randrange(len(text) + 1), random.randrange(len(text) + 1)))
    return text[:start] if random.random() < 0.5 else text[:start] + text[stop:]


_CHANGES: tuple[Change, ...] = (_number, _number, _number, _token, _token, _line, _line, _word, _deep, _cut)
