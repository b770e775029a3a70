"""Changes to text and to bytes: numbers that no reader expects, words, lines and brackets where none belong."""

from __future__ import annotations

import re
from random import Random

NUMBERS = (
    "nan", "-inf", "inf", "1e308", "-1e308", "1e309", "1e-320", "-0", "0", "-1", "1", "2147483647", "2147483648",
    "-2147483649", "18446744073709551616", "9" * 400, "1e9", "1000000000000", "0x10", "1_0", "1e", "--1", "1,5", "٣",
    "0.5", "1e-9", "true", "",
)  # fmt: skip
FAR = ("\0", "\ufeff", "\u2028", "\udced\udca0\udc80", "\U0001f9f6", "é", "\r", "\x85", "\x1a")
"""Characters from far away."""
BRACKETS = (("[", "]"), ("{a: ", "}"), ('{"a":', "}"), ("{\n", "}\n"), ("(", ")"))
INDENTS = (" ", "  ", "\t", "- ")
_TOKEN = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|[A-Za-z_]+|\s+|.", re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d")


def mutate_text(data: bytes, random: Random, words: tuple[str, ...] = ()) -> bytes:
    """One to four changes to a text; `words` are those of its language."""
    text = data.decode("utf-8", errors="surrogateescape")
    for _ in range(random.choice((1, 1, 1, 2, 3, 4))):
        how = random.randrange(10)
        if how < 5:
            text = _change_token(text, random, words, number=how < 3)
        elif how < 7:
            text = _change_line(text, random)
        else:
            text = _change_place(text, random, words)
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


def _change_token(text: str, random: Random, words: tuple[str, ...], number: bool) -> str:
    """Another number in the place of one; or a token taken away, doubled, replaced by a word or another token."""
    tokens = _TOKEN.findall(text) or [""]
    places = [i for i, token in enumerate(tokens) if _NUMBER.match(token) or not number]
    if not places:
        return text
    place, other = random.choice(places), tokens[random.choice(places)]
    own = tokens[place]
    if number:
        tokens[place] = random.choice((*NUMBERS, "-" + own, own + "0", other))
    else:
        other = random.choice(words) if words and random.random() < 0.5 else other
        tokens[place] = random.choice(("", own * 2, other, other + " ", own + other))
    return "".join(tokens)


def _change_line(text: str, random: Random) -> str:
    """A line taken away, doubled, repeated often, moved, cut, or indented otherwise."""
    lines = text.split("\n")
    place, other = random.randrange(len(lines)), random.randrange(len(lines))
    own = lines[place]
    how = random.randrange(6)
    if how == 0:
        del lines[place]
    elif how == 1:
        lines.insert(other, own)
    elif how == 2:
        lines[place:place] = [own] * random.choice((2, 10, 60))
    elif how == 3:
        lines[place], lines[other] = lines[other], own
    else:
        lines[place] = own[: random.randrange(len(own) + 1)] if how == 4 else random.choice(INDENTS) + own
    return "\n".join(lines)


def _change_place(text: str, random: Random, words: tuple[str, ...]) -> str:
    """A word of the language or a far character put in; brackets within brackets; a piece, or the end, gone."""
    at, how = random.randrange(len(text) + 1), random.randrange(3)
    if how == 0:
        return text[:at] + random.choice(words if words and random.random() < 0.8 else FAR) + text[at:]
    if how == 1:
        opens, closes = random.choice(BRACKETS)
        depth = random.choice((3, 50, 2000))
        return text[:at] + opens * depth + (closes * depth if random.random() < 0.5 else "") + text[at:]
    return text[:at] if random.random() < 0.5 else text[:at] + text[random.randrange(at, len(text) + 1) :]
